// What all sources of this driver share: a stream of clouds that become samples of a channel.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "drivers/velodyne/velodyne_settings.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::velodyne {

class CloudChannel : public StreamSource {
 public:
  [[nodiscard]] std::vector<std::string> warnings() const override { return warnings_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  /// Setup: memory and decoder for this model. bad_input: the calibration.
  [[nodiscard]] Status open_clouds(Model model, bool virtual_time);
  /// Producer thread: one datagram. Clouds go to the loop.
  void take(Bytes datagram, BenchTime arrival);
  /// The model by what packets say and show; a contradiction becomes a warning. unavailable: neither tells.
  [[nodiscard]] Result<Model> decide_model(std::uint8_t product, const ModelEvidence& evidence);

  [[nodiscard]] bool virtual_time() const { return virtual_time_; }

  SourceSettings settings_;
  std::unique_ptr<CloudStream> stream_;
  std::vector<std::string> warnings_;
  BenchTime last_release_{};
  bool any_handed_ = false;

 private:
  void hand(const Cloud& cloud) noexcept;
  bool virtual_time_ = false;
  std::uint64_t malformed_seen_ = 0;
  CloudStream::Hand hand_;
};

}  // namespace rigor::velodyne
