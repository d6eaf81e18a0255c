#include "sensor-hal/record/byte_io.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstring>
#include <mutex>
#include <system_error>
#include <thread>

namespace rigor::record {
namespace {

/// What one system call writes at most. A kernel without full preemption runs nothing else on a CPU until the
/// call returns: a chunk of 4 MB in one call held up the threads of devices for 5 to 12 ms.
constexpr std::size_t kBytesPerCall = std::size_t{128} << 10;

std::string reason(int error) { return std::generic_category().message(error); }

Error write_error(const std::string& path, int error) {
  if (error == ENOSPC || error == EDQUOT || error == EFBIG)
    return {ErrorCode::disk_full, path,
            "no space left to write the recording (" + reason(error) + "); free some or record elsewhere"};
  return {ErrorCode::io, path, "cannot write the recording: " + reason(error)};
}

class FileSink final : public ByteSink {
 public:
  FileSink(int fd, std::string path, Duration sync_period) : fd_(fd), path_(std::move(path)) {
    if (sync_period > Duration{})
      syncer_ = std::thread([this, sync_period] { sync_now_and_then(sync_period); });
  }
  FileSink(const FileSink&) = delete;
  FileSink& operator=(const FileSink&) = delete;
  ~FileSink() override {
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    if (syncer_.joinable()) syncer_.join();
    ::close(fd_);
  }

  Status append(Pieces pieces) override {
    if (const int error = sync_error_.exchange(0)) return tl::unexpected(write_error(path_, error));
    std::array<iovec, 64> vectors{};
    std::size_t piece = 0;
    std::size_t skip = 0;  // bytes of `piece` that are written already
    while (true) {
      std::size_t n = 0, room = kBytesPerCall;
      for (std::size_t i = piece, s = skip; i < pieces.size() && n < vectors.size() && room > 0; ++i, s = 0)
        if (const std::size_t size = std::min(pieces[i].size() - s, room); size > 0) {
          vectors[n++] = {const_cast<std::byte*>(pieces[i].data()) + s, size};
          room -= size;
        }
      if (n == 0) return {};
      const ssize_t wrote = ::writev(fd_, vectors.data(), static_cast<int>(n));
      if (wrote < 0 && errno == EINTR) continue;
      if (wrote <= 0) return tl::unexpected(write_error(path_, wrote == 0 ? ENOSPC : errno));
      dirty_.store(true, std::memory_order_release);
      for (auto left = static_cast<std::size_t>(wrote); left > 0;) {
        const std::size_t here = std::min(left, pieces[piece].size() - skip);
        left -= here;
        skip += here;
        if (skip == pieces[piece].size()) ++piece, skip = 0;
      }
    }
  }

  Status truncate(std::uint64_t size) override {
    const auto end = static_cast<off_t>(size);
    if (::ftruncate(fd_, end) != 0 || ::lseek(fd_, end, SEEK_SET) != end)
      return fail(ErrorCode::io, path_,
                  "cannot cut the recording back to its last whole chunk: " + reason(errno));
    return {};
  }

  Status sync() override {
    if (::fdatasync(fd_) != 0 && errno != EINVAL && errno != EROFS)
      return tl::unexpected(write_error(path_, errno));
    return {};
  }

  std::string name() const override { return path_; }

 private:
  void sync_now_and_then(Duration period) {
    std::unique_lock lock(mutex_);
    while (!wake_.wait_for(lock, std::chrono::nanoseconds(period.ns()), [this] { return stop_; })) {
      if (!dirty_.exchange(false, std::memory_order_acquire)) continue;
      lock.unlock();
      if (::fdatasync(fd_) != 0 && errno != EINVAL && errno != EROFS) sync_error_.store(errno);
      lock.lock();
    }
  }

  int fd_;
  std::string path_;
  std::atomic<bool> dirty_{false};
  std::atomic<int> sync_error_{0};
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
  std::thread syncer_;
};

class FileSource final : public ByteSource {
 public:
  FileSource(int fd, std::string path, std::uint64_t size) : fd_(fd), path_(std::move(path)), size_(size) {}
  FileSource(const FileSource&) = delete;
  FileSource& operator=(const FileSource&) = delete;
  ~FileSource() override { ::close(fd_); }

  std::uint64_t size() const override { return size_; }
  std::string name() const override { return path_; }

  Status read(std::uint64_t offset, std::span<std::byte> into) override {
    while (!into.empty()) {
      const ssize_t got = ::pread(fd_, into.data(), into.size(), static_cast<off_t>(offset));
      if (got < 0 && errno == EINTR) continue;
      if (got < 0) return fail(ErrorCode::io, path_, "cannot read: " + reason(errno));
      if (got == 0)
        return fail(ErrorCode::protocol, path_,
                    "the file ends at byte " + std::to_string(offset) + ", more was expected");
      offset += static_cast<std::uint64_t>(got);
      into = into.subspan(static_cast<std::size_t>(got));
    }
    return {};
  }

 private:
  int fd_;
  std::string path_;
  std::uint64_t size_;
};

class MemorySource final : public ByteSource {
 public:
  MemorySource(Bytes bytes, std::string name) : bytes_(bytes), name_(std::move(name)) {}
  std::uint64_t size() const override { return bytes_.size(); }
  std::string name() const override { return name_; }
  Status read(std::uint64_t offset, std::span<std::byte> into) override {
    if (offset > bytes_.size() || into.size() > bytes_.size() - offset)
      return fail(ErrorCode::protocol, name_,
                  "the data end at byte " + std::to_string(bytes_.size()) + ", more was expected");
    if (!into.empty()) std::memcpy(into.data(), bytes_.data() + offset, into.size());
    return {};
  }

 private:
  Bytes bytes_;
  std::string name_;
};

}  // namespace

Result<std::unique_ptr<ByteSink>> open_file_sink(const std::string& path, FileSinkOptions options) {
  const int flags = O_WRONLY | O_CREAT | O_CLOEXEC | (options.overwrite ? O_TRUNC : O_EXCL);
  const int fd = ::open(path.c_str(), flags, 0644);
  if (fd < 0) {
    const ErrorCode code = errno == ENOSPC ? ErrorCode::disk_full : ErrorCode::not_writable;
    return fail(code, path, "cannot create this file: " + reason(errno));
  }
  return file_sink(fd, path, options);
}

std::unique_ptr<ByteSink> file_sink(int fd, const std::string& path, FileSinkOptions options) {
  return std::make_unique<FileSink>(fd, path, options.sync_period);
}

Status MemorySink::append(Pieces pieces) {
  for (const Bytes& piece : pieces) bytes_.insert(bytes_.end(), piece.begin(), piece.end());
  return {};
}

Status MemorySink::truncate(std::uint64_t size) {
  if (size < bytes_.size()) bytes_.resize(size);
  return {};
}

Result<std::unique_ptr<ByteSource>> open_file_source(const std::string& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) {
    const ErrorCode code = errno == ENOENT ? ErrorCode::not_found : ErrorCode::bad_input;
    return fail(code, path, "cannot open this recording: " + reason(errno));
  }
  struct stat info {};
  if (::fstat(fd, &info) != 0 || !S_ISREG(info.st_mode)) {
    ::close(fd);
    return fail(ErrorCode::bad_input, path, "expected a recording, this is not a regular file");
  }
  return std::make_unique<FileSource>(fd, path, static_cast<std::uint64_t>(info.st_size));
}

std::unique_ptr<ByteSource> memory_source(Bytes bytes, std::string name) {
  return std::make_unique<MemorySource>(bytes, std::move(name));
}

}  // namespace rigor::record
