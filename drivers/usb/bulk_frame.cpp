#include "drivers/usb/bulk_frame.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "rt-core/byte_order.h"

namespace rigor::usb {
namespace {

const std::vector<std::string> kTypes = {"u8", "u16", "s16", "u32", "s32", "u64", "f32"};

RawType read_type(const ConfigNode& n, const std::vector<std::string>& allowed, const char* fallback) {
  const std::string name = n.choice_or("type", allowed, fallback);
  return static_cast<RawType>(std::find(kTypes.begin(), kTypes.end(), name) - kTypes.begin());
}

/// A value of 1, 2, 4 or 8 bytes in the order that the format names.
template <class T>
std::uint64_t load_as(std::string_view frame, std::size_t at, bool big) {
  return big ? load_be<T>(frame, at) : load_le<T>(frame, at);
}
template <class T>
void store_as(std::span<char> frame, std::size_t at, bool big, std::uint64_t v) {
  big ? store_be(frame, at, static_cast<T>(v)) : store_le(frame, at, static_cast<T>(v));
}
std::uint64_t raw_at(std::string_view frame, std::size_t at, std::size_t bytes, bool big) {
  return bytes == 1   ? load_as<std::uint8_t>(frame, at, big)
         : bytes == 2 ? load_as<std::uint16_t>(frame, at, big)
         : bytes == 4 ? load_as<std::uint32_t>(frame, at, big)
                      : load_as<std::uint64_t>(frame, at, big);
}
void put_raw(std::span<char> frame, std::size_t at, std::size_t bytes, bool big, std::uint64_t v) {
  bytes == 1   ? store_as<std::uint8_t>(frame, at, big, v)
  : bytes == 2 ? store_as<std::uint16_t>(frame, at, big, v)
  : bytes == 4 ? store_as<std::uint32_t>(frame, at, big, v)
               : store_as<std::uint64_t>(frame, at, big, v);
}

double value_of(std::uint64_t raw, RawType type) {
  switch (type) {
    case RawType::s16:
      return static_cast<std::int16_t>(raw);
    case RawType::s32:
      return static_cast<std::int32_t>(raw);
    case RawType::f32:
      return static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(raw)));
    default:
      return static_cast<double>(raw);
  }
}
std::uint64_t raw_of(double value, RawType type) {
  const auto clamped = [&](double least, double most) { return std::clamp(std::round(value), least, most); };
  if (std::isnan(value) && type != RawType::f32) return 0;
  switch (type) {
    case RawType::u8:
      return static_cast<std::uint64_t>(clamped(0, 255));
    case RawType::u16:
      return static_cast<std::uint64_t>(clamped(0, 65535));
    case RawType::s16:
      return static_cast<std::uint16_t>(static_cast<std::int16_t>(clamped(-32768, 32767)));
    case RawType::u32:
      return static_cast<std::uint64_t>(clamped(0, 4294967295.0));
    case RawType::s32:
      return static_cast<std::uint32_t>(static_cast<std::int32_t>(clamped(-2147483648.0, 2147483647.0)));
    case RawType::u64:
      return static_cast<std::uint64_t>(clamped(0, 9e18));
    case RawType::f32:
      return std::bit_cast<std::uint32_t>(static_cast<float>(value));
  }
  return 0;
}

int nibble(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

BulkField read_field(const ConfigNode& n, std::size_t header_bytes) {
  BulkField f;
  f.type = read_type(n, {"u8", "u16", "u32", "u64"}, "u32");
  f.at = static_cast<std::size_t>(n.integer("at", {.min = 0, .max = 65535}));
  if (f.at + raw_bytes(f.type) > header_bytes)
    throw n.error("at", "expected a place within the header of " + std::to_string(header_bytes) + " bytes");
  return f;
}

}  // namespace

std::size_t raw_bytes(RawType type) noexcept {
  constexpr std::size_t kBytes[] = {1, 2, 2, 4, 4, 8, 4};
  return kBytes[static_cast<std::size_t>(type)];
}

