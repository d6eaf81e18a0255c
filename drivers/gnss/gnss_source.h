// A satellite receiver on a serial line or at a TCP server, or a recording of one, as a channel: places,
// solutions as registers, or satellites in view. Keys: gnss_settings.h; what samples hold: solution_sample.h.
// Several channels may share one receiver; they say the same keys.
//
// Line: `arm` opens it, finds its speed where that is asked for, configures the receiver where that is asked
// for, and waits for a message. A receiver that goes away, or says nothing that makes sense for `silence_s`,
// is looked for, and configured again.
//
// Recording: it has no arrival times; solutions come at the distances that their own times have, from the
// run's start on.
#pragma once

#include <memory>
#include <optional>
#include <thread>

#include "drivers/gnss/receiver.h"
#include "drivers/gnss/solution_sample.h"
#include "rt-core/deadline.h"

namespace rigor::gnss {

class GnssSource final : public ReceiverSource, private ReceiverClient {
 public:
  ~GnssSource() override;
  void complete_until(BenchTime now) override;
  [[nodiscard]] std::vector<std::string> warnings() const override { return warnings_; }
  /// Of the line, beside health(). Any thread.
  [[nodiscard]] LineCounters line_counters() const;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return settings_.file.empty(); }
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void on_solution(const Solution& s, const ReceiverStream::Place& p) override { hand_solution(s, p); }
  void on_sky(const Sky& s, const ReceiverStream::Place& p) override { hand_sky(s, p); }
  void on_pulse(const TimePulse& p) override { note_pulse(p); }
  void on_connection(bool connected) override;
  void on_counters(const LineCounters& c) override;

  Status arm_file(bool virtual_time);
  /// Reads on until something is handed over that is released after `now`, or to the end.
  void read_file(BenchTime now);
  void run_file();

  ChannelSettings settings_;
  std::vector<std::string> warnings_;
  std::shared_ptr<Receiver> receiver_;
  bool was_connected_ = false;
  LineCounters seen_;
  mutable std::mutex counters_mutex_;
  LineCounters counters_;
  // Of a recording.
  std::ifstream file_;
  std::unique_ptr<ReceiverStream> stream_;
  std::optional<DeviceTime> first_;  ///< of the recording's first solution
  bool ended_ = false;
  BenchTime t0_;
  Deadline deadline_;
  std::thread thread_;
};

}  // namespace rigor::gnss
