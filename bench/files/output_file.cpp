#include "bench/files/output_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <nlohmann/json.hpp>
#include <set>

#include "bench/console/terminal.h"
#include "sensor-hal/config/json_text.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;

/// YAML files that a rig names are looked into as well, so deep.
constexpr int kDepth = 4;
constexpr std::uintmax_t kLargestRead = 1u << 20;

bool stat_of(const fs::path& file, struct stat& info) { return ::stat(file.c_str(), &info) == 0; }

/// The nearest folder on the way to `file` that is there.
fs::path folder_on_the_way(const fs::path& file) {
  std::error_code ec;
  fs::path folder = fs::absolute(file, ec).parent_path();
  while (folder.has_relative_path() && !fs::exists(fs::symlink_status(folder, ec)))
    folder = folder.parent_path();
  return folder;
}

Status check_folder(const fs::path& file) {
  std::error_code ec;
  const fs::path folder = folder_on_the_way(file);
  if (!fs::is_directory(folder, ec))
    return fail(ErrorCode::not_writable, file.string(),
                "expected a name in a folder, got " + folder.string() + " on the way, which is none");
  if (::access(folder.c_str(), W_OK | X_OK) != 0)
    return fail(ErrorCode::not_writable, file.string(),
                fmt::format("expected a folder that can be written, got {}: {}", folder.string(),
                            std::strerror(errno)));
  return {};
}

bool is_being_written(const fs::path& file) {
  const int fd = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) return false;
  const bool busy = ::flock(fd, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK;
  ::close(fd);
  return busy;
}

// ---- files that are not whole yet, removed by a signal that ends the process ----

constexpr std::array kEnding{SIGINT, SIGTERM, SIGHUP, SIGQUIT};
std::atomic<const char*> g_part{nullptr};

extern "C" void rigor_remove_part(int number) {
  if (const char* part = g_part.load()) ::unlink(part);
  ::signal(number, SIG_DFL);
  ::raise(number);
}

class PartFile {
 public:
  explicit PartFile(fs::path path) : path_(std::move(path)) {
    g_part.store(path_.c_str());
    struct sigaction action {};
    action.sa_handler = rigor_remove_part;
    for (std::size_t i = 0; i < kEnding.size(); ++i) {
      ::sigaction(kEnding[i], nullptr, &old_[i]);
      taken_[i] = (old_[i].sa_flags & SA_SIGINFO) == 0 && old_[i].sa_handler == SIG_DFL &&
                  ::sigaction(kEnding[i], &action, nullptr) == 0;
    }
  }
  ~PartFile() {
    for (std::size_t i = 0; i < kEnding.size(); ++i)
      if (taken_[i]) ::sigaction(kEnding[i], &old_[i], nullptr);
    g_part.store(nullptr);
    std::error_code ec;
    if (!path_.empty()) fs::remove(path_, ec);
  }
  PartFile(const PartFile&) = delete;
  PartFile& operator=(const PartFile&) = delete;
  [[nodiscard]] const fs::path& path() const { return path_; }

 private:
  fs::path path_;
  std::array<struct sigaction, kEnding.size()> old_{};
  std::array<bool, kEnding.size()> taken_{};
};

/// The files that a report of an earlier run consists of.
std::vector<std::string> report_files_in(const fs::path& dir) {
  std::vector<std::string> names;
  std::error_code ec;
  for (const char* name : {"index.html", "result.json"})
    if (fs::exists(dir / name, ec)) names.emplace_back(name);
  std::string text;
  if (std::FILE* file = std::fopen((dir / "result.json").c_str(), "re")) {
    std::array<char, 65536> block{};
    for (std::size_t n = 0; (n = std::fread(block.data(), 1, block.size(), file)) > 0;)
      text.append(block.data(), n);
    std::fclose(file);
  }
  const nlohmann::json result = parse_json(text).value_or(nlohmann::json());
  if (!result.is_object() || !result.contains("channels") || !result["channels"].is_array()) return names;
  for (const auto& channel : result["channels"]) {
    if (!channel.is_object() || !channel.contains("pictures") || !channel["pictures"].is_array()) continue;
    for (const auto& picture : channel["pictures"]) {
      const std::string name = picture.is_object() ? picture.value("file", "") : "";
      if (!name.empty() && fs::path(name).filename() == name && fs::exists(dir / name, ec))
        names.push_back(name);
    }
  }
  return names;
}

