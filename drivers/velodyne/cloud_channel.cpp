#include "drivers/velodyne/cloud_channel.h"

#include <algorithm>
#include <cstring>

#include "drivers/velodyne/calibration_file.h"

namespace rigor::velodyne {

Status CloudChannel::do_configure(const ChannelConfig& config) {
  settings_ = read_source_settings(config);
  description_.kind = SampleKind::point_cloud;
  description_.frame_id = settings_.frame_id;
  description_.max_bytes = settings_.stream.max_points * sizeof(LidarPoint);
  hand_ = [this](const Cloud& c) { hand(c); };
  return {};
}

Status CloudChannel::open_clouds(Model model, Feed feed) {
  Calibration calibration = factory_calibration(model);
  if (!settings_.calibration.empty()) {
    auto loaded = load_calibration(settings_.calibration, model);
    if (!loaded) return tl::unexpected<Error>(loaded.error());
    calibration = std::move(*loaded);
  }
  auto decoder = PacketDecoder::create(model, calibration, settings_.rings);
  if (!decoder) return tl::unexpected<Error>(decoder.error());
  stream_ = std::make_unique<CloudStream>(std::move(*decoder), settings_.stream);
  feed_ = feed;
  in_run_.reset();
  malformed_seen_ = 0;
  any_handed_ = false;
  last_release_ = {};
  open_stream(settings_.buffers, description_.max_bytes, feed == Feed::virtual_time);
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
  stream_->take(datagram, arrival, hand_);
  const std::uint64_t malformed = stream_->counters().malformed;
  if (malformed == malformed_seen_) return;
  health_.protocol_errors.fetch_add(malformed - malformed_seen_, std::memory_order_relaxed);
  malformed_seen_ = malformed;
}

void CloudChannel::hand(const Cloud& c) noexcept {
  RunSequence::Place place{c.sequence, c.lost_before};
  if (feed_ == Feed::live) {
    const auto in_run = in_run_.place(origin(), c.t_capture, config().period, c.sequence, c.lost_before);
    if (!in_run) return;
    place = *in_run;
  }
  if (place.lost > 0) count_lost(place.lost);
  SampleSlot slot = take_slot();
  const BenchTime release = c.t_capture + config().latency;
  last_release_ = release;
  any_handed_ = true;
  if (slot) {
    Sample& s = *slot;
    const std::size_t room = s.memory().size() / sizeof(LidarPoint);
    const std::size_t count = std::min(c.points.size(), room);
    s.size_bytes = count * sizeof(LidarPoint);
    if (count > 0) std::memcpy(s.memory().data(), c.points.data(), s.size_bytes);
    s.info = PointCloudInfo{static_cast<std::uint32_t>(count)};
    s.stamp = {};
    s.stamp.sequence = place.sequence;
    s.stamp.t_capture = c.t_capture;
    s.stamp.t_release = release;
    s.stamp.t_arrival = feed_ == Feed::virtual_time ? release : bench_now();
    s.stamp.sigma_capture = c.sigma;
    s.stamp.validity = c.validity;
    if ((c.validity & kIncomplete) != 0) health_.incomplete.fetch_add(1, std::memory_order_relaxed);
  }
  hand_over(std::move(slot));
}

}  // namespace rigor::velodyne
