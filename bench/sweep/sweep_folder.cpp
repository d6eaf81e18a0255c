#include "bench/sweep/sweep_folder.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <utility>

#include "bench/files/manifest.h"
#include "bench/files/output_file.h"
#include "sensor-hal/config/json_text.h"

namespace rigor::sweep {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char *kManifest = "sweep.json", *kRuns = "runs", *kWork = "work", *kLock = ".lock";

json read_json(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(in), {}};
  return parse_json(text).value_or(json());
}

/// Only a sweep goes on in a folder that is not empty.
Status check_contents(const fs::path& dir) {
  std::error_code ec;
  if (fs::exists(dir / kManifest, ec)) return {};
  for (const auto& entry : fs::directory_iterator(dir, ec)) {
    const std::string name = entry.path().filename().string();
    if (name != kRuns && name != kWork && !name.starts_with("."))
      return fail(ErrorCode::bad_input, dir.string(),
                  fmt::format("expected an empty folder or a sweep, got one with {} in it; give another with "
                              "-o",
                              name));
  }
  return {};
}

/// A renamed file's name is on the medium when its folder is.
void sync_folder(const fs::path& dir) {
  const int fd = ::open(dir.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  (void)::fsync(fd);
  ::close(fd);
}

}  // namespace

Result<Folder> Folder::open(const fs::path& given, Hold hold) {
  std::error_code ec;
  const fs::path dir = fs::absolute(given, ec).lexically_normal();
  fs::create_directories(dir, ec);
  if (ec) return tl::unexpected<Error>(output_error(given, ec.value()));
  if (auto s = check_contents(dir); !s) return tl::unexpected<Error>(s.error());
  const int lock = ::open((dir / kLock).c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (lock < 0) return tl::unexpected<Error>(output_error(dir / kLock, errno));
  Folder folder(dir, lock);
  if (::flock(lock, (hold == Hold::alone ? LOCK_EX : LOCK_SH) | LOCK_NB) != 0) {
    if (errno == EWOULDBLOCK)
      return fail(ErrorCode::bad_input, given.string(),
                  "another process makes runs of this sweep; wait for it, or give another folder with -o");
    return tl::unexpected<Error>(output_error(dir / kLock, errno));
  }
  for (const char* sub : {kRuns, kWork}) {
    fs::create_directories(dir / sub, ec);
    if (ec) return tl::unexpected<Error>(output_error(dir / sub, ec.value()));
  }
  if (hold == Hold::alone)
    for (const auto& left : fs::directory_iterator(dir / kWork, ec)) fs::remove_all(left.path(), ec);
  return folder;
}

Folder::Folder(Folder&& o) noexcept : dir_(std::move(o.dir_)), lock_(std::exchange(o.lock_, -1)) {}
Folder::~Folder() {
  if (lock_ >= 0) ::close(lock_);
}

Result<std::optional<SweepPlan>> Folder::plan() const {
  const fs::path file = dir_ / kManifest;
  std::error_code ec;
  if (!fs::exists(file, ec)) return std::optional<SweepPlan>{};
  auto plan = SweepPlan::from_manifest(read_json(file), file.string());
  if (!plan) return tl::unexpected<Error>(plan.error());
  return std::optional<SweepPlan>(std::move(*plan));
}

Status Folder::begin(const SweepPlan& plan) const {
  const fs::path file = dir_ / kManifest;
  std::error_code ec;
  const json manifest = plan.manifest();
  if (!fs::exists(file, ec)) {
    if (auto s = write_output(file, manifest.dump(2) + "\n"); !s) return s;
    sync_folder(dir_);
    return {};
  }
  const std::string difference = manifest_difference(read_json(file), manifest);
  if (difference.empty()) return {};
  return fail(
      ErrorCode::bad_input, file.string(),
      "expected a folder of the same sweep, to go on with; " + difference + "; give another folder with -o");
}

fs::path Folder::row_file(std::uint64_t index) const {
  return dir_ / kRuns / fmt::format("{:06}.json", index);
}

std::optional<Row> Folder::row(std::uint64_t index) const {
  auto row = row_from_json(read_json(row_file(index)));
  return row && row->index == index ? row : std::nullopt;
}

std::vector<std::optional<Row>> Folder::rows(const SweepPlan& plan) const {
  std::vector<std::optional<Row>> rows(plan.size());
  for (std::uint64_t i = 0; i < plan.size(); ++i) rows[i] = row(i);
  return rows;
}

Result<fs::path> Folder::make_work_folder() const {
  std::string name = (dir_ / kWork / "run-XXXXXX").string();
  if (!::mkdtemp(name.data())) return tl::unexpected<Error>(output_error(dir_ / kWork, errno));
  return fs::path(name);
}

Status Folder::finish(const Row& row, const fs::path& work) const {
  const fs::path part = work / ".row.json", file = row_file(row.index);
  std::error_code ec;
  // What the run left makes room first.
  for (const auto& left : fs::directory_iterator(work, ec)) fs::remove_all(left.path(), ec);
  auto written = write_bytes(part, to_json(row).dump(-1, ' ', false, json::error_handler_t::replace) + "\n");
  if (written && ::rename(part.c_str(), file.c_str()) != 0)
    written = tl::unexpected<Error>(output_error(file, errno));
  fs::remove_all(work, ec);
  if (!written) {
    written.error().where = file.string();
    return written;
  }
  sync_folder(dir_ / kRuns);
  return {};
}

void Folder::remove_row(std::uint64_t index) const {
  std::error_code ec;
  fs::remove(row_file(index), ec);
}

}  // namespace rigor::sweep