Status move_file(const fs::path& from, const fs::path& to) {
  if (::rename(from.c_str(), to.c_str()) != 0) return tl::unexpected<Error>(output_error(to, errno));
  return {};
}

}  // namespace

void InputFiles::add(const std::string& what, const fs::path& file) {
  struct stat info {};
  if (file.empty() || !stat_of(file, info) || S_ISDIR(info.st_mode)) return;
  files_.push_back({what, file.string(), info.st_dev, info.st_ino});
}

std::vector<std::string> InputFiles::names() const {
  std::set<std::string> names;
  for (const File& file : files_) names.insert(fs::path(file.name).lexically_normal().string());
  return {names.begin(), names.end()};
}

void InputFiles::add_rig(const RigConfig& rig) {
  add("the rig", rig.file);
  add("the rig's world", rig.simulation.world);
  for (const NamedFile& plugin : rig.simulation.plugins) add("a plugin of the world", plugin.file);
  const auto look = [&](const ConfigNode& node, const std::string& what) {
    if (node.present()) add_named_in(node.dump(), node.base_dir(), what, 0);
  };
  for (const auto& c : rig.channels) look(c.node, "what channel `" + c.name + "` reads");
  for (const auto& s : rig.sinks) look(s.node, "what sink `" + s.name + "` reads");
  for (const auto& e : rig.emulators) look(e.node, "what emulator `" + e.name + "` reads");
  for (const auto& p : rig.simulation.platforms) look(p.node, "what platform `" + p.name + "` reads");
  look(rig.application_params, "what the application reads");
  if (const auto& world = rig.simulation.world; world.extension() == ".yaml") {
    std::error_code ec;
    if (fs::file_size(world, ec) > kLargestRead || ec) return;
    if (const auto node = ConfigDocument::load(world))
      add_named_in(node->dump(), world.parent_path(), "what the world reads", 1);
  }
}

void InputFiles::add_named_in(const std::string& text, const fs::path& base_dir, const std::string& what,
                              int depth) {
  std::set<std::string> words;
  const std::string marks = " \t\r\n,[]{}\"'";
  std::string previous;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t begin = text.find_first_not_of(marks, at);
    if (begin == std::string::npos) break;
    const std::size_t end = std::min(text.find_first_of(marks, begin), text.size());
    std::string word = text.substr(begin, end - begin);
    // What an application or a channel writes itself is no input.
    if (previous != "output:" && previous != "log:" && word.size() > 2 && word.back() != ':' &&
        word.find_first_of("./") != std::string::npos)
      words.insert(word);
    previous = std::move(word);
    at = end;
  }
  // Names with blanks: whatever stands behind a key.
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const std::string line = text.substr(at, end - at);
    if (const auto colon = line.find(": "); colon != std::string::npos) {
      std::string value = line.substr(colon + 2);
      if (value.size() > 1 && (value.front() == '"' || value.front() == '\''))
        value = value.substr(1, value.size() - 2);
      if (value.find(' ') != std::string::npos && value.find_first_of("{[") == std::string::npos)
        words.insert(value);
    }
    at = end + 1;
  }
  std::error_code ec;
  for (const std::string& word : words) {
    const fs::path file = base_dir / word;
    if (!fs::is_regular_file(file, ec)) continue;
    add(what, file);
    if (depth >= kDepth || file.extension() != ".yaml" || fs::file_size(file, ec) > kLargestRead) continue;
    if (const auto node = ConfigDocument::load(file))
      add_named_in(node->dump(), file.parent_path(), what, depth + 1);
  }
}

