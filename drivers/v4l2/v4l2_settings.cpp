#include "drivers/v4l2/v4l2_settings.h"

#include "drivers/v4l2/frame_conversion.h"
#include "sensor-hal/config/sample_size.h"

namespace rigor::v4l2 {
namespace {

Duration read_us(const ConfigNode& n, std::string_view key, double fallback_us, double max_us) {
  return seconds_from(n.number_or(key, fallback_us, {.min = 0, .max = max_us}) * 1e-6);
}

std::vector<std::string> sample_formats() {
  std::vector<std::string> names;
  for (const PixelFormat f : kPixelFormats)
    if (!codes_for(f).empty()) names.emplace_back(pfnc_name(f));
  for (const PixelFormat f : kVideoFormats) names.emplace_back(pfnc_name(f));
  return names;
}

}  // namespace

std::string default_frame_id(const std::string& channel_name) {
  return channel_name.substr(0, channel_name.find('.')) + "_optical";
}

Settings read_settings(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  if (config.kind != SampleKind::image)
    throw n.error("kind", "expected image: a video device gives nothing else; got another kind");
  Settings s;
  s.device = n.text("device");
  s.frame_id = n.text_or("frame_id", default_frame_id(config.name));
  s.format.format = *pixel_format_from(n.choice_or("pixel_format", sample_formats(), "Mono8"));
  if (const std::string code = n.text_or("device_format", "auto"); code != "auto") {
    const auto parsed = fourcc_from(code);
    if (!parsed)
      throw n.error("device_format",
                    "expected auto or a format of one to four characters like YUYV, got \"" + code + "\"");
    s.format.code = *parsed;
  }
  constexpr double kMax = 65535;
  s.format.width_px = static_cast<std::uint32_t>(n.integer_or("width_px", 0, {.min = 1, .max = kMax}));
  s.format.height_px = static_cast<std::uint32_t>(n.integer_or("height_px", 0, {.min = 1, .max = kMax}));
  if ((s.format.width_px == 0) != (s.format.height_px == 0))
    throw n.error(s.format.width_px == 0 ? "height_px" : "width_px",
                  "expected width_px and height_px, got one of them");
  check_picture_size(n, s.format.width_px, s.format.height_px);
  if ((is_yuv(s.format.format) && s.format.width_px % 2 != 0) ||
      (s.format.format == PixelFormat::yuv420_sp && s.format.height_px % 2 != 0))
    throw n.error("width_px", "expected an even size: " + std::string(pfnc_name(s.format.format)) +
                                  " has one colour for several pixels");
  s.format.period = config.period;
  s.controls = n.map_or_absent("controls");
  if (n.has("exposure_us")) s.exposure = read_us(n, "exposure_us", 0, 60e6);
  s.readout = read_us(n, "readout_us", 0, 10e6);
  s.global_shutter = n.choice_or("shutter", {"rolling", "global"}, "rolling") == "global";
  s.dmabuf = n.choice_or("memory", {"mmap", "dmabuf"}, "mmap") == "dmabuf";
  s.queue = static_cast<std::uint32_t>(n.integer_or("queue", 4, {.min = 2, .max = 32}));
  s.buffers = static_cast<std::size_t>(n.integer_or("buffers", 8, {.min = 2, .max = 256}));
  check_buffer_memory(n, "buffers", s.buffers,
                      image_bytes(s.format.format, s.format.width_px, s.format.height_px));
  s.drop_incomplete = n.choice_or("incomplete", {"mark", "drop"}, "mark") == "drop";
  s.silence = seconds_from(n.number_or("silence_ms", 2000, {.min = 50, .max = 600'000}) * 1e-3);
  // Names of controls are known only to the device: check_controls reads this map at arm.
  for (const std::string& name : s.controls.present() ? s.controls.keys() : std::vector<std::string>{})
    (void)s.controls.text(name);
  return s;
}

std::vector<std::uint32_t> read_codes(const ConfigNode& n, std::string_view key, std::uint32_t fallback) {
  if (!n.has(key)) return {fallback};
  std::vector<std::uint32_t> codes;
  for (const ConfigNode& item : n.list(key)) {
    const auto code = fourcc_from(item.as_text());
    if (!code || !made_from(*code))
      throw item.error(
          {},
          "expected a format that can be made, such as GREY, Y10, Y12, Y16, YUYV, UYVY, NV12, RGB3, "
          "BGR3, RGGB, MJPG, Z16; got \"" +
              item.as_text() + "\"");
    codes.push_back(*code);
  }
  if (codes.empty()) throw n.error(key, "expected at least one format, got none");
  return codes;
}

}  // namespace rigor::v4l2
