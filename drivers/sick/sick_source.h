// A SICK LMS1xx, LMS5xx or TiM over CoLa-B on TCP as a channel of point clouds.
//
// `arm` connects, logs in, sets what the rig asks for and checks it, and starts the telegram stream. Scans of
// before the run teach the clock and are discarded.
// Scans are stamped by the device's clock, which is mapped by the instants at which telegrams arrive
// (one-sided: none comes before it was sent). t_capture is the first beam of the output range. A device that
// goes away is tried again with growing pauses; the scans of the time between count as lost.
//
// Losses: the device counts its scans, and what is missing between two telegrams was dropped on its side (its
// buffer was full); TCP itself loses nothing.
#pragma once

#include <memory>

#include "sensor-hal/channel/stream_source.h"

namespace rigor::sick {

class SickSource final : public StreamSource {
 public:
  SickSource();
  ~SickSource() override;
  [[nodiscard]] std::vector<std::string> warnings() const override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  struct Impl;
  void run();
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::sick
