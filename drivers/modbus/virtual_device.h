// A Modbus device in virtual time: the emulator's register model and server in process, and libmodbus at the
// other end of an in-memory socket, so that the bytes are those of the wall-clock run, framed for TCP or for
// a serial line. The emulator's `faults` hold here too: what is late, refused or silent costs the same
// samples in each run.
//
// All sources and sinks of one device share a VirtualDevice, and with it one order of events: writes at
// exactly their t_effect, reads at exactly their t_capture; at the same instant writes come first, then reads
// in the order in which the channels were armed. A read is carried out in the first cycle after its instant
// (or in the cycle itself where its latency is zero), when every command that takes effect by then has been
// given. So the order does not depend on which channel asks first, and the model sees time that never runs
// back.
//
// Device time begins at 0, where virtual runs begin; arming happens then.
// Requests block until they are answered, so the server's thread and the loop never run at the same time.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <vector>

#include "drivers/modbus/modbus_emulator.h"
#include "drivers/modbus/modbus_link.h"
#include "drivers/modbus/modbus_server.h"
#include "sensor-hal/channel/channel.h"

namespace rigor::modbus {

class VirtualDevice {
 public:
  enum class Rank : std::uint8_t { write, read };
  /// One channel's part in the order of events. Loop thread.
  class Member {
   public:
    virtual ~Member() = default;
    /// The instant of the next event that may happen by `now`; never() when there is none.
    [[nodiscard]] virtual BenchTime next_event(BenchTime now) const noexcept = 0;
    virtual void happen() = 0;
  };
  /// A connection to the device: a server of its own over the shared model.
  struct Connection {
    std::unique_ptr<Server> server;
    Link link;
  };

  /// Framing, unit and faults are the settings'; delays and silences cost bench time and no real one.
  VirtualDevice(std::shared_ptr<RegisterModel> model, const EmulatorSettings& settings);

  /// Anew where there was a connection; `unit` is whom the master asks.
  [[nodiscard]] Status connect(Connection& connection, const Endpoint& endpoint);
  /// From a request at `t` to its answer.
  [[nodiscard]] Duration answer_delay(BenchTime t) { return faults_->delay(t); }
  void join(Member* member, Rank rank);
  void leave(const Member* member);
  /// Everything that happens by `now`, in order.
  void advance(BenchTime now);
  [[nodiscard]] BenchTime time() const noexcept { return BenchTime(time_.load(std::memory_order_acquire)); }
  /// Never backwards.
  void set_time(BenchTime t) noexcept;

 private:
  struct Entry {
    Member* member;
    Rank rank;
  };
  class LockedModel;
  std::shared_ptr<LockedModel> model_;
  Server::Options options_;
  Server::Framing framing_;
  std::shared_ptr<FaultBox> faults_;
  std::atomic<std::int64_t> time_;
  std::vector<Entry> members_;  // writers first
};

/// The stand-ins for ModbusSource and ModbusSink; they read the same keys.
[[nodiscard]] std::unique_ptr<Source> make_virtual_source(std::shared_ptr<VirtualDevice> device);
[[nodiscard]] std::unique_ptr<Sink> make_virtual_sink(std::shared_ptr<VirtualDevice> device);

}  // namespace rigor::modbus
