// A range finder that sends a line of text in a UDP datagram for each measurement: "17 2.345\n" is its 17th,
// of 2.345 m. A driver from outside Rigor: a source, a stand-in for virtual time, and an emulator of the
// device.
//
//   channels: { range: { kind: registers, backend: text-sensor, port: 20777, rate_hz: 50, latency_ms: 5 } }
//   emulators: { range: { backend: text-sensor, port: 20777, rate_hz: 50 } }
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <string_view>
#include <thread>

#include "rt-core/deadline.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/channel/run_origin.h"
#include "sensor-hal/channel/stream_source.h"

namespace text_sensor {

/// What the emulated device measures at an instant.
[[nodiscard]] double range_at(rigor::BenchTime t);

/// What both sources make of a line.
class TextSource : public rigor::StreamSource {
 protected:
  rigor::Status do_configure(const rigor::ChannelConfig& config) override;
  /// False: the text is not a measurement. Producer thread.
  bool take_line(std::string_view line, rigor::BenchTime t_capture, rigor::BenchTime t_arrival);

  std::uint16_t port_ = 0;
  std::int64_t last_ = -1;       ///< number of the last measurement
  rigor::RunOrigin origin_;      ///< when the run begins
  rigor::RunSequence sequence_;  ///< the device counts since it was switched on, the run from 0
};

/// The device on the network, in wall-clock time.
class NetworkSource final : public TextSource {
 public:
  ~NetworkSource() override;

 private:
  rigor::Status do_arm(const rigor::ArmContext& context) override;
  rigor::Status do_start(rigor::BenchTime t0) override;
  rigor::Status do_stop() override;
  void receive();

  int socket_ = -1, stop_ = -1;
  std::thread thread_;
};

/// The same without a network, in virtual time.
class VirtualSource final : public TextSource {
 public:
  void complete_until(rigor::BenchTime now) override;

 private:
  rigor::Status do_arm(const rigor::ArmContext& context) override;
  rigor::Status do_start(rigor::BenchTime t0) override;
  rigor::Status do_stop() override;

  std::int64_t next_ = 0;
};

/// The device.
class TextEmulator final : public rigor::Emulator {
 public:
  ~TextEmulator() override;
  void attach(rigor::DeviceParts) override {}  // it shows nothing of the world
  [[nodiscard]] std::string endpoint() const override;

 private:
  rigor::Status do_configure(const rigor::ChannelConfig& config) override;
  rigor::Status do_arm(const rigor::ArmContext& context) override;
  rigor::Status do_start(rigor::BenchTime t0) override;
  rigor::Status do_stop() override;
  void send();

  std::uint16_t port_ = 0;
  rigor::Period period_;
  int socket_ = -1;
  rigor::Deadline deadline_;
  std::thread thread_;
};

[[nodiscard]] rigor::Backend backend();

}  // namespace text_sensor
