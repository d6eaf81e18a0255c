#include "sim/fmu/fmu_archive.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zip.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <functional>
#include <map>

namespace rigor::fmu {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kChunk = std::size_t{64} << 10;

std::string zip_message(int code) {
  zip_error_t error;
  zip_error_init_with_code(&error, code);
  std::string text = zip_error_strerror(&error);
  zip_error_fini(&error);
  return text;
}

struct Discard {
  void operator()(zip_t* archive) const { zip_discard(archive); }
};
struct CloseEntry {
  void operator()(zip_file_t* file) const { zip_fclose(file); }
};

bool is_symbolic_link(zip_t* archive, zip_uint64_t index) {
  zip_uint8_t system = 0;
  zip_uint32_t attributes = 0;
  if (zip_file_get_external_attributes(archive, index, 0, &system, &attributes) != 0) return false;
  return system == ZIP_OPSYS_UNIX && ((attributes >> 16) & S_IFMT) == S_IFLNK;
}

Status write_all(int fd, const char* data, std::size_t size, const fs::path& file) {
  while (size > 0) {
    const ssize_t n = ::write(fd, data, size);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0)
      return fail(errno == ENOSPC ? ErrorCode::disk_full : ErrorCode::io, file.string(),
                  std::string("cannot write: ") + std::strerror(errno));
    data += n;
    size -= static_cast<std::size_t>(n);
  }
  return {};
}

}  // namespace

std::string refused_name(std::string_view name) {
  if (name.empty()) return "is empty";
  if (name.front() == '/') return "is an absolute path";
  for (const char c : name) {
    if (c == '\\') return "contains a backslash; FMI asks for forward slashes";
    if (c == ':') return "contains a colon";
    if (static_cast<unsigned char>(c) < 0x20) return "contains a control character";
  }
  while (!name.empty()) {
    const std::size_t slash = name.find('/');
    const std::string_view part = name.substr(0, slash);
    if (part == "..") return "leads out of the folder of the FMU";
    if (slash == std::string_view::npos) break;
    name.remove_prefix(slash + 1);
  }
  return {};
}

struct FmuArchive::Impl {
  std::string file;
  Limits limits;
  std::unique_ptr<zip_t, Discard> zip;
  std::vector<std::string> names;  ///< by index in the archive
  std::map<std::string, zip_uint64_t, std::less<>> index;

  /// Reads the names, and refuses what is not to be unpacked.
  Status check() {
    const zip_int64_t count = zip_get_num_entries(zip.get(), 0);
    if (count < 0 || static_cast<std::uint64_t>(count) > limits.entries)
      return fail(ErrorCode::bad_input, file,
                  "expected an archive of at most " + std::to_string(limits.entries) + " entries, got " +
                      std::to_string(count));
    std::uint64_t total = 0;
    for (zip_uint64_t i = 0; i < static_cast<zip_uint64_t>(count); ++i) {
      zip_stat_t entry;
      zip_stat_init(&entry);
      if (zip_stat_index(zip.get(), i, 0, &entry) != 0 || (entry.valid & ZIP_STAT_NAME) == 0)
        return fail(ErrorCode::bad_input, file,
                    "entry " + std::to_string(i) + " is damaged: " + zip_strerror(zip.get()));
      std::string name = entry.name;
      if (name.size() > limits.name_bytes)
        return fail(ErrorCode::bad_input, file,
                    "expected names of at most " + std::to_string(limits.name_bytes) + " bytes, got one of " +
                        std::to_string(name.size()));
      if (const std::string why = refused_name(name); !why.empty())
        return fail(ErrorCode::bad_input, file, "the name of the entry \"" + name + "\" " + why);
      if (is_symbolic_link(zip.get(), i))
        return fail(ErrorCode::bad_input, file,
                    "the entry \"" + name + "\" is a symbolic link, which an FMU has not");
      const std::uint64_t size = entry.valid & ZIP_STAT_SIZE ? entry.size : 0;
      if (size > limits.total_bytes - total)
        return fail(ErrorCode::bad_input, file,
                    "expected an archive of at most " + std::to_string(limits.total_bytes >> 20) +
                        " MiB when it is unpacked, got more");
      total += size;
      if (!index.emplace(name, i).second)
        return fail(ErrorCode::bad_input, file, "two entries have the name \"" + name + "\"");
      names.push_back(std::move(name));
    }
    return {};
  }

