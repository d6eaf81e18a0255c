// What all sources of this driver share: a stream of clouds that become samples of a channel.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "drivers/lidar/cloud_source.h"
#include "drivers/velodyne/velodyne_settings.h"

namespace rigor::velodyne {

class CloudChannel : public packet_lidar::CloudSource {
 public:
  [[nodiscard]] std::vector<std::string> warnings() const override { return warnings_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  /// Setup: memory and decoder for this model. bad_input: the calibration.
  [[nodiscard]] Status open_model(Model model, Feed feed);
  /// Producer thread: one datagram. Clouds go to the loop.
  void take(Bytes datagram, BenchTime arrival);
  /// The model by what packets say and show; a contradiction becomes a warning. unavailable: neither tells.
  [[nodiscard]] Result<Model> decide_model(std::uint8_t product, const ModelEvidence& evidence);

  SourceSettings settings_;
  std::unique_ptr<CloudStream> stream_;
  std::vector<std::string> warnings_;
};

}  // namespace rigor::velodyne
