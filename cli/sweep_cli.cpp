#include "cli/sweep_cli.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/dataset/dataset_texts.h"
#include "bench/sweep/sweep.h"
#include "bench/world/world_plugins.h"
#include "builtin/registry.h"
#include "cli/command_options.h"

namespace rigor {
namespace {

/// As they were typed; empty: not given.
struct Words : sweep::Texts {
  std::filesystem::path output;
  std::string jobs, index, every;
  std::vector<std::string> sbatch;
  double timeout_s = 0;
  bool plan = false, report = false, slurm = false, retry = false, json = false;
};

int print_results(const sweep::Sweep& sweep, const Words& w) {
  const sweep::Outcome o = sweep.outcome();
  if (w.json)
    fmt::print("{}\n", nlohmann::json{{"runs", o.runs},
                                      {"passed", o.passed},
                                      {"failed", o.failed},
                                      {"error", o.error},
                                      {"crashed", o.crashed},
                                      {"timeout", o.timeout},
                                      {"not_run", o.not_run},
                                      {"table", sweep.table().string()},
                                      {"report", sweep.page().string()}}
                           .dump());
  else
    fmt::print("{}\ntable     {}\nreport    {}\n", o.text(), sweep.table().string(), sweep.page().string());
  return o.all_passed() ? 0 : 1;
}

int print_jobs(const sweep::SlurmJobs& jobs, const Words& w) {
  if (w.json) {
    fmt::print("{}\n", nlohmann::json{{"array", jobs.array},
                                      {"report", jobs.report},
                                      {"tasks", jobs.tasks},
                                      {"commands", jobs.commands}}
                           .dump());
    return 0;
  }
  for (const std::string& command : jobs.commands) fmt::print("{}\n", command);
  if (jobs.array.empty())
    fmt::print("all runs are there; job {} writes table and report\n", jobs.report);
  else
    fmt::print("job {} has {} tasks, job {} writes table and report after them\n", jobs.array, jobs.tasks,
               jobs.report);
  return 0;
}

/// What belongs together, and what does not.
Status check_words(const Words& w) {
  const int ways = int{!w.index.empty()} + int{w.report} + int{w.slurm} + int{w.plan};
  if (ways > 1)
    return fail(ErrorCode::bad_input, "--index, --report, --slurm, --plan",
                "expected one of them, got several");
  if (w.rig.empty() && (!w.vary.empty() || !w.overrides.empty() || !w.seeds.empty() || !w.samples.empty() ||
                        !w.duration.empty()))
    return fail(
        ErrorCode::bad_input, "RIG",
        "expected the rig with the options that say what is varied; a sweep that was begun goes on with "
        "-o alone");
  if (!w.every.empty() && w.index.empty())
    return fail(ErrorCode::bad_input, "--every", "expected it with --index");
  if (!w.sbatch.empty() && !w.slurm)
    return fail(ErrorCode::bad_input, "--sbatch", "expected it with --slurm");
  return {};
}

int make(Words w) {
  const auto wrong = [&](const Error& e) { return report_error(e, w.json); };
  if (auto s = check_words(w); !s) return wrong(s.error());
  std::optional<SweepOptions> options;
  if (!w.rig.empty()) {
    for (const NamedFile& plugin : command_plugins()) w.plugins.push_back(plugin.file);
    auto read = sweep::read_options(w);
    if (!read) return wrong(read.error());
    options = std::move(*read);
  }
  sweep::Work work;
  work.timeout_s = w.timeout_s;
  std::uint64_t index = 0, every = 0, jobs = 0;
  const auto number = [&](const std::string& text, const char* option, std::uint64_t most,
                          std::uint64_t& out) {
    if (text.empty()) return Status{};
    const auto value = whole_number(text, option, 1, most);
    if (value) out = *value;
    return value ? Status{} : tl::unexpected<Error>(value.error());
  };
  if (auto s = number(w.jobs, "--jobs", 1024, jobs); !s) return wrong(s.error());
  if (auto s = number(w.every, "--every", SweepOptions::kMostRuns, every); !s) return wrong(s.error());
  if (!w.index.empty()) {
    const auto read = sweep::read_index(w.index);
    if (!read) return wrong(read.error());
    index = *read;
  }
  work.jobs = static_cast<unsigned>(jobs);

  // A task of an array may begin before the submission of it has ended.
  using Hold = sweep::Folder::Hold;
  const Hold hold = !w.index.empty() || w.report || w.slurm ? Hold::shared : Hold::alone;
  auto opened = sweep::Sweep::open(w.output, options, hold, make_registry());
  if (!opened) return wrong(opened.error());
  if (w.retry) opened->retry();
  if (w.plan) {
    if (w.json)
      fmt::print("{}\n", nlohmann::json{{"runs", opened->plan().size()}}.dump());
    else
      fmt::print("{} runs: rigor sweep -o {} --index 0 to {}\n", opened->plan().size(), w.output.string(),
                 opened->plan().size() - 1);
    return 0;
  }
  if (w.slurm) {
    const auto submitted = opened->submit(w.sbatch, w.timeout_s);
    return submitted ? print_jobs(*submitted, w) : wrong(submitted.error());
  }
  StopSource stop;
  const SignalStop signals(stop);
  work.stop = stop.token();
  if (!w.index.empty()) {
    const auto made = opened->make_some(index, every, work);
    return made ? 0 : wrong(made.error());
  }
  if (!w.report)
    if (auto s = opened->make(work); !s) return wrong(s.error());
  if (auto s = opened->write_results(); !s) return wrong(s.error());
  return print_results(*opened, w);
}

}  // namespace

struct SweepCommandLine::Impl {
  explicit Impl(CLI::App& app)
      : command(app, "sweep",
                "Make many runs of a rig in virtual time, over its values and seeds: a table and a report") {}
  CommandOptions command;
  Words words;
};

SweepCommandLine::SweepCommandLine(CLI::App& app) : impl_(std::make_unique<Impl>(app)) {
  CommandOptions& c = impl_->command;
  Words& w = impl_->words;
  c.add_option("RIG", w.rig, "Rig file or name (default: go on with the sweep in the folder)").config_file();
  c.add_option("-o,--output", w.output, "Folder; a sweep that was begun there with the same options goes on")
      .required();
  c.add_option(
       "--vary", w.vary,
       "KEY=VALUES of the rig: channels.right.exposure_us=1000..8000:8, simulation.weather=clear,fog, "
       "KEY=log:1..100:5; all combinations are run (may be repeated)")
      .one_each();
  c.add_option("--set", w.overrides,
               "Replace one value of the rig in all runs: path.to.key=value (may be repeated)")
      .one_each();
  c.add_option("--seeds", w.seeds, "Runs of each combination, with seeds from the rig's own on (default 1)");
  c.add_option("--sample", w.samples,
               "So many Latin hypercube samples of what varies, in place of all combinations");
  c.add_option("--seed", w.draw_seed, "Of the draws of --sample (default 1)");
  c.add_option("--duration", w.duration, "Seconds of each run (default: what the rig says)");
  c.add_option("--jobs", w.jobs, "Runs at once (default: as many as there are processors)");
  c.add_option("--timeout", w.timeout_s,
               "Seconds after which a run is ended and counts as one that took too long; 0: never")
      .not_negative();
  c.add_flag("--retry", w.retry,
             "Make those runs again that crashed, broke off, could not run, or took too long");
  c.add_flag("--plan", w.plan, "Write the manifest alone: the runs are made by --index");
  c.add_option(
      "--index", w.index,
      "Make this run alone, for job arrays and GNU parallel; auto: JOB_COMPLETION_INDEX of Kubernetes, or "
      "SLURM_ARRAY_TASK_ID");
  c.add_option("--every", w.every, "With --index: and every so-manieth run after it");
  c.add_flag("--report", w.report, "Write table and report of the runs that are there");
  c.add_flag("--slurm", w.slurm, "Submit the runs to Slurm as a job array, and a job for the report");
  c.add_option("--sbatch", w.sbatch, "With --slurm: a word for sbatch, such as --time=10 (may be repeated)")
      .one_each();
  c.add_flag("--json", w.json, "Print what came of it as JSON");
  c.footer(
      "Examples: rigor sweep demo --vary channels.right.exposure_us=1000..8000:8 --seeds 20 -o exposure\n"
      "          rigor sweep -o exposure --index 17\n"
      "Exit status: 1 where a run did not pass.");
}

SweepCommandLine::~SweepCommandLine() = default;
bool SweepCommandLine::chosen() const { return impl_->command.parsed(); }
int SweepCommandLine::run() const { return make(impl_->words); }

}  // namespace rigor
