// What `rigor run` and `rigor replay` print of a run.
#pragma once

#include "bench/bench.h"
#include "cli/commands.h"

namespace rigor {

/// The result on stdout, what went wrong on stderr. The exit status.
[[nodiscard]] int print_report(const RunReport& report, bool json);
/// The page stays until the user asks it to go.
void wait_for_live_end(const live::Server& server, const StopToken& stop);
/// For BenchOptions::on_warning.
void print_warning(const std::string& text);

}  // namespace rigor