  /// Gives the bytes of an entry piece by piece.
  Status unpack(zip_uint64_t at, std::uint64_t max_bytes,
                const std::function<Status(const char*, std::size_t)>& take) const {
    const std::string& name = names[at];
    const std::unique_ptr<zip_file_t, CloseEntry> entry(zip_fopen_index(zip.get(), at, 0));
    if (!entry)
      return fail(ErrorCode::bad_input, file, name + " cannot be unpacked: " + zip_strerror(zip.get()));
    std::vector<char> chunk(kChunk);
    std::uint64_t total = 0;
    for (;;) {
      const zip_int64_t n = zip_fread(entry.get(), chunk.data(), chunk.size());
      if (n < 0)
        return fail(ErrorCode::bad_input, file, name + " is damaged: " + zip_file_strerror(entry.get()));
      if (n == 0) return {};
      total += static_cast<std::uint64_t>(n);
      if (total > max_bytes)
        return fail(
            ErrorCode::bad_input, file,
            "expected " + name + " to have at most " + std::to_string(max_bytes) + " bytes, got more");
      if (auto s = take(chunk.data(), static_cast<std::size_t>(n)); !s) return s;
    }
  }
};

FmuArchive::FmuArchive(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
FmuArchive::FmuArchive(FmuArchive&&) noexcept = default;
FmuArchive& FmuArchive::operator=(FmuArchive&&) noexcept = default;
FmuArchive::~FmuArchive() = default;

Result<FmuArchive> FmuArchive::open(const fs::path& file, const Limits& limits) {
  auto impl = std::make_unique<Impl>();
  impl->file = file.string();
  impl->limits = limits;
  std::error_code none;
  if (!fs::is_regular_file(file, none))
    return fail(ErrorCode::not_found, file.string(), "expected an FMU (a zip file), found no such file");
  int code = 0;
  impl->zip.reset(zip_open(file.c_str(), ZIP_RDONLY, &code));
  if (!impl->zip)
    return fail(ErrorCode::bad_input, file.string(), "expected an FMU (a zip file): " + zip_message(code));
  if (auto s = impl->check(); !s) return tl::unexpected<Error>(s.error());
  return FmuArchive(std::move(impl));
}

Result<FmuArchive> FmuArchive::from_memory(std::span<const std::byte> bytes, const std::string& name,
                                           const Limits& limits) {
  auto impl = std::make_unique<Impl>();
  impl->file = name;
  impl->limits = limits;
  zip_error_t error;
  zip_error_init(&error);
  zip_source_t* source = zip_source_buffer_create(bytes.data(), bytes.size(), 0, &error);
  if (source) impl->zip.reset(zip_open_from_source(source, ZIP_RDONLY, &error));
  if (!impl->zip) {
    const std::string why = zip_error_strerror(&error);
    if (source) zip_source_free(source);
    zip_error_fini(&error);
    return fail(ErrorCode::bad_input, name, "expected an FMU (a zip file): " + why);
  }
  zip_error_fini(&error);
  if (auto s = impl->check(); !s) return tl::unexpected<Error>(s.error());
  return FmuArchive(std::move(impl));
}

const std::vector<std::string>& FmuArchive::names() const { return impl_->names; }
bool FmuArchive::has(std::string_view name) const { return impl_->index.find(name) != impl_->index.end(); }

Result<std::string> FmuArchive::read(std::string_view name, std::uint64_t max_bytes) const {
  const auto it = impl_->index.find(name);
  if (it == impl_->index.end())
    return fail(ErrorCode::not_found, impl_->file,
                "expected a file " + std::string(name) + " in the FMU, found none");
  std::string text;
  auto s = impl_->unpack(it->second, max_bytes, [&](const char* data, std::size_t size) -> Status {
    text.append(data, size);
    return {};
  });
  if (!s) return tl::unexpected<Error>(s.error());
  return text;
}

Status FmuArchive::extract(const fs::path& folder, std::span<const std::string> prefixes) const {
  std::uint64_t left = impl_->limits.total_bytes;
  for (zip_uint64_t i = 0; i < impl_->names.size(); ++i) {
    const std::string& name = impl_->names[i];
    if (name.back() == '/' || std::none_of(prefixes.begin(), prefixes.end(),
                                           [&](const std::string& p) { return name.starts_with(p); }))
      continue;
    const fs::path file = folder / name;
    std::error_code error;
    fs::create_directories(file.parent_path(), error);
    const int fd = ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (fd < 0)
      return fail(ErrorCode::io, file.string(), std::string("cannot be written: ") + std::strerror(errno));
    auto s = impl_->unpack(i, left, [&](const char* data, std::size_t size) -> Status {
      left -= size;
      return write_all(fd, data, size, file);
    });
    ::close(fd);
    if (!s) return s;
  }
  return {};
}

}  // namespace rigor::fmu
