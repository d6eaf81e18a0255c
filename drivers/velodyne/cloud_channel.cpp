#include "drivers/velodyne/cloud_channel.h"

#include "drivers/velodyne/calibration_file.h"

namespace rigor::velodyne {

Status CloudChannel::do_configure(const ChannelConfig& config) {
  settings_ = read_source_settings(config);
  description_.kind = SampleKind::point_cloud;
  description_.frame_id = settings_.frame_id;
  description_.max_bytes = settings_.stream.max_points * sizeof(LidarPoint);
  return {};
}

Status CloudChannel::open_model(Model model, Feed feed) {
  Calibration calibration = factory_calibration(model);
  if (!settings_.calibration.empty()) {
    auto loaded = load_calibration(settings_.calibration, model);
    if (!loaded) return tl::unexpected<Error>(loaded.error());
    calibration = std::move(*loaded);
  }
  auto decoder = PacketDecoder::create(model, calibration, settings_.rings);
  if (!decoder) return tl::unexpected<Error>(decoder.error());
  stream_ = std::make_unique<CloudStream>(std::move(*decoder), settings_.stream);
  open_clouds(settings_.buffers, settings_.stream.max_points, feed);
  return {};
}

Result<Model> CloudChannel::decide_model(std::uint8_t product, const ModelEvidence& evidence) {
  const auto by_byte = model_of(product);
  const auto by_time = evidence.model();
  const auto named = [](Model m) { return std::string(facts_of(m).name); };
  if (settings_.model) {
    if (by_time && *by_time != *settings_.model)
      warnings_.push_back("the rig says " + named(*settings_.model) + ", the packets' timing is that of a " +
                          named(*by_time) + ": check `model`");
    else if (by_byte != settings_.model)
      warnings_.push_back("the product byte says " +
                          (by_byte ? named(*by_byte) : std::string("no known model")) + ", the rig says " +
                          named(*settings_.model) + ", and the rig is followed");
    return *settings_.model;
  }
  if (by_time && by_byte != by_time)
    warnings_.push_back(
        "the product byte says " + (by_byte ? named(*by_byte) : std::string("no known model")) +
        ", the packets' timing is that of a " + named(*by_time) +
        ", which is taken; `model: " + std::string(facts_of(*by_time).key) + "` says so for good");
  if (by_time) return *by_time;
  if (by_byte) return *by_byte;
  return fail(ErrorCode::unavailable, config().name,
              "expected packets of a VLP-16 or HDL-32E, got product byte " + std::to_string(product) +
                  " and a timing of neither; say which it is by `model`");
}

void CloudChannel::take(Bytes datagram, BenchTime arrival) {
  stream_->take(datagram, arrival, hand());
  count_malformed(stream_->counters().malformed);
}

}  // namespace rigor::velodyne
