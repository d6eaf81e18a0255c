#include "cli/run_report_output.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <chrono>
#include <cstdio>
#include <thread>

#include "bench/console/terminal.h"
#include "bench/live/server.h"

namespace rigor {

int print_report(const RunReport& report, bool json) {
  if (json) {
    fmt::print("{}\n", report.json());
  } else {
    fmt::print("{}", report.text());
    if (!report.page.empty()) fmt::print("report    {}\n", report.page.string());
    if (!report.trace.empty()) fmt::print("trace     {}\n", report.trace.string());
  }
  if (!report.replay_difference.empty())
    (void)report_error({ErrorCode::internal, "replay", report.replay_difference}, false);
  for (const Error& e : report.errors) (void)report_error(e, false);
  for (const Finding& f : report.verdict.findings)
    if (const FindingSet failed = f.kinds.both(report.failed_on); !failed.empty())
      write_stderr(
          fmt::format("rigor: failed by --fail-on {}: {}\n", fmt::join(failed.names(), ","), f.sentence));
  for (const Expected& e : report.expected)
    if (e.fails()) write_stderr(fmt::format("rigor: not as expected: {}\n", e.sentence()));
  return report.passed() ? 0 : 1;
}

void wait_for_live_end(const live::Server& server, const StopToken& stop) {
  std::fflush(stdout);
  write_stderr(fmt::format("live      {} stays until Ctrl-C\n", server.url()));
  while (!stop.stop_requested()) std::this_thread::sleep_for(std::chrono::milliseconds(50));
}

void print_warning(const std::string& text) { write_stderr("rigor: warning: " + text + "\n"); }

}  // namespace rigor
