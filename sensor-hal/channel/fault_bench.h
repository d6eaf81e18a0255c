// The faults of a whole run: those of every source and sink, what triggers them, and those that are asked for
// while the run goes on.
//
//   thread that injects                       loop, once a cycle, before all else
//   inject("left", {kind: drop}) ──ring──▶    begin_cycle(now): takes up what came; each fault is on or off
//   clear("left")                ──ring──▶    poll_change(): begins and ends, for the recorder
//
// What is injected takes effect at the next cycle. Triggers see the ports as the cycle before left them.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/application.h"
#include "sensor-hal/channel/fault_sink.h"
#include "sensor-hal/channel/fault_source.h"

namespace rigor {

class FaultBench {
 public:
  /// Channel number of what belongs to no recorded channel: sinks.
  static constexpr std::uint32_t kNoChannel = 0xffffffffu;
  struct Entry {
    std::string name;  ///< of the channel or sink; of a pair's side `left.real`
    std::uint32_t channel = kNoChannel;
    FaultInjector* injector = nullptr;
    FaultySource* source = nullptr;  ///< one of the two
    FaultySink* sink = nullptr;
  };

  // Setup context. Sources and sinks are configured, and outlive the bench.
  void add(FaultySource& source, std::uint32_t channel);
  void add(FaultySink& sink);
  /// Finds what triggers name. bad_input with the place in the rig.
  [[nodiscard]] Status bind(const std::vector<InputPort>& ports);
  [[nodiscard]] const std::vector<Entry>& entries() const noexcept { return entries_; }
  /// By name; bad_input with the names that there are.
  [[nodiscard]] Result<const Entry*> find(const std::string& name) const;
  /// Whether any fault is scheduled.
  [[nodiscard]] bool any_scheduled() const noexcept;

  // One thread, which is not the loop's, while the loop runs.
  /// From the next cycle on, for `for_s` or until it is cleared. The fault's index in its channel.
  [[nodiscard]] Result<std::uint32_t> inject(const std::string& name, const ConfigNode& fault);
  /// Ends the live faults of one channel, or of all (empty name).
  [[nodiscard]] Status clear(const std::string& name);

  // Loop thread; no allocation, no lock.
  void begin_cycle(BenchTime now) noexcept;
  /// The next begin or end of a fault, and where it is. Null: there is none.
  [[nodiscard]] const Entry* poll_change(FaultChange& change) noexcept;

 private:
  struct Order {
    FaultInjector* to = nullptr;
    Fault* fault = nullptr;  ///< null: its live faults end
  };
  std::vector<Entry> entries_;
  SpscRing<Order> orders_{256};
};

}  // namespace rigor
