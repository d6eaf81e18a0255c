// A DBC file of anybody's: parsed, and where it is good, frames of its messages are decoded and encoded. The
// input is the text; its bytes again are the frames.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>
#include <vector>

#include "drivers/can/dbc.h"
#include "drivers/can/signal_codec.h"

using namespace rigor::can;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto dbc = parse_dbc({reinterpret_cast<const char*>(data), size}, "fuzz.dbc");
  if (!dbc) {
    if (dbc.error().message.empty() || dbc.error().where.find("fuzz.dbc:") != 0) std::abort();
    return 0;
  }
  std::vector<double> values;
  std::size_t at = 0;
  for (const auto& m : dbc->messages) {
    if (!m.fits_a_frame()) continue;
    rigor::CanFrame f = blank_frame(m);
    if (f.length > f.data.size()) std::abort();
    for (std::size_t i = 0; i < f.length && size != 0; ++i) f.data[i] = data[at++ % size];
    values.assign(m.signals.size(), 0);
    decode(m, {f.data.data(), f.length}, values);
    std::size_t bad = 0;
    const auto before = f.data;
    if (encode(m, values, f, bad) != EncodeStatus::good) {
      if (bad >= m.signals.size() || f.data != before) std::abort();
    }
    // Lengths of other frames with the same identifier.
    for (std::size_t n = 0; n < f.length; ++n) decode(m, {f.data.data(), n}, values);
  }
  return 0;
}
