// The memory of samples, on the heap and where another process can map it. Sharing lasts for the process:
// each case runs in its own (ctest gives it one).
#include "sensor-hal/types/sample_memory.h"

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "sensor-hal/types/sample.h"

namespace rigor {
namespace {

TEST(SampleMemory, LiesOnTheHeapUntilItIsShared) {
  Sample before;
  before.reserve(100);
  EXPECT_EQ(before.memory().size(), 100U);
  EXPECT_LT(before.shared_offset(), 0);
  EXPECT_EQ(sample_memory::open_for_reader(), -1);
  ASSERT_TRUE(sample_memory::share());
  EXPECT_TRUE(sample_memory::share()) << "a second time changes nothing";
  EXPECT_LT(before.shared_offset(), 0) << "what has its memory keeps it";
  Sample after;
  after.reserve(100);
  EXPECT_GE(after.shared_offset(), 0);
}

TEST(SampleMemory, IsReadByWhoeverMapsItAndWrittenByNobodyElse) {
  ASSERT_TRUE(sample_memory::share());
  const auto pool = make_sample_pool(3, 5000);
  auto slot = pool->try_acquire();
  std::memset(slot->memory().data(), 0x5a, 5000);
  slot->size_bytes = 5000;
  const std::int64_t offset = slot->shared_offset();
  ASSERT_GE(offset, 0);
  EXPECT_EQ(offset % 4096, 0);
  const int fd = sample_memory::open_for_reader();
  ASSERT_GE(fd, 0);
  const std::size_t size = static_cast<std::size_t>(offset) + 8192;
  auto* map = static_cast<const std::byte*>(mmap(nullptr, size, PROT_READ, MAP_SHARED, fd, 0));
  ASSERT_NE(map, MAP_FAILED);
  EXPECT_EQ(std::memcmp(map + offset, slot->bytes().data(), 5000), 0);
  slot->memory()[17] = std::byte{1};
  EXPECT_EQ(map[offset + 17], std::byte{1}) << "it is not a copy";
  EXPECT_EQ(mmap(nullptr, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0), MAP_FAILED);
  EXPECT_EQ(errno, EACCES);
}

TEST(SampleMemory, GivesBackWhatIsNoLongerUsed) {
  ASSERT_TRUE(sample_memory::share());
  const int fd = sample_memory::open_for_reader();
  const auto used = [&] {
    struct stat s {};
    fstat(fd, &s);
    return s.st_blocks * 512;
  };
  Sample last;
  for (int i = 0; i < 200; ++i) {
    const auto pool = make_sample_pool(5, 1 << 20);
    if (i == 100) last.reserve(3 << 20);
    EXPECT_LE(used(), 9 << 20);
  }
  EXPECT_EQ(used(), 3 << 20);
  // Freed in any order, neighbours join: what was taken in pieces can be taken whole.
  {
    std::vector<Sample> pieces(64);
    for (Sample& s : pieces) s.reserve(8192);
    for (std::size_t i = 0; i < pieces.size(); i += 2) pieces[i] = Sample();
    for (std::size_t i = 1; i < pieces.size(); i += 2) pieces[i] = Sample();
  }
  Sample whole;
  whole.reserve(64 * 8192);
  EXPECT_LT(whole.shared_offset(), 8 << 20);
  for (const std::byte b : whole.memory()) ASSERT_EQ(b, std::byte{0});
}

TEST(SampleMemory, RefusesWhatTheMachineDoesNotHave) {
  ASSERT_TRUE(sample_memory::share());
  Sample s;
  EXPECT_THROW(s.reserve(std::size_t{1} << 37), std::bad_alloc);
}

}  // namespace
}  // namespace rigor