BulkFormat read_bulk_format(const ConfigNode& n) {
  BulkFormat f;
  const std::string magic = n.text("magic");
  for (std::size_t i = 0; i + 1 < magic.size(); i += 2) {
    const int high = nibble(magic[i]), low = nibble(magic[i + 1]);
    if (high < 0 || low < 0) break;
    f.magic += static_cast<char>(high * 16 + low);
  }
  if (f.magic.size() * 2 != magic.size() || f.magic.size() < 2 || f.magic.size() > 16)
    throw n.error("magic", "expected 2 … 16 bytes in hexadecimal, such as 52474654, got " + magic);
  f.header_bytes = static_cast<std::size_t>(
      n.integer("header_bytes", {.min = static_cast<double>(f.magic.size()), .max = 65536}));
  f.big_endian = n.choice_or("byte_order", {"little", "big"}, "little") == "big";
  f.width_px = static_cast<std::uint32_t>(n.integer("width_px", {.min = 1, .max = 8192}));
  f.height_px = static_cast<std::uint32_t>(n.integer("height_px", {.min = 1, .max = 8192}));
  std::size_t at = f.header_bytes, end = f.header_bytes;
  for (const ConfigNode& p : n.list("planes")) {
    BulkPlane plane;
    plane.name = p.choice("name", {"range", "amplitude", "image"});
    const bool image = plane.name == "image";
    plane.type = image ? read_type(p, {"u8", "u16"}, "u16") : read_type(p, kTypes, "u16");
    plane.at =
        static_cast<std::size_t>(p.integer_or("at", static_cast<std::int64_t>(at), {.min = 0, .max = 1e8}));
    if (plane.at < f.header_bytes)
      throw p.error("at",
                    "expected a place after the header of " + std::to_string(f.header_bytes) + " bytes");
    if (!image) {
      plane.scale = p.number_or("scale", 1);
      if (plane.scale == 0) throw p.error("scale", "expected a number other than 0");
      plane.offset = p.number_or("offset", 0);
    }
    if (plane.name == "range" && p.has("invalid")) {
      bool list = true;
      try {
        for (const ConfigNode& v : p.list("invalid")) plane.invalid.push_back(v.as_number());
      } catch (const ConfigError&) {
        list = false;
      }
      if (!list) plane.invalid = {p.number("invalid")};
    }
    p.finish();
    at = plane.at + raw_bytes(plane.type) * f.pixels();
    end = std::max(end, at);
    f.planes.push_back(std::move(plane));
  }
  const auto is = [&](std::size_t i, const char* name) {
    return i < f.planes.size() && f.planes[i].name == name;
  };
  const bool good = (f.planes.size() == 1 && (is(0, "range") || is(0, "image"))) ||
                    (f.planes.size() == 2 && is(0, "range") && is(1, "amplitude"));
  if (!good) throw n.error("planes", "expected range, range and amplitude, or image");
  if (end > BulkFormat::kMostBytes)
    throw n.error("planes", "expected frames up to 64 MiB, got " + std::to_string(end) + " bytes");
  f.frame_bytes = end;
  if (n.has("length")) {
    const ConfigNode l = n.map("length");
    f.length = read_field(l, f.header_bytes);
    f.length_counts_frame = l.choice_or("counts", {"payload", "frame"}, "payload") == "frame";
    // All that is waited for after a corrupt length is lost with it.
    f.most_bytes = static_cast<std::size_t>(l.integer_or(
        "max_bytes", static_cast<std::int64_t>(std::min(2 * end + 64 * 1024, BulkFormat::kMostBytes)),
        {.min = static_cast<double>(end), .max = BulkFormat::kMostBytes}));
    l.finish();
    if (n.has("size_bytes")) throw n.error("size_bytes", "expected `length` or `size_bytes`, got both");
  } else {
    f.frame_bytes = static_cast<std::size_t>(
        n.integer_or("size_bytes", static_cast<std::int64_t>(end),
                     {.min = static_cast<double>(end), .max = BulkFormat::kMostBytes}));
  }
  if (n.has("sequence")) {
    const ConfigNode s = n.map("sequence");
    f.sequence = read_field(s, f.header_bytes);
    s.finish();
  }
  if (n.has("stamp")) {
    const ConfigNode s = n.map("stamp");
    f.stamp = read_field(s, f.header_bytes);
    f.tick_ns = s.integer_or("tick_ns", 1, {.min = 1, .max = 1e9});
    s.finish();
  }
  n.finish();
  return f;
}

// ------------------------------------------------------------------ the stream

void BulkReader::drop(std::size_t bytes) {
  at_ += bytes;
  if (at_ < pending_.size() / 2 && at_ < 1024 * 1024) return;
  pending_.erase(0, at_);
  std::size_t gone = 0;
  while (gone + 1 < marks_.size() && marks_[gone].end <= at_) ++gone;
  marks_.erase(marks_.begin(), marks_.begin() + static_cast<std::ptrdiff_t>(gone));
  for (Mark& m : marks_) m.end -= std::min(m.end, at_);
  at_ = 0;
}

std::int64_t BulkReader::arrival_of(std::size_t byte) const {
  for (const Mark& m : marks_)
    if (byte < m.end) return m.ns;
  return marks_.empty() ? 0 : marks_.back().ns;
}

void BulkReader::push(std::string_view bytes, std::int64_t arrival_ns) {
  if (bytes.empty()) return;
  drop(0);
  pending_ += bytes;
  if (!marks_.empty() && marks_.back().ns == arrival_ns)
    marks_.back().end = pending_.size();
  else
    marks_.push_back({pending_.size(), arrival_ns});
}

void BulkReader::interrupt() {
  skipped_ += pending_.size() - at_;
  pending_.clear();
  marks_.clear();
  at_ = 0;
}

