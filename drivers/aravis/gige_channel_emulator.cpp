#include "drivers/aravis/gige_channel_emulator.h"

namespace rigor {

GigeChannelEmulator::GigeChannelEmulator() = default;
GigeChannelEmulator::~GigeChannelEmulator() { (void)do_stop(); }

std::string GigeChannelEmulator::endpoint() const {
  return "GigE Vision camera " + settings_.vendor + "-" + settings_.serial + " at " + settings_.address;
}

gige::GigeEmulatorHealth GigeChannelEmulator::counters() const { return camera_ ? camera_->health() : last_; }

Status GigeChannelEmulator::do_configure(const ChannelConfig& config) {
  name_ = config.name;
  settings_ = read_emulated_camera(config.params, config.name, config.period);
  description_.kind = SampleKind::image;
  return {};
}

Status GigeChannelEmulator::do_arm(const ArmContext&) {
  const auto sensor = sensor_of(parts_);
  if (!sensor)
    return fail(
        ErrorCode::bad_input, name_,
        "expected something that makes pictures or measures range: give this emulator the `sensor` of a "
        "camera or of a time-of-flight camera in the rig");
  const ImageProvider::Geometry& g = sensor->geometry;
  options_.camera = camera_config(settings_, *sensor);
  description_.kind = sensor->range ? SampleKind::range_image : SampleKind::image;
  options_.address = settings_.address;
  options_.link_bits_per_s = settings_.link_bits_per_s;
  // What would be refused at start is said now.
  if (auto model = gige::GigeDeviceModel::create(options_.camera); !model)
    return fail(model.error().code, name_, model.error().text());
  description_.width_px = g.width_px, description_.height_px = g.height_px;
  description_.format = g.format, description_.frame_id = g.frame_id;
  return {};
}

Status GigeChannelEmulator::do_start(BenchTime) {
  auto camera = gige::GigeEmulator::start(options_, picture_of(parts_, settings_, BenchTime(0)));
  if (!camera) return fail(camera.error().code, name_, camera.error().text());
  camera_ = std::move(*camera);
  watch_.emplace([this] {
    const gige::GigeEmulatorHealth h = camera_->health();
    health_.connected = h.controlled;
    health_.received = h.frames_sent;
    health_.lost = h.exposures_skipped + h.pictures_missing + h.blocks_dropped;
    health_.protocol_errors = h.malformed;
    health_.retries = h.resend_requests;
  });
  return {};
}

Status GigeChannelEmulator::do_stop() {
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
