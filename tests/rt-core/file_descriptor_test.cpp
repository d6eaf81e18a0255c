#include "rt-core/file_descriptor.h"

#include <fcntl.h>
#include <gtest/gtest.h>

#include <cerrno>

namespace rigor {
namespace {

bool is_open(int fd) { return ::fcntl(fd, F_GETFD) >= 0; }
FileDescriptor open_null() { return FileDescriptor(::open("/dev/null", O_RDONLY | O_CLOEXEC)); }

TEST(FileDescriptor, ClosesAtItsEndAndKeepsErrno) {
  int fd = -1;
  {
    const FileDescriptor d = open_null();
    fd = d.get();
    ASSERT_TRUE(is_open(fd));
    errno = ENODEV;
  }
  EXPECT_EQ(errno, ENODEV);
  EXPECT_FALSE(is_open(fd));
}

TEST(FileDescriptor, MovesWithoutClosingAndClosesWhatItHadBefore) {
  FileDescriptor a = open_null();
  FileDescriptor b = open_null();
  const int first = a.get();
  const int second = b.get();
  b = std::move(a);
  EXPECT_EQ(b.get(), first);
  EXPECT_TRUE(is_open(first));
  EXPECT_FALSE(is_open(second));
  FileDescriptor& same = b;
  b = std::move(same);
  EXPECT_EQ(b.get(), first);
  EXPECT_TRUE(is_open(first));
}

TEST(FileDescriptor, GivesAwayWhatIsReleased) {
  FileDescriptor a = open_null();
  const FileDescriptor keeper(a.release());
  EXPECT_FALSE(a.is_open());
  a.reset();
  EXPECT_TRUE(is_open(keeper.get()));
}

}  // namespace
}  // namespace rigor
