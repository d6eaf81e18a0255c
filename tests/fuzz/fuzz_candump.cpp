// A candump log of anybody's. What is read is written, read again, and written the same.
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <sstream>

#include "drivers/can/can_bits.h"
#include "drivers/can/candump_log.h"
#include "drivers/can/error_frame.h"

using namespace rigor::can;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  LogReader log(std::make_unique<std::istringstream>(std::string(reinterpret_cast<const char*>(data), size)),
                "fuzz.log");
  while (true) {
    const auto next = log.next();
    if (!next) {
      if (next.error().where.find("fuzz.log:") != 0) std::abort();
      return 0;
    }
    if (!*next) return 0;
    const LogEntry& e = **next;
    const auto line = format_log_line(e);
    if (line.size() >= kLogLineBytes) std::abort();
    const auto again = parse_log_line(line);
    if (!again || format_log_line(*again) != line) std::abort();
    if (frame_duration(e.frame, {}).ns() <= 0) std::abort();
    (void)arbitration(e.frame);
    if (e.frame.error && describe_error(e.frame).empty()) std::abort();
  }
}
