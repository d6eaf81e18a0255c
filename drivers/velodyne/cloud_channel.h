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
  /// Where the packets come from: a device that measures since before the run; packets of a recording, which
  /// begins with the run; either in virtual time.
  enum class Feed : std::uint8_t { live, recording, virtual_time };
  /// Setup: memory and decoder for this model. bad_input: the calibration.
  [[nodiscard]] Status open_clouds(Model model, Feed feed);
  /// Producer thread: one datagram. Clouds go to the loop.
  void take(Bytes datagram, BenchTime arrival);
  /// The model by what packets say and show; a contradiction becomes a warning. unavailable: neither tells.
  [[nodiscard]] Result<Model> decide_model(std::uint8_t product, const ModelEvidence& evidence);

  SourceSettings settings_;
  std::unique_ptr<CloudStream> stream_;
  std::vector<std::string> warnings_;
  BenchTime last_release_{};
  bool any_handed_ = false;

 private:
  void hand(const Cloud& cloud) noexcept;
  Feed feed_ = Feed::live;
  RunSequence in_run_;
  std::uint64_t malformed_seen_ = 0;
  CloudStream::Hand hand_;
};

}  // namespace rigor::velodyne
