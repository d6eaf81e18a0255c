#include "drivers/v4l2/emulated_video.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "drivers/v4l2/v4l2_settings.h"
#include "sensor-hal/config/rate.h"

namespace rigor::v4l2 {

EmulatedVideoSettings read_emulated_video(const ConfigNode& n, const std::string& name,
                                          const Period& period) {
  EmulatedVideoSettings s;
  s.codes = read_codes(n, "formats", kYuyv);
  s.rate_hz =
      read_rate_or(n, "rate_hz", period.ns() > 0 ? period : Period::of_rate(30), {.min = 0.1, .max = 1000})
          .hz();
  if (n.has("exposure_us"))
    s.exposure = seconds_from(n.number("exposure_us", {.min = 0, .max = 10e6, .exclusive_min = true}) * 1e-6);
  s.gain_db = n.number_or("gain_db", 0, {.min = -40, .max = 80});
  s.readout = seconds_from(n.number_or("readout_us", 0, {.min = 0, .max = 1e6}) * 1e-6);
  s.event = n.choice_or("timestamp", {"end_of_frame", "start_of_exposure"}, "end_of_frame") == "end_of_frame"
                ? TimestampEvent::end_of_frame
                : TimestampEvent::start_of_exposure;
  s.jpeg_quality = static_cast<int>(n.integer_or("jpeg_quality", 90, {.min = 1, .max = 100}));
  s.card = n.text_or("card", "Rigor " + name);
  if (std::find(s.codes.begin(), s.codes.end(), kZ16) != s.codes.end()) {
    const Range positive{.min = 0, .max = 1e6, .exclusive_min = true};
    s.lens.fx_px = n.number("fx_px", positive), s.lens.fy_px = n.number("fy_px", positive);
    s.lens.cx_px = n.number("cx_px"), s.lens.cy_px = n.number("cy_px");
    s.lens.unit_m = n.number_or("depth_unit_m", 0.001, positive);
  }
  return s;
}

void depth_from_range(std::span<const std::byte> range_m, std::uint32_t width_px, std::uint32_t height_px,
                      const EmulatedVideoSettings::Lens& lens, std::span<std::byte> depth) noexcept {
  const std::size_t pixels =
      std::min({range_m.size() / sizeof(float), depth.size() / 2, std::size_t{width_px} * height_px});
  for (std::size_t i = 0; i < pixels; ++i) {
    float range = 0;
    std::memcpy(&range, range_m.data() + i * sizeof range, sizeof range);
    const double x = (static_cast<double>(i % width_px) - lens.cx_px) / lens.fx_px;
    const double y = (static_cast<double>(i / width_px) - lens.cy_px) / lens.fy_px;
    const double units = static_cast<double>(range) / std::sqrt(1 + x * x + y * y) / lens.unit_m;
    const auto z =
        units > 0 && units < 65535.5 ? static_cast<std::uint16_t>(std::lround(std::min(units, 65535.0))) : 0;
    const std::byte bytes[2] = {static_cast<std::byte>(z & 0xFF), static_cast<std::byte>(z >> 8)};
    std::memcpy(depth.data() + 2 * i, bytes, 2);
  }
}

EmulatedPictures::EmulatedPictures(const EmulatedVideoSettings& settings, DeviceParts parts)
    : settings_(settings), parts_(std::move(parts)) {}

Result<EmulatedPictures> EmulatedPictures::create(const EmulatedVideoSettings& settings,
                                                  const DeviceParts& parts, const std::string& name) {
  EmulatedPictures p(settings, parts);
  const bool depth = std::find(settings.codes.begin(), settings.codes.end(), kZ16) != settings.codes.end();
  if (depth && settings.codes.size() > 1)
    return fail(ErrorCode::bad_input, name, "expected Z16 alone: depth and light come from two sensors");
  if (depth) {
    if (!parts.samples || parts.samples->geometry().kind != SampleKind::range_image)
      return fail(ErrorCode::bad_input, name,
                  "expected something that measures range for Z16: give this emulator the `sensor` of a "
                  "time-of-flight camera and `kind: range_image`");
    const auto g = parts.samples->geometry();
    p.width_px_ = g.width_px, p.height_px_ = g.height_px;
    p.range_ = make_sample_pool(1, g.max_bytes);
    p.exposure_ = settings.exposure.value_or(Duration{});
  } else {
    if (!parts.image)
      return fail(ErrorCode::bad_input, name,
                  "expected something that makes pictures: give this emulator a `sensor` in the rig");
    const auto g = parts.image->geometry();
    p.width_px_ = g.width_px, p.height_px_ = g.height_px;
    p.exposure_ = settings.exposure.value_or(g.exposure);
  }
  for (const std::uint32_t code : settings.codes) {
    const PixelFormat from = made_from(code).value_or(PixelFormat::mono8);
    if ((is_yuv(from) || code == kMjpg) && (p.width_px_ % 2 != 0 || p.height_px_ % 2 != 0))
      return fail(ErrorCode::bad_input, name, "expected a sensor of even size for " + fourcc_text(code));
  }
  p.set_code(settings.codes.front());
  return p;
}

void EmulatedPictures::set_code(std::uint32_t code) {
  code_ = code;
  maker_ = std::make_unique<FrameMaker>(code, width_px_, height_px_, settings_.jpeg_quality);
  picture_.resize(image_bytes(made_from(code).value_or(PixelFormat::mono8), width_px_, height_px_));
}

std::size_t EmulatedPictures::capture(std::uint64_t index, BenchTime t_capture, BenchTime t_start,
                                      std::span<std::byte> out) {
  const WorldMotion motion = parts_.motion ? parts_.motion->motion_at(t_capture) : WorldMotion{};
  if (range_) {
    SampleSlot slot = range_->try_acquire();
    if (!parts_.samples->capture(
            {.index = index, .t_capture = t_capture, .t_start = t_start, .motion = motion}, *slot))
      return 0;
    const auto* info = slot->as<RangeImageInfo>();
    if (!info || info->width_px != width_px_ || info->height_px != height_px_) return 0;
    depth_from_range(slot->bytes(), width_px_, height_px_, settings_.lens, picture_);
  } else {
    ImageRequest q;
    q.index = index;
    q.t_capture = t_capture, q.t_start = t_start;
    q.exposure = exposure_, q.gain_db = settings_.gain_db;
    q.width_px = width_px_, q.height_px = height_px_;
    q.format = made_from(code_).value_or(PixelFormat::mono8);
    q.motion = motion;
    if (!parts_.image->capture(q, picture_)) return 0;
  }
  return maker_->make(picture_, out);
}

}  // namespace rigor::v4l2
