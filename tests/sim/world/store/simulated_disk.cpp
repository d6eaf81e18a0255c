#include "tests/sim/world/store/simulated_disk.h"

#include <algorithm>
#include <cstring>
#include <new>

#include "tests/sim/world/store/test_world.h"

namespace rigor::world::test {

struct SimulatedDiskCalls {
  struct File : sqlite3_file {
    SimulatedDisk* disk;
    std::shared_ptr<SimulatedDisk::Inode> inode;
    bool syncs_folder;
  };
  static File& of(sqlite3_file* f) { return *static_cast<File*>(f); }
  static SimulatedDisk& of(sqlite3_vfs* v) { return *static_cast<SimulatedDisk*>(v->pAppData); }

  static int close(sqlite3_file* f) {
    of(f).~File();
    return SQLITE_OK;
  }
  static int read(sqlite3_file* f, void* to, int n, sqlite3_int64 at) {
    if (of(f).disk->dead_) return SQLITE_IOERR_READ;
    const auto& b = of(f).inode->now;
    const auto begin = std::min(static_cast<std::size_t>(at), b.size());
    const auto count = std::min(static_cast<std::size_t>(n), b.size() - begin);
    std::memset(to, 0, static_cast<std::size_t>(n));
    if (count > 0) std::memcpy(to, b.data() + begin, count);
    return count == static_cast<std::size_t>(n) ? SQLITE_OK : SQLITE_IOERR_SHORT_READ;
  }
  static int write(sqlite3_file* f, const void* from, int n, sqlite3_int64 at) {
    auto& disk = *of(f).disk;
    auto& inode = *of(f).inode;
    const auto power = disk.operate();
    if (power == SimulatedDisk::Power::off) return SQLITE_IOERR_WRITE;
    const auto end = static_cast<std::size_t>(at) + static_cast<std::size_t>(n);
    if (disk.full_at_ == disk.writes_++) return SQLITE_FULL;
    if (disk.limit_ && end > inode.now.size() && disk.bytes() + end - inode.now.size() > *disk.limit_)
      return SQLITE_FULL;
    SimulatedDisk::Write w{static_cast<std::size_t>(at), {}, false};
    w.bytes.resize(static_cast<std::size_t>(n));
    std::memcpy(w.bytes.data(), from, w.bytes.size());
    if (inode.now.size() < end) inode.now.resize(end);
    std::copy(w.bytes.begin(), w.bytes.end(), inode.now.begin() + at);
    inode.pending.push_back(std::move(w));
    return power == SimulatedDisk::Power::on ? SQLITE_OK : SQLITE_IOERR_WRITE;
  }
  static int truncate(sqlite3_file* f, sqlite3_int64 size) {
    const auto power = of(f).disk->operate();
    if (power == SimulatedDisk::Power::off) return SQLITE_IOERR_TRUNCATE;
    of(f).inode->now.resize(static_cast<std::size_t>(size));
    of(f).inode->pending.push_back({static_cast<std::size_t>(size), {}, true});
    return power == SimulatedDisk::Power::on ? SQLITE_OK : SQLITE_IOERR_TRUNCATE;
  }
  static int sync(sqlite3_file* f, int) {
    if (of(f).disk->operate() != SimulatedDisk::Power::on) return SQLITE_IOERR_FSYNC;
    of(f).inode->durable = of(f).inode->now;
    of(f).inode->pending.clear();
    // As the unix VFS: a journal that was made is synced together with its folder.
    if (std::exchange(of(f).syncs_folder, false)) of(f).disk->sync_folder();
    return SQLITE_OK;
  }
  static int size(sqlite3_file* f, sqlite3_int64* out) {
    *out = static_cast<sqlite3_int64>(of(f).inode->now.size());
    return of(f).disk->dead_ ? SQLITE_IOERR_FSTAT : SQLITE_OK;
  }
  static int lock(sqlite3_file*, int) { return SQLITE_OK; }
  static int reserved(sqlite3_file*, int* out) {
    *out = 0;
    return SQLITE_OK;
  }
  static int control(sqlite3_file*, int, void*) { return SQLITE_NOTFOUND; }
  static int sector(sqlite3_file*) { return static_cast<int>(SimulatedDisk::kSector); }
  static int characteristics(sqlite3_file*) { return 0; }  // nothing is atomic, not even overwriting

