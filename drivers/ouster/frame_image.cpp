#include "drivers/ouster/frame_image.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "rt-core/byte_order.h"

namespace rigor::ouster {

std::optional<Field> field_named(std::string_view name) {
  return name == "reflectivity"    ? std::optional(Field::reflectivity)
         : name == "signal"        ? std::optional(Field::signal)
         : name == "near_infrared" ? std::optional(Field::near_infrared)
         : name == "range"         ? std::optional(Field::range)
                                   : std::nullopt;
}

Status check_field(Profile profile, Field field) {
  if (field != Field::signal || profile != Profile::low_data) return {};
  return fail(ErrorCode::bad_input, "signal",
              "expected a profile whose packets have it, got " + std::string(name_of(profile)) +
                  "; take near_infrared or reflectivity, or configure the sensor with another "
                  "`udp_profile_lidar`");
}

FrameImage::FrameImage(const Metadata& m, const ImageOptions& options)
    : options_(options), width_(m.mode.columns) {
  const auto w = static_cast<std::int64_t>(width_);
  for (std::uint32_t row = 0; row < m.pixels_per_column; ++row) {
    const std::int64_t shift = row < m.pixel_shift.size() ? m.pixel_shift[row] : 0;
    shift_.push_back(static_cast<std::uint32_t>((shift % w + w) % w));
  }
  has_signal_ = m.profile != Profile::low_data;
  const std::size_t pixels = std::size_t{width_} * m.pixels_per_column;
  if (options.field == Field::range) {
    info_ = RangeImageInfo{width_, m.pixels_per_column};
    bytes_.resize(pixels * 2 * sizeof(float));
  } else {
    ImageInfo image;
    image.format = options.format;
    image.width_px = width_, image.height_px = m.pixels_per_column;
    info_ = image;
    bytes_.resize(image_bytes(options.format, width_, m.pixels_per_column));
  }
  clear();
}

void FrameImage::clear() {
  std::fill(bytes_.begin(), bytes_.end(), std::uint8_t{0});
  if (options_.field != Field::range) return;
  for (std::size_t at = 0; at < bytes_.size() / 2; at += sizeof(float))
    store_le(bytes_, at, std::numeric_limits<float>::quiet_NaN());
}

void FrameImage::set(std::uint32_t column, std::uint32_t row, const Pixel& p, std::uint16_t near_infrared) {
  std::uint32_t x = column + shift_[row];
  if (x >= width_) x -= width_;
  const std::size_t at = std::size_t{row} * width_ + x;
  if (options_.field == Field::range) {
    if (p.range_mm == 0) return;
    store_le(bytes_, at * sizeof(float), static_cast<float>(p.range_mm * 1e-3));
    store_le(bytes_, bytes_.size() / 2 + at * sizeof(float),
             static_cast<float>(has_signal_ ? p.signal : p.reflectivity));
    return;
  }
  const std::uint16_t value = options_.field == Field::reflectivity ? p.reflectivity
                              : options_.field == Field::signal     ? p.signal
                                                                    : near_infrared;
  if (options_.format == PixelFormat::mono16)
    store_le(bytes_, at * 2, value);
  else
    bytes_[at] = static_cast<std::uint8_t>(std::min(255.0, std::round(value * 255.0 / options_.full_scale)));
}

}  // namespace rigor::ouster
