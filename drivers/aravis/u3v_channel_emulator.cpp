#include "drivers/aravis/u3v_channel_emulator.h"

namespace rigor {

U3vChannelEmulator::U3vChannelEmulator() = default;
U3vChannelEmulator::~U3vChannelEmulator() { (void)do_stop(); }

std::string U3vChannelEmulator::endpoint() const {
  const std::uint16_t port = camera_ ? camera_->port() : settings_.port;
  return "USB3 Vision camera " + settings_.vendor + "-" + settings_.serial + " on USB/IP at " +
         settings_.address + ":" + std::to_string(port) + " (sudo usbip --tcp-port " + std::to_string(port) +
         " attach -r " + settings_.address + " -b " + settings_.bus_id + ")";
}

Status U3vChannelEmulator::do_configure(const ChannelConfig& config) {
  name_ = config.name;
  settings_ = read_emulated_camera(config.params, config.name, config.period);
  description_.kind = SampleKind::image;
  return {};
}

Status U3vChannelEmulator::do_arm(const ArmContext&) {
  const auto sensor = sensor_of(parts_);
  if (!sensor)
    return fail(
        ErrorCode::bad_input, name_,
        "expected something that makes pictures: give this emulator the `sensor` of a camera in the rig");
  const ImageProvider::Geometry& g = sensor->geometry;
  options_.camera.camera = camera_config(settings_, *sensor);
  options_.camera.start_delay = settings_.start_delay;
  options_.camera.response_ms = static_cast<std::uint32_t>(settings_.response.ns() / 1'000'000);
  options_.address = settings_.address;
  options_.port = settings_.port;
  options_.bus_id = settings_.bus_id;
  options_.link_bits_per_s = settings_.link_bits_per_s;
  // What would be refused at start is said now.
  if (auto camera = u3v::Camera::create(options_.camera); !camera)
    return fail(camera.error().code, name_, camera.error().message);
  description_.width_px = g.width_px, description_.height_px = g.height_px;
  description_.format = g.format, description_.frame_id = g.frame_id;
  return {};
}

Status U3vChannelEmulator::do_start(BenchTime) {
  auto camera = u3v::Emulator::start(options_, picture_of(parts_, settings_, BenchTime(0)));
  if (!camera) return fail(camera.error().code, name_, camera.error().text());
  camera_ = std::move(*camera);
  watch_.emplace([this] {
    const u3v::EmulatorHealth h = camera_->health();
    health_.connected = h.imported;
    health_.received = h.frames_sent;
    health_.lost = h.exposures_skipped + h.pictures_missing + h.frames_dropped + h.frames_cut;
    health_.protocol_errors = h.malformed + h.bus_errors;
  });
  return {};
}

Status U3vChannelEmulator::do_stop() {
  watch_.reset();
  if (camera_) {
    camera_->stop();
    last_ = camera_->health();
  }
  camera_.reset();
  health_.connected = false;
  return {};
}

}  // namespace rigor
