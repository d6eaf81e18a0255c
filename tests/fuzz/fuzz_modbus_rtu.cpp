// A serial line with anything on it: framing, then the requests that come out. Input: records of one byte of
// length and as many bytes that came in one lump, each followed by a silence that its top bit chooses.
#include <algorithm>
#include <array>
#include <cstdlib>

#include "drivers/modbus/pdu.h"
#include "drivers/modbus/rtu_codec.h"

using namespace rigor;
using namespace rigor::modbus;

namespace {

class Registers final : public RegisterModel {
 public:
  bool read(RegisterTable, std::uint16_t address, std::span<std::uint16_t> out, BenchTime) override {
    if (address + out.size() > words.size()) return false;
    std::copy_n(words.begin() + address, out.size(), out.begin());
    return true;
  }
  bool write(RegisterTable, std::uint16_t address, std::span<const std::uint16_t> in, BenchTime) override {
    if (address + in.size() > words.size()) return false;
    std::copy(in.begin(), in.end(), words.begin() + address);
    return true;
  }
  std::array<std::uint16_t, 64> words{};
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  for (const Duration gap : {Duration(0), microseconds(1750)}) {
    RtuFramer framer(gap, milliseconds(50));
    Registers model;
    MonotonicTime t(1'000'000'000);
    for (std::size_t at = 0; at < size;) {
      const std::size_t length = std::min<std::size_t>(data[at] & 0x7F, size - at - 1);
      const bool long_silence = (data[at] & 0x80) != 0;
      (void)framer.add({data + at + 1, length}, t);
      at += 1 + length;
      t = t + (long_silence ? milliseconds(60) : microseconds(500));
      std::span<const std::uint8_t> frame;
      for (auto found = framer.next(t, frame); found != RtuFramer::Found::nothing;
           found = framer.next(t, frame)) {
        if (found != RtuFramer::Found::frame) continue;
        if (frame.size() < 2 || frame.size() > kMaxRtuFrame - 2) std::abort();
        Pdu answer;
        if (serve_request(model, frame.subspan(1), {}, answer) && (answer.size < 2 || answer.size > kMaxPdu))
          std::abort();
      }
    }
    // What is not served any other way: the same bytes as a bare request.
    Pdu answer;
    (void)serve_request(model, {data, size}, {}, answer);
  }
  return 0;
}
