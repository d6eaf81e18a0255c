#include "drivers/sick/scan_data.h"

#include <algorithm>

#include "drivers/sick/wire.h"
#include "rt-core/byte_order.h"

namespace rigor::sick {
namespace {

constexpr std::size_t kChannelHeader = 21;

bool read_channels(WireReader& r, std::vector<ScanChannel>& channels, std::size_t width, ScanError& error) {
  const std::size_t count = r.u16();
  if (count > kMaxChannels) return error = ScanError::bad_count, false;
  if (count * kChannelHeader > r.left()) return error = ScanError::cut_short, false;
  channels.resize(count);
  for (auto& c : channels) {
    const Bytes name = r.bytes(c.name.size());
    std::copy(name.begin(), name.end(), c.name.begin());
    c.scale = r.f32();
    c.offset = r.f32();
    c.start_deg_e4 = r.i32();
    c.step_deg_e4 = r.u16();
    const std::size_t values = r.u16();
    const Bytes raw = r.bytes(values * width);
    if (!r.good()) return error = ScanError::cut_short, false;
    c.values.resize(values);
    if (width == 1) {
      std::copy(raw.begin(), raw.end(), c.values.begin());
    } else {
      for (std::size_t i = 0; i < values; ++i) c.values[i] = load_be<std::uint16_t>(raw, 2 * i);
    }
  }
  return true;
}

/// Reads a block's flag: absent, present, or neither.
bool block(WireReader& r, bool& present, ScanError& error) {
  const auto flag = r.u16();
  if (!r.good()) return error = ScanError::cut_short, false;
  if (flag > 1) return error = ScanError::bad_flag, false;
  present = flag == 1;
  return true;
}

bool read_text(WireReader& r, std::optional<std::string>& out, ScanError& error) {
  bool present = false;
  if (!block(r, present, error)) return false;
  out.reset();
  if (present) out = r.text(r.u8());
  return true;
}

void write_channels(const std::vector<ScanChannel>& channels, std::size_t width, Buffer& out) {
  append_be(out, static_cast<std::uint16_t>(channels.size()));
  for (const auto& c : channels) {
    append_text(out, c.text());
    append_be<float>(out, c.scale);
    append_be<float>(out, c.offset);
    append_be<std::int32_t>(out, c.start_deg_e4);
    append_be<std::uint16_t>(out, c.step_deg_e4);
    append_be(out, static_cast<std::uint16_t>(c.values.size()));
    for (const auto v : c.values)
      width == 1 ? append_be(out, static_cast<std::uint8_t>(v)) : append_be(out, v);
  }
}

void write_text(const std::optional<std::string>& text, Buffer& out) {
  append_be<std::uint16_t>(out, text.has_value());
  if (!text) return;
  const auto shown = std::string_view(*text).substr(0, 255);
  append_be(out, static_cast<std::uint8_t>(shown.size()));
  append_text(out, shown);
}

}  // namespace

int ScanChannel::echo_of(std::string_view kind) const {
  if (text().substr(0, 4) != kind || name[4] < '1' || name[4] > '5') return -1;
  return name[4] - '1';
}

const char* to_text(ScanError error) {
  switch (error) {
    case ScanError::none:
      return "a scan";
    case ScanError::cut_short:
      return "a scan that ends too early";
    case ScanError::too_long:
      return "a scan with bytes behind its end";
    case ScanError::bad_count:
      return "a scan with a count that no device has";
    case ScanError::bad_flag:
      return "a scan with a flag that is neither 0 nor 1";
  }
  return "";
}

ScanError decode_scan(Bytes values, ScanData& s) {
  WireReader r(values);
  ScanError error = ScanError::none;
  s.version = r.u16();
  s.device_number = r.u16();
  s.serial_number = r.u32();
  for (auto& b : s.device_status) b = r.u8();
  s.telegram_counter = r.u16();
  s.scan_counter = r.u16();
  s.time_since_startup_us = r.u32();
  s.time_of_transmission_us = r.u32();
  for (auto& b : s.inputs) b = r.u8();
  for (auto& b : s.outputs) b = r.u8();
  s.layer_angle = static_cast<std::int16_t>(r.u16());
  s.scan_frequency_hz_e2 = r.u32();
  s.measurement_frequency_100hz = r.u32();
  const std::size_t encoders = r.u16();
  if (!r.good()) return ScanError::cut_short;
  if (encoders > kMaxEncoders) return ScanError::bad_count;
  s.encoders.resize(encoders);
  for (auto& e : s.encoders) e.position = r.u32(), e.speed = r.u16();
  if (!read_channels(r, s.channels16, 2, error) || !read_channels(r, s.channels8, 1, error)) return error;

  bool present = false;
  if (!block(r, present, error)) return error;
  s.position.reset();
  if (present) {
    s.position.emplace();
    for (auto& v : s.position->xyz_rotation) v = r.f32();
    s.position->rotation_type = r.u8();
  }
  if (!read_text(r, s.name, error) || !read_text(r, s.comment, error)) return error;
  if (!block(r, present, error)) return error;
  s.time.reset();
  if (present) {
    auto& t = s.time.emplace();
    t.year = r.u16();
    for (auto* part : {&t.month, &t.day, &t.hour, &t.minute, &t.second}) *part = r.u8();
    t.microsecond = r.u32();
  }
  if (!block(r, present, error)) return error;
  s.event.reset();
  if (present) {
    auto& e = s.event.emplace();
    const Bytes type = r.bytes(e.type.size());
    std::copy(type.begin(), type.end(), e.type.begin());
    e.encoder_position = r.u32();
    e.time_us = r.u32();
    e.angle = r.i32();
  }
  if (!r.good()) return ScanError::cut_short;
  return r.left() == 0 ? ScanError::none : ScanError::too_long;
}

void encode_scan(const ScanData& s, Buffer& out) {
  append_be<std::uint16_t>(out, s.version);
  append_be<std::uint16_t>(out, s.device_number);
  append_be<std::uint32_t>(out, s.serial_number);
  for (const auto b : s.device_status) append_be<std::uint8_t>(out, b);
  append_be<std::uint16_t>(out, s.telegram_counter);
  append_be<std::uint16_t>(out, s.scan_counter);
  append_be<std::uint32_t>(out, s.time_since_startup_us);
  append_be<std::uint32_t>(out, s.time_of_transmission_us);
  for (const auto b : s.inputs) append_be<std::uint8_t>(out, b);
  for (const auto b : s.outputs) append_be<std::uint8_t>(out, b);
  append_be<std::uint16_t>(out, static_cast<std::uint16_t>(s.layer_angle));
  append_be<std::uint32_t>(out, s.scan_frequency_hz_e2);
  append_be<std::uint32_t>(out, s.measurement_frequency_100hz);
  append_be(out, static_cast<std::uint16_t>(s.encoders.size()));
  for (const auto& e : s.encoders)
    append_be<std::uint32_t>(out, e.position), append_be<std::uint16_t>(out, e.speed);
  write_channels(s.channels16, 2, out);
  write_channels(s.channels8, 1, out);
  append_be<std::uint16_t>(out, s.position.has_value());
  if (s.position) {
    for (const auto v : s.position->xyz_rotation) append_be<float>(out, v);
    append_be<std::uint8_t>(out, s.position->rotation_type);
  }
  write_text(s.name, out);
  write_text(s.comment, out);
  append_be<std::uint16_t>(out, s.time.has_value());
  if (s.time) {
    append_be<std::uint16_t>(out, s.time->year);
    for (const auto part : {s.time->month, s.time->day, s.time->hour, s.time->minute, s.time->second})
      append_be<std::uint8_t>(out, part);
    append_be<std::uint32_t>(out, s.time->microsecond);
  }
  append_be<std::uint16_t>(out, s.event.has_value());
  if (s.event) {
    append_text(out, {s.event->type.data(), s.event->type.size()});
    append_be<std::uint32_t>(out, s.event->encoder_position);
    append_be<std::uint32_t>(out, s.event->time_us);
    append_be<std::int32_t>(out, s.event->angle);
  }
}

}  // namespace rigor::sick
