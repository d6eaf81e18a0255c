// What was typed and where it ran: what a report needs so that somebody else can run it again.
#pragma once

#include <string>
#include <vector>

namespace rigor {

/// The words as a shell takes them. The value of --live-token is left out.
[[nodiscard]] std::string quoted_command(const std::vector<std::string>& words);
/// The command line of this process.
[[nodiscard]] std::string typed_command();
/// "bench, Intel(R) Xeon(R) …, 2 CPUs, Linux 6.1.0".
[[nodiscard]] std::string machine_name();

}  // namespace rigor
