#include "sensor-hal/types/sample_memory.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <map>
#include <mutex>
#include <new>
#include <optional>
#include <string>

namespace rigor::sample_memory {
namespace {

// Room in the file, of which pages are taken as they are used. It is mapped block by block: a process that
// locks its memory would otherwise be given all of it.
constexpr std::size_t kSize = std::size_t{1} << 36;
constexpr std::size_t kPage = 4096;

/// One file for the process's life: leases may outlive whoever asked for sharing.
struct File {
  int fd = -1;
  std::mutex mutex;
  std::map<std::size_t, std::size_t> free;  ///< offset, size; neighbours are joined
};
std::atomic<File*> g_file{nullptr};

std::size_t rounded(std::size_t bytes) { return (bytes + kPage - 1) / kPage * kPage; }

void give_back(File& file, std::size_t offset, std::size_t size) noexcept {
  const std::lock_guard lock(file.mutex);
  (void)fallocate(file.fd, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, static_cast<off_t>(offset),
                  static_cast<off_t>(size));
  auto next = file.free.lower_bound(offset);
  if (next != file.free.end() && offset + size == next->first) {
    size += next->second;
    next = file.free.erase(next);
  }
  if (next != file.free.begin())
    if (const auto before = std::prev(next); before->first + before->second == offset) {
      before->second += size;
      return;
    }
  file.free.emplace(offset, size);
}

std::optional<std::size_t> room_in(File& file, std::size_t size) {
  const std::lock_guard lock(file.mutex);
  for (auto it = file.free.begin(); it != file.free.end(); ++it) {
    if (it->second < size) continue;
    const auto [offset, room] = *it;
    file.free.erase(it);
    if (room > size) file.free.emplace(offset + size, room - size);
    return offset;
  }
  return std::nullopt;
}

}  // namespace

Status share() {
  static std::mutex mutex;
  const std::lock_guard lock(mutex);
  if (g_file.load()) return {};
  const auto failed = [](const char* call) {
    return fail(
        ErrorCode::io, "application",
        std::string("no memory that a program of its own can read: ") + call + ": " + std::strerror(errno));
  };
  auto file = std::make_unique<File>();
  file->fd = memfd_create("rigor-samples", MFD_CLOEXEC);
  if (file->fd < 0) return failed("memfd_create");
  if (ftruncate(file->fd, static_cast<off_t>(kSize)) != 0) {
    auto error = failed("ftruncate");
    close(file->fd);
    return error;
  }
  file->free.emplace(0, kSize);
  g_file.store(file.release(), std::memory_order_release);
  return {};
}

int open_for_reader() {
  const File* file = g_file.load();
  if (!file) return -1;
  const std::string path = "/proc/self/fd/" + std::to_string(file->fd);
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  // A program with capabilities of its file may not look into its own /proc/self/fd.
  return fd >= 0 ? fd : fcntl(file->fd, F_DUPFD_CLOEXEC, 3);
}

void Free::operator()(std::byte* memory) const noexcept {
  if (offset == kOnHeap) {
    delete[] memory;
    return;
  }
  munmap(memory, rounded(size_bytes));
  give_back(*g_file.load(), static_cast<std::size_t>(offset), rounded(size_bytes));
}

Block take(std::size_t size_bytes) {
  File* file = g_file.load();
  if (!file || size_bytes == 0) return Block(new std::byte[size_bytes](), Free{size_bytes});
  const std::size_t size = rounded(size_bytes);
  const auto offset = room_in(*file, size);
  if (!offset) throw std::bad_alloc();
  const auto at = static_cast<off_t>(*offset);
  // The kernel says now, and not by a signal later, that it has no more memory.
  void* memory = fallocate(file->fd, 0, at, static_cast<off_t>(size)) == 0
                     ? mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED, file->fd, at)
                     : MAP_FAILED;
  if (memory == MAP_FAILED) {
    give_back(*file, *offset, size);
    throw std::bad_alloc();
  }
  std::memset(memory, 0, size);
  return Block(static_cast<std::byte*>(memory), Free{size_bytes, static_cast<std::int64_t>(*offset)});
}

}  // namespace rigor::sample_memory