bool BulkReader::next(Frame& frame) {
  while (true) {
    const std::string_view rest = std::string_view(pending_).substr(at_);
    const std::size_t found = rest.find(format_.magic);
    if (found != 0) {
      // The last bytes may be the beginning of a magic number.
      const std::size_t keep = std::min(rest.size(), format_.magic.size() - 1);
      const std::size_t skip = found == std::string_view::npos ? rest.size() - keep : found;
      skipped_ += skip;
      if (skip > 0) drop(skip);
      if (found == std::string_view::npos) return false;
      continue;
    }
    if (rest.size() < format_.header_bytes) return false;
    std::size_t size = format_.frame_bytes;
    if (format_.length) {
      const std::uint64_t told = *bulk_field(format_, *format_.length, rest);
      const std::uint64_t whole = format_.length_counts_frame ? told : told + format_.header_bytes;
      if (told > format_.most_bytes || whole < format_.frame_bytes || whole > format_.most_bytes) {
        ++refused_;
        ++skipped_;
        drop(1);
        continue;
      }
      size = static_cast<std::size_t>(whole);
    }
    if (rest.size() < size) return false;
    frame.first_ns = arrival_of(at_);
    frame.last_ns = arrival_of(at_ + size - 1);
    frame.bytes = rest.substr(0, size);
    at_ += size;  // its bytes stay where they are until the next push
    return true;
  }
}

// ------------------------------------------------------------------ the numbers

std::optional<std::uint64_t> bulk_field(const BulkFormat& format, const BulkField& field,
                                        std::string_view frame) {
  const std::size_t bytes = raw_bytes(field.type);
  if (field.at > frame.size() || frame.size() - field.at < bytes) return std::nullopt;
  return raw_at(frame, field.at, bytes, format.big_endian);
}

std::size_t bulk_sample_bytes(const BulkFormat& format) {
  if (format.image()) return format.pixels() * raw_bytes(format.planes.front().type);
  return format.pixels() * format.planes.size() * sizeof(float);
}

bool decode_bulk(const BulkFormat& format, std::string_view frame, std::span<std::byte> out) {
  if (out.size() < bulk_sample_bytes(format)) return false;
  std::size_t written = 0;
  for (const BulkPlane& plane : format.planes) {
    const std::size_t bytes = raw_bytes(plane.type), count = format.pixels();
    if (plane.at > frame.size() || frame.size() - plane.at < bytes * count) return false;
    std::size_t p = plane.at;
    if (format.image()) {
      for (std::size_t i = 0; i < count; ++i, p += bytes) {
        const auto v = static_cast<std::uint16_t>(raw_at(frame, p, bytes, format.big_endian));
        std::memcpy(out.data() + i * bytes, &v, bytes);  // little-endian, as samples are
      }
      return true;
    }
    for (std::size_t i = 0; i < count; ++i, p += bytes) {
      const double raw = value_of(raw_at(frame, p, bytes, format.big_endian), plane.type);
      auto v = static_cast<float>(raw * plane.scale + plane.offset);
      if (plane.name == "range") {
        for (const double bad : plane.invalid)
          if (raw == bad) v = std::numeric_limits<float>::quiet_NaN();
        if (!std::isfinite(v)) v = std::numeric_limits<float>::quiet_NaN();
      }
      std::memcpy(out.data() + written, &v, sizeof v);
      written += sizeof v;
    }
  }
  return true;
}

void encode_bulk(const BulkFormat& format, std::span<const std::byte> sample, std::uint64_t sequence,
                 std::int64_t stamp_ns, std::string& out) {
  const std::size_t start = out.size();
  out.resize(start + format.size(), '\0');
  const std::span<char> frame = std::span(out).subspan(start);
  std::memcpy(frame.data(), format.magic.data(), format.magic.size());
  const auto put = [&](const std::optional<BulkField>& field, std::uint64_t value) {
    if (field) put_raw(frame, field->at, raw_bytes(field->type), format.big_endian, value);
  };
  put(format.length, format.length_counts_frame ? format.size() : format.size() - format.header_bytes);
  put(format.sequence, sequence);
  put(format.stamp, static_cast<std::uint64_t>(stamp_ns / format.tick_ns));
  std::size_t read = 0;
  for (const BulkPlane& plane : format.planes) {
    const std::size_t bytes = raw_bytes(plane.type);
    std::size_t p = plane.at;
    for (std::size_t i = 0; i < format.pixels(); ++i, p += bytes) {
      if (format.image()) {
        std::uint16_t v = 0;
        if (read + bytes <= sample.size()) std::memcpy(&v, sample.data() + read, bytes);
        read += bytes;
        put_raw(frame, p, bytes, format.big_endian, v);
        continue;
      }
      float v = std::numeric_limits<float>::quiet_NaN();
      if (read + sizeof v <= sample.size()) std::memcpy(&v, sample.data() + read, sizeof v);
      read += sizeof v;
      double raw = (static_cast<double>(v) - plane.offset) / plane.scale;
      if (std::isnan(v) && !plane.invalid.empty()) raw = plane.invalid.front();
      put_raw(frame, p, bytes, format.big_endian, raw_of(raw, plane.type));
    }
  }
}

}  // namespace rigor::usb
