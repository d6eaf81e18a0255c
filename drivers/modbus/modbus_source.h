// Registers of a Modbus device, over TCP or a serial line, as a channel.
//
// A thread of its own asks at t0 + k·period. A register block has no stamp of the device, so its capture is
// taken for the middle between request and answer; the device looked at its registers somewhere between the
// two, hence sigma_capture = width / √12 (uniform). A device that goes away takes the channel's `connected`
// with it; the thread tries again with growing pauses, from 50 ms to 2 s, and each instant of the grid
// without an answer counts as lost.
//
// Values that are NaN are handed on as NaN, and the sample is marked kCorrupt. Values with `every: n` keep
// what they were in between.
//
// Events: the device refuses (code: that of the exception, value: how often so far), is silent, sends what
// makes no sense, is gone, is back. Told when it begins or changes, not for each sample.
#pragma once

#include <memory>
#include <thread>
#include <vector>

#include "drivers/modbus/register_channel.h"
#include "rt-core/deadline.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/backoff.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::modbus {

/// Codes of events beside those of Modbus exceptions (1 to 11).
enum EventCode : std::uint32_t { kEventBack = 0, kEventSilent = 256, kEventGone = 257, kEventBroken = 258 };

class ModbusSource final : public StreamSource {
 public:
  ~ModbusSource() override;
  [[nodiscard]] SampleLease poll_event() noexcept override;
  /// What the device refused or left unanswered so far.
  [[nodiscard]] std::vector<std::string> warnings() const override;
  [[nodiscard]] const LinkCounters& link_counters() const noexcept { return link_.counters(); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  void run();
  void read_once(std::uint64_t index);
  void try_again();
  void failed(LinkStatus status);
  void tell(std::uint32_t code, double value, const std::string& text);
  void count_link();

  SourceSettings settings_;
  Link link_;
  Poller poller_;
  Deadline deadline_;
  std::vector<std::uint16_t> raw_;
  std::thread thread_;
  Backoff backoff_;
  std::uint64_t reconnects_ = 0;
  std::unique_ptr<SamplePool> event_pool_;
  std::unique_ptr<SpscRing<SampleLease>> events_;
  std::uint32_t last_event_ = kEventBack;
};

}  // namespace rigor::modbus
