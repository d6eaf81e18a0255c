// Frames of devices that have no protocol to speak of: a header with a magic number, then planes of numbers,
// one after the other in a stream of bytes. The rig describes them:
//
//   frame:
//     magic: 52474654            hexadecimal bytes, 2 … 16, at the frame's beginning
//     header_bytes: 24           with the magic
//     byte_order: little         of the header's and the planes' numbers; or big
//     width_px: 176
//     height_px: 144
//     size_bytes: 101400         of a whole frame; or, where it varies,
//     length: { at: 8, type: u32, counts: payload }    or frame; default: what header and planes take.
//                                max_bytes: 202824     of a frame; a larger one is a corrupt length (default:
//                                twice
//                                                      what header and planes take, and 64 KiB more)
//     sequence: { at: 12, type: u32 }                  counts frames
//     stamp: { at: 16, type: u64, tick_ns: 1000 }      the device's clock at the capture
//     planes:
//       - { name: range, type: u16, scale: 0.001, offset: 0, invalid: 0 }
//       - { name: amplitude, type: u16 }
//
// `type` is u8, u16, s16, u32, s32, u64, f32. Planes are rows without padding, the first at header_bytes, the
// next after it, unless `at` says where. Values are raw · scale + offset: metres for `range`, whose `invalid`
// (a list or one) and NaN are "no return". A plane `image` (u8 or u16) makes the channel an image. No I/O.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"

namespace rigor::usb {

enum class RawType : std::uint8_t { u8, u16, s16, u32, s32, u64, f32 };
[[nodiscard]] std::size_t raw_bytes(RawType type) noexcept;

struct BulkField {
  std::size_t at = 0;
  RawType type = RawType::u32;
};
struct BulkPlane {
  std::string name;
  RawType type = RawType::u16;
  std::size_t at = 0;
  double scale = 1, offset = 0;
  std::vector<double> invalid;
};
struct BulkFormat {
  static constexpr std::size_t kMostBytes = 64 * 1024 * 1024;
  std::string magic;
  std::size_t header_bytes = 0;
  bool big_endian = false;
  std::uint32_t width_px = 0, height_px = 0;
  std::size_t frame_bytes = 0;  ///< without a length field; with one: the least that a frame has
  std::size_t most_bytes = 0;   ///< with a length field: what a frame has at most
  std::optional<BulkField> length, sequence, stamp;
  bool length_counts_frame = false;
  std::int64_t tick_ns = 1;
  std::vector<BulkPlane> planes;  ///< range, then amplitude if there is one; or image

  [[nodiscard]] bool image() const { return planes.front().name == "image"; }
  [[nodiscard]] std::size_t pixels() const { return std::size_t{width_px} * height_px; }
  /// Of a frame that the emulator makes.
  [[nodiscard]] std::size_t size() const { return frame_bytes; }
};
/// Throws ConfigError.
[[nodiscard]] BulkFormat read_bulk_format(const ConfigNode& n);

/// Frames out of a byte stream; finds the next magic number after whatever does not fit.
class BulkReader {
 public:
  explicit BulkReader(BulkFormat format) : format_(std::move(format)) {}
  void push(std::string_view bytes, std::int64_t arrival_ns);
  struct Frame {
    std::string_view bytes;                  ///< lives until the next call
    std::int64_t first_ns = 0, last_ns = 0;  ///< arrival of the bytes that began and ended it
  };
  [[nodiscard]] bool next(Frame& frame);
  /// The stream was interrupted: what has come of a frame is of no use.
  void interrupt();
  [[nodiscard]] std::uint64_t skipped_bytes() const noexcept { return skipped_; }
  [[nodiscard]] std::uint64_t refused_headers() const noexcept { return refused_; }

 private:
  struct Mark {
    std::size_t end;  ///< of the bytes that came then, in pending_
    std::int64_t ns;
  };
  void drop(std::size_t bytes);
  [[nodiscard]] std::int64_t arrival_of(std::size_t byte) const;

  BulkFormat format_;
  std::string pending_;
  std::size_t at_ = 0;
  std::vector<Mark> marks_;
  std::uint64_t skipped_ = 0, refused_ = 0;
};

/// The number at a field; empty where the frame is too short.
[[nodiscard]] std::optional<std::uint64_t> bulk_field(const BulkFormat& format, const BulkField& field,
                                                      std::string_view frame);
/// Planes of a frame as a range image's (range, then amplitude) or an image's bytes; false where the frame or
/// the target is too short. No allocation.
[[nodiscard]] bool decode_bulk(const BulkFormat& format, std::string_view frame, std::span<std::byte> out);
/// How many bytes decode_bulk writes.
[[nodiscard]] std::size_t bulk_sample_bytes(const BulkFormat& format);
/// The frame that a device makes of a range image's planes (NaN: no return) or an image's bytes.
void encode_bulk(const BulkFormat& format, std::span<const std::byte> sample, std::uint64_t sequence,
                 std::int64_t stamp_ns, std::string& out);

}  // namespace rigor::usb
