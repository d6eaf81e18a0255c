#include <fmt/format.h>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <utility>

#include "bench/console/terminal.h"
#include "bench/run/recording.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> failed(const fs::path& file, int error) {
  return tl::unexpected<Error>(output_error(file, error));
}

/// Only where nothing has the name. 0 or an error number.
int rename_to_free_name(const fs::path& from, const fs::path& to) {
  if (::renameat2(AT_FDCWD, from.c_str(), AT_FDCWD, to.c_str(), RENAME_NOREPLACE) == 0) return 0;
  if (errno != EINVAL && errno != ENOSYS) return errno;
  // File systems that do not know it have hard links, or (FAT) neither.
  if (::link(from.c_str(), to.c_str()) == 0) return ::unlink(from.c_str()) == 0 ? 0 : errno;
  if (errno == EEXIST) return EEXIST;
  struct stat info {};
  if (::lstat(to.c_str(), &info) == 0) return EEXIST;
  return ::rename(from.c_str(), to.c_str()) == 0 ? 0 : errno;
}

}  // namespace

Result<RecordingFile> RecordingFile::create(const fs::path& file, Existing existing) {
  RecordingFile r;
  r.file_ = file;
  r.target_ = resolve_links(file);
  struct stat info {};
  if (::stat(r.target_.c_str(), &info) == 0 && S_ISCHR(info.st_mode)) {
    r.device_ = true;
    r.fd_ = ::open(r.target_.c_str(), O_WRONLY | O_CLOEXEC);
    if (r.fd_ < 0) return failed(file, errno);
    return r;
  }
  std::error_code ec;
  if (r.target_.has_parent_path()) fs::create_directories(r.target_.parent_path(), ec);
  if (ec) return failed(file, ec.value());
  // It gets its name when it is locked, so that nobody sees it otherwise.
  const fs::path part = part_name(r.target_);
  ::unlink(part.c_str());
  r.fd_ = ::open(part.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (r.fd_ < 0) return failed(file, errno);
  (void)::flock(r.fd_, LOCK_EX | LOCK_NB);
  if (auto s = r.take_name(part, existing); !s) {
    ::unlink(part.c_str());
    return tl::unexpected<Error>(s.error());
  }
  return r;
}

Status RecordingFile::take_name(const fs::path& part, Existing existing) {
  for (int attempt = 0; attempt < 100; ++attempt) {
    const int error = rename_to_free_name(part, target_);
    if (error == 0) return {};
    if (error != EEXIST) return failed(file_, error);
    const int old = ::open(target_.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (old < 0 && errno == ENOENT) continue;
    const bool busy = old >= 0 && ::flock(old, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK;
    struct stat locked {
    }, named{};
    const bool same = old >= 0 && ::fstat(old, &locked) == 0 && ::stat(target_.c_str(), &named) == 0 &&
                      locked.st_ino == named.st_ino && locked.st_dev == named.st_dev;
    Status moved;
    bool done = false;
    if (busy) {
      moved = fail(ErrorCode::not_writable, file_.string(),
                   "another run is writing this recording; give another with --record");
    } else if (old >= 0 && !same) {
      // Somebody else was quicker: look again.
    } else if (existing == Existing::replace) {
      done = ::rename(part.c_str(), target_.c_str()) == 0;
      if (!done) moved = failed(file_, errno);
    } else {
      const fs::path kept = next_number(target_);
      const int wrong = rename_to_free_name(target_, kept);
      if (wrong == 0)
        kept_ = kept;
      else if (wrong != EEXIST && wrong != ENOENT)
        moved = failed(file_, wrong);
    }
    if (old >= 0) ::close(old);
    if (!moved || done) return moved;
    if (!kept_.empty()) {
      write_stderr(fmt::format("rigor: the earlier {} is kept as {}\n", file_.string(), kept_.string()));
      const int wrong = rename_to_free_name(part, target_);
      if (wrong == 0) return {};
      if (wrong != EEXIST) return failed(file_, wrong);
      kept_.clear();  // another run took the free name
    }
  }
  return fail(ErrorCode::not_writable, file_.string(),
              "other runs keep taking this name; give another with --record");
}

RecordingFile::RecordingFile(RecordingFile&& o) noexcept
    : file_(std::move(o.file_)),
      target_(std::move(o.target_)),
      kept_(std::move(o.kept_)),
      fd_(std::exchange(o.fd_, -1)),
      device_(o.device_) {}
RecordingFile& RecordingFile::operator=(RecordingFile&& o) noexcept {
  std::swap(file_, o.file_);
  std::swap(target_, o.target_);
  std::swap(kept_, o.kept_);
  std::swap(fd_, o.fd_);
  std::swap(device_, o.device_);
  return *this;
}
RecordingFile::~RecordingFile() {
  if (fd_ >= 0) ::close(fd_);
}

Result<std::unique_ptr<record::ByteSink>> RecordingFile::sink(const record::FileSinkOptions& options) const {
  if (!device_ && (::ftruncate(fd_, 0) != 0 || ::lseek(fd_, 0, SEEK_SET) != 0)) return failed(file_, errno);
  const int fd = ::fcntl(fd_, F_DUPFD_CLOEXEC, 3);
  if (fd < 0) return failed(file_, errno);
  return record::file_sink(fd, file_.string(), options);
}

void RecordingFile::abandon() {
  if (device_ || fd_ < 0) return;
  ::unlink(target_.c_str());
  if (!kept_.empty() && rename_to_free_name(kept_, target_) == 0)
    write_stderr(fmt::format("rigor: the earlier {} has its name again\n", file_.string()));
}

}  // namespace rigor
