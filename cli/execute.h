// Runs an assembly from arm to report: what `rigor run` and `rigor replay` have in common.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "bench/files/output_file.h"
#include "bench/result/verdict.h"
#include "bench/run/assembly.h"
#include "rt-core/epoch.h"
#include "rt-core/stop.h"

namespace rigor {

namespace live {
class Server;
}

struct ExecuteOptions {
  bool json = false;
  Existing existing = Existing::keep;  ///< what becomes of an earlier recording, report and trace
  FindingSet fail_on;                  ///< findings of the verdict that fail the run
  bool control = false;                ///< may be talked to while it goes on (control_socket.h)
  live::Server* live = nullptr;        ///< shows how it goes (docs/live.md); null: nobody looks on
  bool live_stays = false;         ///< the page stays after the run has finished, until it is asked to stop
  double pace = 0;                 ///< virtual time: seconds in a second at most; 0: no limit
  std::filesystem::path trace;     ///< for Perfetto; empty: none
  std::filesystem::path junit;     ///< what the rig expects, as JUnit's XML; empty: none
  std::optional<BenchTime> t0;     ///< replay: the recorded one
  std::optional<EpochPair> epoch;  ///< replay: the recorded one
  std::function<bool(std::uint64_t)> ran;  ///< replay: whether the recorded loop ran cycle k
  std::string expected_sha256;  ///< replay: what the recorded application saw; another one fails the run
};

/// Arms, runs, stops, records, reports; prints. The exit status. Setup thread, which becomes the loop.
[[nodiscard]] int execute(Assembly& assembly, const ExecuteOptions& options, StopToken stop);

}  // namespace rigor
