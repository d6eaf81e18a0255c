#include "bench/sweep/sweep.h"

#include <fmt/format.h>

#include <cmath>
#include <cstdlib>
#include <limits>
#include <utility>

#include "bench/console/progress.h"
#include "bench/dataset/dataset_texts.h"
#include "bench/files/output_file.h"
#include "bench/sweep/sweep_table.h"

namespace rigor::sweep {

Result<SweepOptions> read_options(const Texts& t) {
  SweepOptions o;
  o.rig = t.rig;
  o.plugins = t.plugins;
  for (const std::string& text : t.overrides) {
    auto one = ConfigOverride::parse(text);
    if (!one) return tl::unexpected<Error>(one.error());
    o.overrides.push_back(std::move(*one));
  }
  for (const std::string& text : t.vary) {
    auto one = SweepParameter::parse(text);
    if (!one) return tl::unexpected<Error>(one.error());
    o.vary.push_back(std::move(*one));
  }
  const auto read = [](const std::string& text, const char* option, std::uint64_t least, std::uint64_t most,
                       std::uint64_t& out) -> Status {
    if (text.empty()) return {};
    const auto value = whole_number(text, option, least, most);
    if (!value) return tl::unexpected<Error>(value.error());
    out = *value;
    return {};
  };
  if (auto s = read(t.seeds, "--seeds", 1, SweepOptions::kMostRuns, o.seeds); !s)
    return tl::unexpected<Error>(s.error());
  if (auto s = read(t.samples, "--sample", 1, SweepOptions::kMostRuns, o.samples); !s)
    return tl::unexpected<Error>(s.error());
  if (!t.draw_seed.empty() && t.samples.empty())
    return fail(
        ErrorCode::bad_input, "--seed",
        "expected it with --sample, whose draws it is of; the seeds of runs are --seeds and --set seed=…");
  if (auto s = read(t.draw_seed, "--seed", 0, std::numeric_limits<std::int64_t>::max(), o.draw_seed); !s)
    return tl::unexpected<Error>(s.error());
  if (!t.duration.empty()) {
    const auto duration = dataset::Interval::parse({t.duration, "--duration"}, 1e-6, 1e7);
    if (!duration || duration->from != duration->to)
      return fail(ErrorCode::bad_input, "--duration",
                  fmt::format("expected seconds, more than 0 and at most 1e7, got \"{}\"", t.duration));
    o.duration_s = duration->from;
  }
  return o;
}

Result<std::uint64_t> read_index(const std::string& text) {
  if (text != "auto") return whole_number(text, "--index", 0, SweepOptions::kMostRuns - 1);
  for (const char* name : {"JOB_COMPLETION_INDEX", "SLURM_ARRAY_TASK_ID"})
    if (const char* value = std::getenv(name))
      return whole_number(value, fmt::format("--index auto ({})", name), 0, SweepOptions::kMostRuns - 1);
  return fail(ErrorCode::bad_input, "--index",
              "expected JOB_COMPLETION_INDEX or SLURM_ARRAY_TASK_ID in the environment, found neither");
}

Result<Sweep> Sweep::open(const std::filesystem::path& dir, const std::optional<SweepOptions>& options,
                          Folder::Hold hold, const Registry& registry) {
  // All that can be refused is refused before the folder is made.
  std::optional<SweepPlan> wanted;
  if (options) {
    auto plan = SweepPlan::create(*options);
    if (!plan) return tl::unexpected<Error>(plan.error());
    wanted = std::move(*plan);
  }
  std::error_code ec;
  const bool begun = std::filesystem::exists(dir / "sweep.json", ec);
  if (!begun && !wanted)
    return fail(ErrorCode::not_found, dir.string(),
                "expected the folder of a sweep, found no sweep.json in it; give the RIG to begin one");
  if (!begun) {
    const ProgressTask checking("check the values");
    if (auto s = wanted->check(registry); !s) return tl::unexpected<Error>(s.error());
  }
  auto folder = Folder::open(dir, hold);
  if (!folder) return tl::unexpected<Error>(folder.error());
  if (wanted) {
    if (auto s = folder->begin(*wanted); !s) return tl::unexpected<Error>(s.error());
  } else {
    auto there = folder->plan();
    if (!there) return tl::unexpected<Error>(there.error());
    wanted = std::move(*there);
  }
  return Sweep(std::move(*folder), std::move(*wanted));
}

void Sweep::read_rows() {
  if (rows_.empty()) rows_ = folder_.rows(plan_);
}

void Sweep::retry() {
  read_rows();
  for (std::uint64_t i = 0; i < rows_.size(); ++i)
    if (rows_[i] && rows_[i]->may_be_retried()) {
      folder_.remove_row(i);
      rows_[i].reset();
    }
}

Status Sweep::make(const Work& work) {
  read_rows();
  return make_runs(plan_, folder_, rows_, work);
}

Status Sweep::make_some(std::uint64_t index, std::uint64_t every, const Work& work) {
  if (index >= plan_.size())
    return fail(ErrorCode::bad_input, "--index",
                fmt::format("expected one of the runs 0 to {}, got {}", plan_.size() - 1, index));
  for (std::uint64_t i = index; i < plan_.size(); i += every == 0 ? plan_.size() : every) {
    if (folder_.row(i)) continue;
    if (const auto row = make_run(plan_, folder_, i, work); !row) return tl::unexpected<Error>(row.error());
  }
  return {};
}

Result<SlurmJobs> Sweep::submit(const std::vector<std::string>& options, double timeout_s) {
  read_rows();
  return submit_to_slurm(folder_, rows_, options, timeout_s);
}

Status Sweep::write_results() {
  read_rows();
  if (auto s = write_output(table(), table_text(plan_, rows_)); !s) return s;
  return write_output(page(), report_page(plan_, rows_));
}

}  // namespace rigor::sweep
