// A GenICam camera (GigE Vision, USB3 Vision) as a channel, by way of Aravis. Keys: aravis_settings.h.
//
//   receiving thread   Aravis' own: packets straight into the memory of the pool's slots, resends
//   frame thread       what is complete gets its stamp and goes to the loop; the next free slot goes to the
//   camera.
//                      No pixel is copied.
//   control thread     software triggers, action commands, timestamp latches, loss of the camera and its
//   return
//
// Times. A camera stamps the start of an exposure with its own clock. That clock is tied to the bench clock
// by timestamp latches once a second (or by the quickest arrivals, where the camera cannot latch); t_capture
// is the middle of the exposure, and sigma_capture says how well it is known.
//
// The camera streams from arm on. Frames of before the run are discarded; they keep the clock map fresh.
//
// Loss. No frame for five periods (at least 200 ms), and no answer when asked: `health().connected` falls,
// and the camera is looked for until it is back; then it is set as before, and the sequence goes on by the
// time that went by. A frame that is not whole after resends is marked kIncomplete, its gaps are zero; never
// is it handed on as whole.
//
// Where the rig gives no region, width and height of the description are known from arm on.
#pragma once

#include <memory>

#include "drivers/aravis/action_group.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor {

class AravisSource final : public StreamSource {
 public:
  AravisSource();
  ~AravisSource() override;

  void begin_cycle(BenchTime now) noexcept override;
  [[nodiscard]] std::vector<std::string> warnings() const override;

  /// What the receiver did, beside health(). Any thread.
  struct Counters {
    std::uint64_t resent_packets = 0, resend_requests = 0, underruns = 0;
    std::uint64_t latches = 0, triggers_sent = 0, triggers_missed = 0;
    ActionStatistics actions;  ///< of `trigger: action`
  };
  [[nodiscard]] Counters counters() const;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