Status Outputs::add(const fs::path& file, std::string_view option, Existing existing) {
  if (file.empty()) return fail(ErrorCode::bad_input, std::string(option), "expected a file, got \"\"");
  const fs::path target = resolve_links(file);
  struct stat info {};
  if (stat_of(target, info)) {
    if (S_ISDIR(info.st_mode))
      return fail(ErrorCode::not_writable, file.string(), "expected the name of a file, got a folder");
    for (const auto& in : inputs_.files_)
      if (in.device == info.st_dev && in.inode == info.st_ino)
        return fail(ErrorCode::bad_input, file.string(),
                    fmt::format("expected another file than {} ({}), which would be lost, got the same one; "
                                "give another name with {}",
                                in.what, in.name, option));
    if (!S_ISREG(info.st_mode) && !S_ISCHR(info.st_mode))
      return fail(ErrorCode::not_writable, file.string(),
                  "expected a file or a name that is not taken, got a pipe, a socket or a disk");
    if (S_ISREG(info.st_mode)) {
      if (existing == Existing::refuse)
        return fail(
            ErrorCode::not_writable, file.string(),
            fmt::format("expected a name that is not taken, a file is there; give another with {}, or "
                        "--force writes over it",
                        option));
      if (is_being_written(target))
        return fail(ErrorCode::not_writable, file.string(),
                    fmt::format("another run is writing this recording; give another with {}", option));
    }
    if (existing == Existing::replace && ::access(target.c_str(), W_OK) != 0)
      return tl::unexpected<Error>(output_error(file, errno));
  } else if (errno != ENOENT && errno != ENOTDIR) {
    return fail(ErrorCode::not_writable, file.string(),
                fmt::format("expected a file that can be written: {}; give another with {}",
                            std::strerror(errno), option));
  }
  if (!S_ISCHR(info.st_mode))
    if (auto s = check_folder(target); !s) return s;
  std::error_code ec;
  const fs::path whole = fs::weakly_canonical(fs::absolute(target, ec), ec);
  if (std::find(outputs_.begin(), outputs_.end(), whole) != outputs_.end() && !S_ISCHR(info.st_mode))
    return fail(
        ErrorCode::bad_input, file.string(),
        fmt::format("expected a file of its own for {}, got one that another output goes to", option));
  outputs_.push_back(whole);
  return {};
}

Status Outputs::add_report(const fs::path& dir) {
  std::error_code ec;
  if (fs::exists(dir, ec) && !fs::is_directory(dir, ec))
    return fail(ErrorCode::not_writable, dir.string(),
                "expected a folder for the report, got a file; give another with --report");
  for (const char* name : {"index.html", "result.json"})
    if (auto s = add(dir / name, "--report", Existing::keep); !s) return s;
  return {};
}

Error output_error(const fs::path& file, int error) {
  if (error == ENOSPC || error == EDQUOT || error == EFBIG)
    return {ErrorCode::disk_full, file.string(),
            fmt::format("no space is left to write this file ({}); make room, or write elsewhere",
                        std::strerror(error))};
  const bool medium = error == EIO;
  return {medium ? ErrorCode::io : ErrorCode::not_writable, file.string(),
          fmt::format("this file cannot be written: {}", std::strerror(error))};
}

Status write_bytes(const fs::path& part, std::string_view bytes) {
  const int fd = ::open(part.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (fd < 0) return tl::unexpected<Error>(output_error(part, errno));
  int error = 0;
  while (!bytes.empty() && error == 0) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n > 0)
      bytes.remove_prefix(static_cast<std::size_t>(n));
    else if (n == 0 || errno != EINTR)
      error = n == 0 ? ENOSPC : errno;
  }
  if (error == 0 && ::fdatasync(fd) != 0 && errno != EINVAL && errno != EROFS) error = errno;
  if (::close(fd) != 0 && error == 0) error = errno;
  if (error != 0) return tl::unexpected<Error>(output_error(part, error));
  return {};
}

Status write_output(const fs::path& file, const std::function<Status(const fs::path&)>& write) {
  const fs::path target = resolve_links(file);
  const auto named = [&](Status s, const fs::path& part) {
    if (!s && s.error().where == part.string()) s.error().where = file.string();
    return s;
  };
  struct stat info {};
  const bool there = stat_of(target, info);
  if (there && S_ISCHR(info.st_mode)) return named(write(target), target);
  std::error_code ec;
  if (target.has_parent_path()) fs::create_directories(target.parent_path(), ec);
  if (ec) return tl::unexpected<Error>(output_error(file, ec.value()));
  const PartFile part(part_name(target));
  if (auto s = named(write(part.path()), part.path()); !s) return s;
  if (there) ::chmod(part.path().c_str(), info.st_mode & 07777);
  return named(move_file(part.path(), target), target);
}

