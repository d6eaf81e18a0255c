// Registers of a Modbus TCP device as a channel.
//
// A thread of its own asks at t0 + k·period. A register block has no stamp of the device, so its capture is
// taken for the middle between request and answer; the device looked at its registers somewhere between the
// two, hence sigma_capture = width / √12 (uniform). A device that goes away takes the channel's `connected`
// with it; the thread tries again with growing pauses, from 50 ms to 2 s, and each instant of the grid
// without an answer counts as lost.
//
// Values that are NaN are handed on as NaN, and the sample is marked kCorrupt.
#pragma once

#include <atomic>
#include <memory>
#include <thread>
#include <vector>

#include "rt-core/deadline.h"
#include "drivers/modbus/register_channel.h"
#include "rt-core/spsc_ring.h"

namespace rigor::modbus {

class ModbusSource final : public Source {
 public:
  ~ModbusSource() override;
  [[nodiscard]] SampleLease poll(BenchTime now) noexcept override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void run(BenchTime t0);
  void read_once(std::uint64_t index, std::uint32_t& lost);
  void try_again();

  SourceSettings settings_;
  Link link_;
  Deadline deadline_;
  std::unique_ptr<SamplePool> pool_;
  std::unique_ptr<SpscRing<SampleLease>> ring_;
  std::vector<std::uint16_t> raw_;
  std::thread thread_;
  MonotonicTime next_attempt_;
  Duration pause_;
};

}  // namespace rigor::modbus
