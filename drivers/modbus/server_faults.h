// How an emulated device misbehaves, to order.
#pragma once

#include <cstdint>
#include <mutex>

#include "drivers/modbus/pdu.h"
#include "rt-core/time.h"

namespace rigor::modbus {

/// Counted over all requests of all clients.
struct ServerFaults {
  Duration response_delay{};          ///< from the request to the answer
  std::uint32_t exception_every = 0;  ///< each n-th request gets `exception_code`; 0: none
  std::uint8_t exception_code = 4;    ///< 4: server device failure
  std::uint32_t silent_every = 0;     ///< each n-th request gets no answer; 0: none
  Duration from{};                    ///< after the start: none of it earlier
  Duration duration{};                ///< and for so long; 0: to the end
};

/// Decides the fate of each request. Any thread.
class FaultBox {
 public:
  struct Fate {
    bool silent = false;
    Exception exception = Exception::none;
  };
  explicit FaultBox(const ServerFaults& faults = {}) : faults_(faults) {}

  /// From the next request on.
  void set(const ServerFaults& faults) {
    const std::lock_guard lock(mutex_);
    faults_ = faults;
  }
  /// What `from` is counted from.
  void begin(BenchTime t) {
    const std::lock_guard lock(mutex_);
    begin_ = t;
  }
  [[nodiscard]] Duration delay(BenchTime now) {
    const std::lock_guard lock(mutex_);
    return on(now) ? faults_.response_delay : Duration(0);
  }
  /// Of the next request.
  [[nodiscard]] Fate next(BenchTime now) {
    const std::lock_guard lock(mutex_);
    ++seen_;
    Fate fate;
    if (!on(now)) return fate;
    fate.silent = faults_.silent_every != 0 && seen_ % faults_.silent_every == 0;
    if (faults_.exception_every != 0 && seen_ % faults_.exception_every == 0)
      fate.exception = static_cast<Exception>(faults_.exception_code);
    return fate;
  }

 private:
  [[nodiscard]] bool on(BenchTime now) const {
    const auto since = now - begin_;
    return since >= faults_.from && (faults_.duration.ns() == 0 || since < faults_.from + faults_.duration);
  }
  std::mutex mutex_;
  ServerFaults faults_;
  BenchTime begin_;
  std::uint64_t seen_ = 0;
};

}  // namespace rigor::modbus
