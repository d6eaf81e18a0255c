#include "bench/sweep/slurm.h"

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <set>
#include <sstream>

#include "bench/files/installed_configs.h"
#include "bench/files/output_file.h"
#include "bench/report/typed_command.h"
#include "bench/sweep/child_run.h"

namespace rigor::sweep {
namespace {

namespace fs = std::filesystem;

constexpr double kCommand_s = 60;  ///< a controller that is busy answers late

fs::path program_in_path(const std::string& name) {
  const char* path = std::getenv("PATH");
  std::istringstream folders(path ? path : "/usr/bin:/bin");
  for (std::string folder; std::getline(folders, folder, ':');)
    if (const fs::path file = fs::path(folder) / name; ::access(file.c_str(), X_OK) == 0) return file;
  return {};
}

/// Its standard output.
Result<std::string> ask(const std::vector<std::string>& words) {
  const fs::path program = program_in_path(words.front());
  if (program.empty())
    return fail(ErrorCode::not_found, "--slurm",
                fmt::format("expected Slurm's command {} on the path, found none", words.front()));
  const auto end = run_child({program, words, "/", kCommand_s}, {});
  if (!end) return tl::unexpected<Error>(end.error());
  if (end->how != ChildEnd::How::exited || end->status != 0) {
    std::string said = end->err;
    while (!said.empty() && said.back() == '\n') said.pop_back();
    std::ranges::replace(said, '\n', ';');
    return fail(ErrorCode::unavailable, "--slurm",
                fmt::format("{} refused: {}", words.front(), said.empty() ? "it said nothing" : said));
  }
  return end->out;
}

/// Tasks that an array may have; Slurm's own default where it does not say.
std::uint64_t most_tasks(const std::string& config) {
  constexpr std::uint64_t kDefault = 1001;
  const auto at = config.find("MaxArraySize");
  const auto equals = config.find('=', at);
  if (at == std::string::npos || equals == std::string::npos) return kDefault;
  const auto digit = config.find_first_of("0123456789", equals);
  std::uint64_t n = 0;
  if (digit == std::string::npos ||
      std::from_chars(config.data() + digit, config.data() + config.size(), n).ec != std::errc{} || n == 0)
    return kDefault;
  return n;
}

Status write_script(const fs::path& file, const std::vector<std::string>& words, const std::string& last) {
  const std::string text =
      fmt::format("#!/bin/sh\n# Written by `rigor sweep --slurm`.\nexec {}{}\n", quoted_command(words), last);
  if (auto s = write_output(file, text); !s) return s;
  ::chmod(file.c_str(), 0755);
  return {};
}

/// "123", or "123;cluster" with --parsable.
std::string job_number(const std::string& out) { return out.substr(0, out.find_first_of(";\n")); }

}  // namespace

std::string index_ranges(const std::vector<std::uint64_t>& numbers) {
  std::string out;
  for (std::size_t i = 0; i < numbers.size();) {
    std::size_t last = i;
    while (last + 1 < numbers.size() && numbers[last + 1] == numbers[last] + 1) ++last;
    out += out.empty() ? "" : ",";
    out += last == i ? fmt::format("{}", numbers[i]) : fmt::format("{}-{}", numbers[i], numbers[last]);
    i = last + 1;
  }
  return out;
}

Result<SlurmJobs> submit_to_slurm(const Folder& folder, const std::vector<std::optional<Row>>& rows,
                                  const std::vector<std::string>& options, double timeout_s) {
  const fs::path dir = folder.path(), program = installed_program();
  if (program.empty())
    return fail(ErrorCode::not_found, "--slurm",
                "expected the program `rigor` beside this library, found none");
  const auto config = ask({"scontrol", "show", "config"});
  if (!config) return tl::unexpected<Error>(config.error());
  SlurmJobs jobs;
  jobs.tasks = std::min<std::uint64_t>(rows.size(), most_tasks(*config));
  std::set<std::uint64_t> wanted;
  for (std::uint64_t i = 0; i < rows.size(); ++i)
    if (!rows[i]) wanted.insert(i % jobs.tasks);

  std::vector<std::string> unit{program.string(), "sweep", "-o",      dir.string(),
                                "--progress",     "none",  "--every", fmt::format("{}", jobs.tasks)};
  if (timeout_s > 0) unit.insert(unit.end(), {"--timeout", fmt::format("{}", timeout_s)});
  unit.emplace_back("--index");
  if (auto s = write_script(dir / "slurm" / "runs.sh", unit, " \"$SLURM_ARRAY_TASK_ID\""); !s)
    return tl::unexpected<Error>(s.error());
  if (auto s = write_script(dir / "slurm" / "report.sh",
                            {program.string(), "sweep", "-o", dir.string(), "--report"}, "");
      !s)
    return tl::unexpected<Error>(s.error());

  const auto submit = [&](const std::string& script, const std::string& log,
                          const std::vector<std::string>& more) -> Result<std::string> {
    std::vector<std::string> words{"sbatch",      "--parsable", "--job-name",
                                   "rigor-sweep", "--output",   (dir / "slurm" / log).string()};
    words.insert(words.end(), options.begin(), options.end());
    words.insert(words.end(), more.begin(), more.end());
    words.push_back((dir / "slurm" / script).string());
    jobs.commands.push_back(quoted_command(words));
    auto said = ask(words);
    return said ? Result<std::string>(job_number(*said)) : said;
  };
  if (!wanted.empty()) {
    auto array = submit("runs.sh", "%A_%a.txt", {"--array", index_ranges({wanted.begin(), wanted.end()})});
    if (!array) return tl::unexpected<Error>(array.error());
    jobs.array = *array;
  }
  jobs.tasks = wanted.size();
  auto report =
      submit("report.sh", "report.txt",
             jobs.array.empty() ? std::vector<std::string>{}
                                : std::vector<std::string>{"--dependency", "afterany:" + jobs.array});
  if (!report) return tl::unexpected<Error>(report.error());
  jobs.report = *report;
  return jobs;
}

}  // namespace rigor::sweep
