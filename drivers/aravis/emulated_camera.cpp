#include "drivers/aravis/emulated_camera.h"

#include <algorithm>
#include <array>

#include "drivers/aravis/range_parts.h"
#include "sensor-hal/config/rate.h"

namespace rigor {
namespace {

constexpr std::array<std::pair<PixelFormat, gige::PixelFormat>, rigor::kPixelFormats.size()> kFormats{{
    {PixelFormat::mono8, gige::PixelFormat::mono8},
    {PixelFormat::mono12p, gige::PixelFormat::mono12p},
    {PixelFormat::mono16, gige::PixelFormat::mono16},
    {PixelFormat::bayer_rg8, gige::PixelFormat::bayer_rg8},
    {PixelFormat::rgb8, gige::PixelFormat::rgb8},
    {PixelFormat::mono10, gige::PixelFormat::mono10},
    {PixelFormat::mono12, gige::PixelFormat::mono12},
    {PixelFormat::bayer_rg10, gige::PixelFormat::bayer_rg10},
    {PixelFormat::bayer_rg12, gige::PixelFormat::bayer_rg12},
    {PixelFormat::bayer_rg16, gige::PixelFormat::bayer_rg16},
}};

std::uint32_t step_for(std::uint32_t size, std::uint32_t wanted) {
  while (wanted > 1 && size % wanted != 0) wanted /= 2;
  return wanted;
}

}  // namespace

gige::PixelFormat to_gige(PixelFormat f) {
  for (const auto& [ours, theirs] : kFormats)
    if (ours == f) return theirs;
  return f == PixelFormat::coord3d_c16 ? gige::PixelFormat::coord3d_c16 : gige::PixelFormat::mono8;
}

bool from_gige(gige::PixelFormat from, PixelFormat& to) {
  for (const auto& [ours, theirs] : kFormats)
    if (theirs == from) {
      to = ours;
      return true;
    }
  return false;
}

EmulatedCameraSettings read_emulated_camera(const ConfigNode& n, const std::string& name,
                                            const Period& period) {
  EmulatedCameraSettings s;
  s.address = n.text_or("address", "127.0.0.1");
  if (!gige::parse_ipv4(s.address))
    throw n.error("address",
                  "expected an IPv4 address of this machine like 127.0.0.1, got \"" + s.address + "\"");
  s.usb3vision = n.choice_or("as", {"gige", "usb3vision"}, "gige") == "usb3vision";
  if (s.usb3vision) {
    s.port = static_cast<std::uint16_t>(n.integer_or("port", 3240, {.min = 0, .max = 65535}));
    s.bus_id = n.text_or("bus_id", "1-1");
    s.start_delay = seconds_from(n.number_or("start_ms", 0, {.min = 0, .max = 60'000}) * 1e-3);
    s.response = milliseconds(n.integer_or("response_ms", 1000, {.min = 1, .max = 60'000}));
  }
  s.vendor = n.text_or("vendor", "Rigor");
  s.model = n.text_or("camera_model", s.usb3vision ? "Emulated USB3 camera" : "Emulated GigE camera");
  s.serial = n.text_or("serial", name);
  s.user_name = n.text_or("user_name", "");
  s.rate_hz =
      read_rate_or(n, "rate_hz", period.ns() > 0 ? period : Period::of_rate(25), {.min = 0.1, .max = 10'000})
          .hz();
  s.readout = seconds_from(n.number_or("readout_us", 1000, {.min = 0, .max = 1e6}) * 1e-6);
  s.align_to_clock = n.flag_or("align_to_clock", true);
  if (const auto line = n.map_or_absent("trigger_line"); line.present()) {
    s.line_period = read_rate(line, "rate_hz", {.min = 0.001, .max = 1e5});
    s.line_phase = seconds_from(line.number_or("phase_us", 0, {.min = 0, .max = 1e9}) * 1e-6);
    line.finish();
  }
  if (const auto ptp = n.map_or_absent("ptp"); ptp.present()) {
    s.ptp.present = true;
    s.ptp.settle = seconds_from(ptp.number_or("settle_s", 2, {.min = 0, .max = 3600}));
    s.ptp.offset = nanoseconds(ptp.integer_or("offset_ns", 200, {.min = 0, .max = 1e9}));
    ptp.finish();
  }
  s.range_scale_mm = n.number_or("range_scale_mm", 0.25, {.min = 1e-6, .max = 1000});
  s.amplitude_scale = n.number_or("amplitude_scale", 1, {.min = 1e-9, .max = 1e9});
  s.link_bits_per_s =
      n.number_or("link_mbit_per_s", s.usb3vision ? 3200 : 1000, {.min = 1, .max = 100'000}) * 1e6;
  return s;
}

std::optional<EmulatedSensor> sensor_of(const DeviceParts& parts) {
  if (parts.image) return EmulatedSensor{parts.image->geometry(), false};
  if (!parts.samples || parts.samples->geometry().kind != SampleKind::range_image) return std::nullopt;
  const auto g = parts.samples->geometry();
  return EmulatedSensor{{.width_px = g.width_px,
                         .height_px = g.height_px,
                         .format = PixelFormat::coord3d_c16,
                         .exposure = milliseconds(1),
                         .frame_id = g.frame_id},
                        true};
}

gige::GigeCameraConfig camera_config(const EmulatedCameraSettings& s, const EmulatedSensor& what) {
  const ImageProvider::Geometry& sensor = what.geometry;
  gige::GigeCameraConfig c;
  c.range.present = what.range;
  c.range.scale_mm = s.range_scale_mm;
  c.vendor = s.vendor, c.model = s.model, c.serial = s.serial, c.user_name = s.user_name;
  c.ip = gige::parse_ipv4(s.address).value_or(c.ip);
  c.sensor_width_px = sensor.width_px, c.sensor_height_px = sensor.height_px;
  c.width_step_px = step_for(sensor.width_px, 4);
  c.height_step_px = step_for(sensor.height_px, 2);
  c.formats = {to_gige(sensor.format)};
  for (const auto& [ours, theirs] : kFormats)
    if (!what.range && ours != sensor.format) c.formats.push_back(theirs);
  c.frame_rate_hz = s.rate_hz;
  c.max_frame_rate_hz = std::max(c.max_frame_rate_hz, s.rate_hz);
  c.min_frame_rate_hz = std::min(c.min_frame_rate_hz, s.rate_hz);
  if (sensor.exposure.ns() > 0)
    c.exposure_us = std::clamp(sensor.exposure.seconds() * 1e6, c.min_exposure_us, c.max_exposure_us);
  c.readout = s.readout;
  c.align_to_clock = s.align_to_clock;
  c.line_period = s.line_period, c.line_phase = s.line_phase;
  c.ptp = s.ptp;
  return c;
}

namespace {

/// Range and amplitude as counts.
class RangePictures {
 public:
  RangePictures(const DeviceParts& parts, const EmulatedCameraSettings& s, BenchTime device_zero)
      : parts_(parts),
        geometry_(parts.samples->geometry()),
        scale_m_(s.range_scale_mm * 1e-3),
        amplitude_scale_(s.amplitude_scale),
        device_zero_(device_zero),
        sample_(std::make_shared<Sample>()) {
    sample_->reserve(geometry_.max_bytes);
  }
  bool operator()(const gige::FrameRequest& r, gige::MutableBytes out) const {
    SampleProvider::Request q;
    q.index = r.index;
    q.t_capture = device_zero_ + Duration(r.t_exposure_start.ns()) + r.exposure / 2;
    if (parts_.motion) q.motion = parts_.motion->motion_at(q.t_capture);
    if (!parts_.samples->capture(q, *sample_)) return false;
    const std::size_t pixels = std::size_t{geometry_.width_px} * geometry_.height_px;
    if (sample_->size_bytes < pixels * 2 * sizeof(float)) return false;
    const std::span<const float> planes(reinterpret_cast<const float*>(sample_->bytes().data()), 2 * pixels);
    const std::size_t picture = std::size_t{r.region.width_px} * r.region.height_px * 2;
    if (r.range) range_to_counts(planes.first(pixels), geometry_.width_px, r.region, scale_m_, out);
    if (r.amplitude)
      amplitude_to_counts(planes.subspan(pixels), geometry_.width_px, r.region, amplitude_scale_,
                          out.subspan(r.range ? picture : 0));
    return true;
  }

 private:
  DeviceParts parts_;
  SampleProvider::Geometry geometry_;
  double scale_m_, amplitude_scale_;
  BenchTime device_zero_;
  std::shared_ptr<Sample> sample_;  // one frame at a time
};

}  // namespace

gige::FillFrame picture_of(const DeviceParts& parts, const EmulatedCameraSettings& settings,
                           BenchTime device_zero) {
  if (!parts.image) return RangePictures(parts, settings, device_zero);
  return [parts, device_zero](const gige::FrameRequest& r, gige::MutableBytes out) {
    ImageRequest q;
    q.index = r.index;
    q.t_capture = device_zero + Duration(r.t_exposure_start.ns()) + r.exposure / 2;
    q.exposure = r.exposure;
    q.gain_db = r.gain_db;
    q.offset_x_px = r.region.x_px, q.offset_y_px = r.region.y_px;
    q.width_px = r.region.width_px, q.height_px = r.region.height_px;
    if (!from_gige(r.format, q.format)) return false;
    if (parts.motion) q.motion = parts.motion->motion_at(q.t_capture);
    return parts.image->capture(q, std::as_writable_bytes(std::span(out.data(), out.size()))).has_value();
  };
}

}  // namespace rigor
