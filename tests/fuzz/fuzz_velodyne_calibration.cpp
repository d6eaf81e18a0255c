// A calibration file of a Velodyne, as db.xml or YAML. What is accepted makes a decoder. First byte: the
// model.
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "drivers/velodyne/calibration_file.h"
#include "drivers/velodyne/packet_decoder.h"

using namespace rigor::velodyne;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const Model model = (data[0] & 8) != 0 ? Model::hdl32e : Model::vlp16;
  const auto c = parse_calibration({reinterpret_cast<const char*>(data) + 1, size - 1}, "fuzz", model);
  if (c && !PacketDecoder::create(model, *c)) std::abort();
  if (!c && c.error().message.empty()) std::abort();
  return 0;
}