Status write_output(const fs::path& file, std::string_view bytes) {
  return write_output(file, [&](const fs::path& part) { return write_bytes(part, bytes); });
}

Result<fs::path> keep_earlier(const fs::path& file) {
  const fs::path target = resolve_links(file);
  struct stat info {};
  if (!stat_of(target, info) || !S_ISREG(info.st_mode)) return fs::path();
  const fs::path kept = next_number(target);
  if (auto s = move_file(target, kept); !s) return tl::unexpected<Error>(s.error());
  write_stderr(fmt::format("rigor: the earlier {} is kept as {}\n", file.string(), kept.string()));
  return kept;
}

Status keep_earlier_files(const fs::path& dir, const std::vector<std::string>& names) {
  if (names.empty()) return {};
  std::error_code ec;
  const fs::path kept = next_number(dir / "");
  fs::create_directory(kept, ec);
  if (ec) return tl::unexpected<Error>(output_error(kept, ec.value()));
  for (const std::string& name : names)
    if (auto s = move_file(dir / name, kept / name); !s) return s;
  write_stderr(fmt::format("rigor: the earlier report in {} is kept as {}\n", dir.string(),
                           (kept / names.front()).string()));
  return {};
}

Status write_report_files(const fs::path& dir, const std::vector<std::pair<std::string, std::string>>& files,
                          Existing existing) {
  std::error_code ec;
  fs::create_directories(dir, ec);
  if (ec) return tl::unexpected<Error>(output_error(dir, ec.value()));
  const fs::path part = dir / fmt::format(".report.{}.part", ::getpid());
  const auto clean = [&] { fs::remove_all(part, ec); };
  clean();
  fs::create_directory(part, ec);
  if (ec) return tl::unexpected<Error>(output_error(dir, ec.value()));
  for (const auto& [name, bytes] : files)
    if (auto s = write_bytes(part / name, bytes); !s) {
      clean();
      s.error().where = (dir / name).string();
      return s;
    }
  // Two commands with one folder: one after the other.
  const int lock = ::open(dir.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (lock >= 0) ::flock(lock, LOCK_EX);
  const Status moved = [&]() -> Status {
    if (existing != Existing::replace)
      if (auto s = keep_earlier_files(dir, report_files_in(dir)); !s) return s;
    for (auto it = files.begin(); it != files.end(); ++it)
      if (auto s = move_file(part / it->first, dir / it->first); !s) return s;
    return {};
  }();
  if (lock >= 0) ::close(lock);
  clean();
  return moved;
}

fs::path resolve_links(const fs::path& file) {
  fs::path at = file;
  std::error_code ec;
  for (int i = 0; i < 40 && fs::is_symlink(fs::symlink_status(at, ec)); ++i) {
    const fs::path to = fs::read_symlink(at, ec);
    if (ec) break;
    at = at.parent_path() / to;  // an absolute one replaces all
  }
  return at;
}

fs::path part_name(const fs::path& file) {
  // The name need not be short enough for an addition.
  return file.parent_path() / fmt::format(".{}.{}.part{}", file.stem().string().substr(0, 60), ::getpid(),
                                          file.extension().string());
}

fs::path next_number(const fs::path& file) {
  const std::string stem = file.stem().string(), ending = file.extension().string();
  const std::string begin = stem.empty() ? "" : stem + ".";
  const fs::path folder = file.has_parent_path() ? file.parent_path() : fs::path(".");
  unsigned long greatest = 0;
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(folder, ec)) {
    const std::string name = entry.path().filename().string();
    if (name.size() <= begin.size() + ending.size() || !name.starts_with(begin) || !name.ends_with(ending))
      continue;
    const char *from = name.data() + begin.size(), *to = name.data() + name.size() - ending.size();
    unsigned long n = 0;
    if (const auto [last, wrong] = std::from_chars(from, to, n); wrong == std::errc{} && last == to)
      greatest = std::max(greatest, n);
  }
  return file.parent_path() / fmt::format("{}{}{}", begin, greatest + 1, ending);
}

}  // namespace rigor
