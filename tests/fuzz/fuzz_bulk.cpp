// Frames from a bulk endpoint: the reader that finds them and the planes in them. The first byte chooses one
// of three formats (fixed size, length of the payload, length of the frame), the rest is the stream.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "drivers/usb/bulk_frame.h"

using namespace rigor;
using namespace rigor::usb;

namespace {

BulkFormat format_of(const char* text) { return read_bulk_format(*ConfigDocument::parse(text, "fuzz")); }

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const BulkFormat kFormats[] = {
      format_of("{magic: 5247, header_bytes: 4, width_px: 4, height_px: 3, planes: [{name: range}]}"),
      format_of(
          "{magic: 524746, header_bytes: 24, width_px: 4, height_px: 3, byte_order: big, sequence: {at: 4, "
          "type: "
          "u8}, stamp: {at: 8, type: u64}, length: {at: 16, type: u64}, planes: [{name: range, type: f32, "
          "invalid: 0}, {name: amplitude, type: s32}]}"),
      format_of("{magic: 5247, header_bytes: 6, width_px: 4, height_px: 3, length: {at: 2, type: u32, "
                "counts: frame}, "
                "planes: [{name: image, type: u16}]}"),
  };
  if (size == 0) return 0;
  const BulkFormat& f = kFormats[data[0] % 3];
  std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  BulkReader reader(f);
  std::vector<std::byte> out(bulk_sample_bytes(f));
  std::int64_t ns = 0;
  while (!bytes.empty()) {
    const std::size_t n =
        std::min<std::size_t>(bytes.size(), 1 + (static_cast<unsigned char>(bytes[0]) & 127));
    reader.push(bytes.substr(0, n), ++ns);
    bytes.remove_prefix(n);
    BulkReader::Frame frame;
    while (reader.next(frame)) {
      if (frame.bytes.size() < f.frame_bytes || frame.first_ns > frame.last_ns) std::abort();
      if (!decode_bulk(f, frame.bytes, out)) std::abort();
      if (f.stamp) (void)bulk_field(f, *f.stamp, frame.bytes);
    }
  }
  return 0;
}
