#include "bench/sweep/run_sweep.h"

#include <fmt/format.h>
#include <sched.h>

#include <algorithm>
#include <atomic>
#include <mutex>
#include <string>
#include <thread>

#include "bench/console/progress.h"
#include "bench/files/installed_configs.h"
#include "bench/sweep/child_run.h"

namespace rigor::sweep {
namespace {

unsigned usable_processors() {
  cpu_set_t set;
  CPU_ZERO(&set);
  if (::sched_getaffinity(0, sizeof set, &set) == 0)
    return static_cast<unsigned>(std::max(1, CPU_COUNT(&set)));
  return std::max(1U, std::thread::hardware_concurrency());
}

}  // namespace

Result<Row> make_run(const SweepPlan& plan, const Folder& folder, std::uint64_t index, const Work& work) {
  Child child;
  child.program = installed_program();
  if (child.program.empty())
    return fail(
        ErrorCode::not_found, "sweep",
        "expected the program `rigor`, which makes the runs, in the prefix of this library, found none");
  auto place = folder.make_work_folder();
  if (!place) return tl::unexpected<Error>(place.error());
  child.words = plan.child_command(plan.run(index));
  child.directory = *place;
  child.timeout_s = work.timeout_s;
  const auto end = run_child(child, work.stop);
  auto row = end ? row_of(index, *end) : tl::unexpected<Error>(end.error());
  // A signal to all processes, as Slurm sends it, may end the run before it is known here.
  if (row && !row->passed() && work.stop.stop_requested())
    row = fail(ErrorCode::unavailable, fmt::format("run {}", index), "it was interrupted");
  if (!row) {
    std::error_code ec;
    std::filesystem::remove_all(*place, ec);
    return row;
  }
  if (auto s = folder.finish(*row, *place); !s) return tl::unexpected<Error>(s.error());
  return row;
}

Status make_runs(const SweepPlan& plan, const Folder& folder, std::vector<std::optional<Row>>& rows,
                 const Work& work) {
  std::vector<std::uint64_t> wanted;
  for (std::uint64_t i = 0; i < rows.size(); ++i)
    if (!rows[i]) wanted.push_back(i);
  if (wanted.empty()) return {};
  const std::size_t threads =
      std::min<std::size_t>(work.jobs == 0 ? usable_processors() : work.jobs, wanted.size());

  ProgressTask progress("sweep", static_cast<double>(wanted.size()), "runs");
  std::mutex mutex;
  std::size_t done = 0, bad = 0;
  std::optional<Error> error;
  std::atomic<std::size_t> next{0};
  StopSource broke_off;  // by an error of one thread, or by the caller's stop
  const auto make = [&] {
    Work own = work;
    own.stop = broke_off.token();
    while (!own.stop.stop_requested()) {
      const std::size_t k = next.fetch_add(1);
      if (k >= wanted.size()) return;
      auto row = make_run(plan, folder, wanted[k], own);
      const std::lock_guard lock(mutex);
      if (!row) {
        if (!error && !own.stop.stop_requested()) error = row.error();
        broke_off.request();
        return;
      }
      if (!row->passed()) ++bad;
      rows[wanted[k]] = std::move(*row);
      progress.set(static_cast<double>(++done));
      if (bad > 0) progress.note(fmt::format("{} did not pass", bad));
    }
  };
  std::vector<std::thread> workers;
  for (std::size_t i = 0; i < threads; ++i) workers.emplace_back(make);
  std::thread watch([&] {
    while (!broke_off.token().stop_requested()) {
      if (work.stop.stop_requested()) broke_off.request();
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
  });
  for (std::thread& worker : workers) worker.join();
  const bool all = done == wanted.size();
  broke_off.request();
  watch.join();
  if (all) {
    progress.finish();
    return {};
  }
  if (!error) error = Error{ErrorCode::unavailable, "sweep", "it was interrupted"};
  const auto made =
      static_cast<std::size_t>(std::ranges::count_if(rows, [](const auto& r) { return r.has_value(); }));
  error->message +=
      fmt::format("; {} of {} runs are there, and the same command goes on from there", made, rows.size());
  return tl::unexpected<Error>(*error);
}

}  // namespace rigor::sweep
