#include "drivers/ouster/lidar_packet.h"

#include <algorithm>
#include <cmath>

#include "rt-core/byte_order.h"

namespace rigor::ouster {
namespace {

/// A field of a pixel: `bytes` at `at`, masked, and shifted to the right (to the left where negative).
struct BitField {
  std::uint8_t at = 0, bytes = 0;  ///< 0 bytes: the profile has none
  std::uint32_t mask = 0;
  int shift = 0;
};
struct PixelFields {
  std::size_t bytes;
  struct Return {
    BitField range, reflectivity, signal, flags;
  } returns[2];
  BitField near_infrared;
};

constexpr PixelFields kFields[] = {
    // LEGACY
    {12, {{{0, 4, 0xFFFFF, 0}, {4, 1, 0xFF, 0}, {6, 2, 0xFFFF, 0}, {3, 1, 0xF0, 4}}, {}}, {8, 2, 0xFFFF, 0}},
    // RNG19_RFL8_SIG16_NIR16
    {12, {{{0, 4, 0x7FFFF, 0}, {4, 1, 0xFF, 0}, {6, 2, 0xFFFF, 0}, {2, 1, 0xF8, 3}}, {}}, {8, 2, 0xFFFF, 0}},
    // RNG19_RFL8_SIG16_NIR16_DUAL
    {16,
     {{{0, 4, 0x7FFFF, 0}, {3, 1, 0xFF, 0}, {8, 2, 0xFFFF, 0}, {2, 1, 0xF8, 3}},
      {{4, 4, 0x7FFFF, 0}, {7, 1, 0xFF, 0}, {10, 2, 0xFFFF, 0}, {6, 1, 0xF8, 3}}},
     {12, 2, 0xFFFF, 0}},
    // RNG15_RFL8_NIR8
    {4, {{{0, 2, 0x7FFF, -3}, {2, 1, 0xFF, 0}, {}, {1, 1, 0x80, 7}}, {}}, {3, 1, 0xFF, -4}},
};
const PixelFields& fields_of(Profile p) { return kFields[static_cast<std::size_t>(p)]; }

std::uint32_t raw_of(Bytes pixel, const BitField& f) {
  switch (f.bytes) {
    case 1:
      return pixel[f.at];
    case 2:
      return load_le<std::uint16_t>(pixel, f.at);
    case 4:
      return load_le<std::uint32_t>(pixel, f.at);
    default:
      return 0;
  }
}
std::uint32_t get(Bytes pixel, const BitField& f) {
  const std::uint32_t v = raw_of(pixel, f) & f.mask;
  return f.shift >= 0 ? v >> f.shift : v << -f.shift;
}
/// What the field cannot hold is cut to its largest value.
void put(std::span<std::uint8_t> pixel, const BitField& f, std::uint32_t value) {
  if (f.bytes == 0) return;
  const std::uint32_t most = f.shift >= 0 ? f.mask >> f.shift : f.mask;
  std::uint32_t v = f.shift >= 0 ? value : value >> -f.shift;
  v = std::min(v, most);
  if (f.shift > 0) v <<= f.shift;
  v |= raw_of(pixel, f) & ~f.mask;
  for (std::size_t i = 0; i < f.bytes; ++i) pixel[f.at + i] = static_cast<std::uint8_t>(v >> 8 * i);
}

constexpr std::size_t kHeaderBytes = 32, kFooterBytes = 32;
constexpr std::uint16_t kLidarType = 1;

}  // namespace

PacketLayout layout_of(const Metadata& m) {
  const bool legacy = m.profile == Profile::legacy;
  PacketLayout l;
  l.profile = m.profile;
  l.pixels = m.pixels_per_column, l.columns = m.columns_per_packet, l.columns_per_frame = m.mode.columns;
  l.header_bytes = legacy ? 0 : kHeaderBytes;
  l.column_header_bytes = legacy ? 16 : 12;
  l.pixel_bytes = fields_of(m.profile).bytes;
  l.column_bytes = l.column_header_bytes + l.pixels * l.pixel_bytes + (legacy ? 4 : 0);
  l.packet_bytes = l.header_bytes + l.columns * l.column_bytes + (legacy ? 0 : kFooterBytes);
  return l;
}

std::string_view text_of(PacketFault fault) {
  switch (fault) {
    case PacketFault::none:
      return "nothing";
    case PacketFault::size:
      return "not of the size that the metadata says";
    case PacketFault::type:
      return "not of the type of lidar packets";
    case PacketFault::frame:
      return "columns of two frames";
    case PacketFault::column:
      return "a good column beyond the turn";
  }
  return "unknown";
}

std::optional<LidarPacket> LidarPacket::parse(Bytes bytes, const PacketLayout& layout,
                                              PacketFault& fault) noexcept {
  fault = PacketFault::size;
  if (bytes.size() != layout.packet_bytes) return {};
  const LidarPacket packet(bytes, layout);
  const bool legacy = layout.profile == Profile::legacy;
  fault = PacketFault::type;
  if (!legacy && load_le<std::uint16_t>(bytes) != kLidarType) return {};
  const std::uint16_t frame = packet.frame_id();
  for (std::uint32_t i = 0; i < layout.columns; ++i) {
    const Column c = packet.column(i);
    if (!c.good()) continue;
    fault = PacketFault::frame;
    if (legacy && load_le<std::uint16_t>(c.bytes_, 10) != frame) return {};
    fault = PacketFault::column;
    if (c.measurement_id() >= layout.columns_per_frame) return {};
  }
  fault = PacketFault::none;
  return packet;
}

LidarPacket::Column LidarPacket::column(std::uint32_t i) const {
  return {*layout_, bytes_.subspan(layout_->header_bytes + i * layout_->column_bytes, layout_->column_bytes)};
}
std::uint16_t LidarPacket::frame_id() const {
  return load_le<std::uint16_t>(bytes_, layout_->profile == Profile::legacy ? 10 : 2);
}
std::uint32_t LidarPacket::initialization_id() const {
  return layout_->profile == Profile::legacy ? 0 : load_le<std::uint32_t>(bytes_, 4) & 0xFFFFFF;
}

std::uint64_t LidarPacket::Column::timestamp_ns() const { return load_le<std::uint64_t>(bytes_); }
std::uint16_t LidarPacket::Column::measurement_id() const { return load_le<std::uint16_t>(bytes_, 8); }
std::uint32_t LidarPacket::Column::status() const {
  return layout_->profile == Profile::legacy ? load_le<std::uint32_t>(bytes_, layout_->column_bytes - 4)
                                             : load_le<std::uint16_t>(bytes_, 10);
}
bool LidarPacket::Column::good() const {
  return layout_->profile == Profile::legacy ? status() == 0xFFFFFFFF : (status() & 1) != 0;
}
std::uint32_t LidarPacket::Column::encoder() const {
  return layout_->profile == Profile::legacy ? load_le<std::uint32_t>(bytes_, 12) : 0;
}
Pixel LidarPacket::Column::pixel(std::uint32_t row, std::uint32_t index) const {
  const Bytes p = bytes_.subspan(pixel_at(row), layout_->pixel_bytes);
  const auto& f = fields_of(layout_->profile).returns[index];
  return {get(p, f.range), static_cast<std::uint16_t>(get(p, f.signal)),
          static_cast<std::uint8_t>(get(p, f.reflectivity)), static_cast<std::uint8_t>(get(p, f.flags))};
}
std::uint16_t LidarPacket::Column::near_infrared(std::uint32_t row) const {
  return static_cast<std::uint16_t>(
      get(bytes_.subspan(pixel_at(row), layout_->pixel_bytes), fields_of(layout_->profile).near_infrared));
}

LidarPacketWriter::LidarPacketWriter(const PacketLayout& layout)
    : layout_(layout), bytes_(layout.packet_bytes) {
  if (layout.profile != Profile::legacy) store_le(bytes_, 0, kLidarType);
}
void LidarPacketWriter::set_header(std::uint16_t frame_id, std::uint32_t initialization_id,
                                   std::uint64_t serial) {
  frame_id_ = frame_id;
  if (layout_.profile == Profile::legacy) return;
  store_le(bytes_, 2, frame_id);
  for (std::size_t i = 0; i < 5; ++i) bytes_[7 + i] = static_cast<std::uint8_t>(serial >> 8 * i);
  for (std::size_t i = 0; i < 3; ++i) bytes_[4 + i] = static_cast<std::uint8_t>(initialization_id >> 8 * i);
}
void LidarPacketWriter::set_column(std::uint32_t i, std::uint64_t timestamp_ns, std::uint16_t measurement_id,
                                   bool good) {
  const std::span<std::uint8_t> c(bytes_.data() + column_at(i), layout_.column_bytes);
  std::fill(c.begin(), c.end(), std::uint8_t{0});
  store_le(c, 0, timestamp_ns);
  store_le(c, 8, measurement_id);
  if (layout_.profile == Profile::legacy) {
    store_le(c, 10, frame_id_);
    store_le(c, 12,
             static_cast<std::uint32_t>(std::uint64_t{measurement_id} * kEncoderTicks /
                                        layout_.columns_per_frame));
    store_le(c, layout_.column_bytes - 4, good ? 0xFFFFFFFFU : 0U);
  } else {
    store_le(c, 10, static_cast<std::uint16_t>(good));
  }
}
std::span<std::uint8_t> LidarPacketWriter::pixel(std::uint32_t i, std::uint32_t row) {
  return std::span(bytes_).subspan(column_at(i) + layout_.column_header_bytes + row * layout_.pixel_bytes,
                                   layout_.pixel_bytes);
}
void LidarPacketWriter::set_pixel(std::uint32_t i, std::uint32_t row, const Pixel& value,
                                  std::uint32_t index) {
  const std::span<std::uint8_t> p = pixel(i, row);
  const auto& f = fields_of(layout_.profile).returns[index];
  const std::uint32_t unit = f.range.shift < 0 ? 1U << -f.range.shift : 1U;
  // To the nearest step.
  const std::uint32_t range = (value.range_mm + unit / 2) / unit * unit;
  const bool fits = range / unit <= f.range.mask;
  put(p, f.range, fits ? range : 0);
  put(p, f.reflectivity, fits ? value.reflectivity : 0);
  put(p, f.signal, fits ? value.signal : 0);
  put(p, f.flags, value.flags);
}
void LidarPacketWriter::set_near_infrared(std::uint32_t i, std::uint32_t row, std::uint16_t photons) {
  put(pixel(i, row), fields_of(layout_.profile).near_infrared, photons);
}

std::optional<ImuPacket> parse_imu(Bytes b) noexcept {
  if (b.size() != kImuBytes) return {};
  ImuPacket p;
  p.system_ns = load_le<std::uint64_t>(b, 0);
  p.accelerometer_ns = load_le<std::uint64_t>(b, 8);
  p.gyroscope_ns = load_le<std::uint64_t>(b, 16);
  for (std::size_t i = 0; i < 3; ++i) {
    p.acceleration_g[i] = load_le<float>(b, 24 + 4 * i);
    p.turn_rate_dps[i] = load_le<float>(b, 36 + 4 * i);
    if (!std::isfinite(p.acceleration_g[i]) || !std::isfinite(p.turn_rate_dps[i])) return {};
  }
  return p;
}

std::array<std::uint8_t, kImuBytes> compose_imu(const ImuPacket& p) {
  std::array<std::uint8_t, kImuBytes> b{};
  store_le(b, 0, p.system_ns);
  store_le(b, 8, p.accelerometer_ns);
  store_le(b, 16, p.gyroscope_ns);
  for (std::size_t i = 0; i < 3; ++i) {
    store_le(b, 24 + 4 * i, p.acceleration_g[i]);
    store_le(b, 36 + 4 * i, p.turn_rate_dps[i]);
  }
  return b;
}

}  // namespace rigor::ouster