  static int open(sqlite3_vfs* v, const char* name, sqlite3_file* f, int flags, int* out_flags) {
    static const sqlite3_io_methods kMethods = {
        .iVersion = 1,
        .xClose = close,
        .xRead = read,
        .xWrite = write,
        .xTruncate = truncate,
        .xSync = sync,
        .xFileSize = size,
        .xLock = lock,
        .xUnlock = lock,
        .xCheckReservedLock = reserved,
        .xFileControl = control,
        .xSectorSize = sector,
        .xDeviceCharacteristics = characteristics,
        .xShmMap = nullptr,
        .xShmLock = nullptr,
        .xShmBarrier = nullptr,
        .xShmUnmap = nullptr,
        .xFetch = nullptr,
        .xUnfetch = nullptr,
    };
    auto& disk = of(v);
    f->pMethods = nullptr;
    if (disk.dead_) return SQLITE_CANTOPEN;
    std::shared_ptr<SimulatedDisk::Inode> inode;
    bool is_new = false;
    if (name == nullptr || (flags & SQLITE_OPEN_DELETEONCLOSE) != 0) {
      inode = std::make_shared<SimulatedDisk::Inode>();
    } else if (const auto found = disk.names_.find(name); found != disk.names_.end()) {
      inode = found->second;
    } else {
      if ((flags & SQLITE_OPEN_CREATE) == 0) return SQLITE_CANTOPEN;
      const auto power = disk.operate();
      if (power == SimulatedDisk::Power::off) return SQLITE_CANTOPEN;
      inode = disk.names_[name] = std::make_shared<SimulatedDisk::Inode>();
      disk.name_changes_.push_back({name, inode});
      if (power != SimulatedDisk::Power::on) return SQLITE_CANTOPEN;
      is_new = true;
    }
    auto* file = new (f) File;
    file->pMethods = &kMethods;
    file->disk = &disk;
    file->inode = std::move(inode);
    file->syncs_folder = is_new && (flags & SQLITE_OPEN_MAIN_JOURNAL) != 0;
    if (out_flags != nullptr) *out_flags = flags;
    return SQLITE_OK;
  }
  static int remove(sqlite3_vfs* v, const char* name, int syncs_folder) {
    auto& disk = of(v);
    const auto power = disk.operate();
    if (power == SimulatedDisk::Power::off) return SQLITE_IOERR_DELETE;
    if (disk.names_.erase(name) == 0) return SQLITE_IOERR_DELETE_NOENT;
    disk.name_changes_.push_back({name, nullptr});
    if (power != SimulatedDisk::Power::on) return SQLITE_IOERR_DELETE;
    if (syncs_folder != 0) disk.sync_folder();
    return SQLITE_OK;
  }
  static int access(sqlite3_vfs* v, const char* name, int, int* out) {
    *out = of(v).names_.contains(name) ? 1 : 0;
    return of(v).dead_ ? SQLITE_IOERR_ACCESS : SQLITE_OK;
  }
  static int full_path(sqlite3_vfs*, const char* name, int n, char* out) {
    sqlite3_snprintf(n, out, "%s", name);
    return SQLITE_OK;
  }
  static int randomness(sqlite3_vfs*, int n, char* out) {
    std::memset(out, 42, static_cast<std::size_t>(n));
    return n;
  }
  static int sleep(sqlite3_vfs*, int us) { return us; }
  static int now(sqlite3_vfs*, double* out) {
    *out = 2451545;
    return SQLITE_OK;
  }
  static int last_error(sqlite3_vfs*, int, char*) { return 0; }
};

SimulatedDisk::SimulatedDisk() {
  using Calls = SimulatedDiskCalls;
  before_ = sqlite3_vfs_find(nullptr);
  vfs_.iVersion = 1;
  vfs_.szOsFile = sizeof(Calls::File);
  vfs_.mxPathname = 1024;
  vfs_.zName = "simulated disk";
  vfs_.pAppData = this;
  vfs_.xOpen = Calls::open;
  vfs_.xDelete = Calls::remove;
  vfs_.xAccess = Calls::access;
  vfs_.xFullPathname = Calls::full_path;
  vfs_.xRandomness = Calls::randomness;
  vfs_.xSleep = Calls::sleep;
  vfs_.xCurrentTime = Calls::now;
  vfs_.xGetLastError = Calls::last_error;
  sqlite3_vfs_register(&vfs_, 1);
}

SimulatedDisk::~SimulatedDisk() {
  sqlite3_vfs_unregister(&vfs_);
  sqlite3_vfs_register(before_, 1);
}

SimulatedDisk::Power SimulatedDisk::operate() {
  if (dead_) return Power::off;
  if (power_fails_at_ == operations_++) {
    dead_ = true;
    return Power::fails;
  }
  return Power::on;
}

void SimulatedDisk::sync_folder() {
  durable_names_ = names_;
  name_changes_.clear();
}

std::size_t SimulatedDisk::bytes() const {
  std::size_t sum = 0;
  for (const auto& [name, inode] : names_) sum += inode->now.size();
  return sum;
}

void SimulatedDisk::crash(std::uint64_t seed) {
  Draws draws(seed);
  const auto happened = [&] { return draws.below(2) == 1; };
  for (auto& c : name_changes_) {
    if (!happened()) continue;
    if (c.inode)
      durable_names_[c.name] = c.inode;
    else
      durable_names_.erase(c.name);
  }
  name_changes_.clear();
  names_ = durable_names_;
  for (auto& [name, inode] : names_) {
    auto& bytes = inode->durable;
    for (const auto& w : inode->pending) {
      if (w.truncates) {
        if (happened()) bytes.resize(w.offset);
        continue;
      }
      for (std::size_t i = 0; i < w.bytes.size();) {
        const auto at = w.offset + i;
        const auto n = std::min(kSector - at % kSector, w.bytes.size() - i);
        if (happened()) {
          if (bytes.size() < at + n) bytes.resize(at + n);
          std::copy_n(w.bytes.begin() + static_cast<std::ptrdiff_t>(i), n,
                      bytes.begin() + static_cast<std::ptrdiff_t>(at));
        }
        i += n;
      }
    }
    // The size may have reached the disk without what lies there.
    if (!inode->pending.empty() && happened() && bytes.size() < inode->now.size())
      bytes.resize(inode->now.size(), std::byte{0xA5});
    inode->now = bytes;
    inode->pending.clear();
  }
  dead_ = false;
  power_fails_at_.reset();
}

}  // namespace rigor::world::test
