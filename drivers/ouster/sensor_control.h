// What an emulated sensor answers to its clients, without a socket: metadata, and a configuration that is
// staged, and active after `reinitialize`, over HTTP (firmware 2.1 and later) and the older commands over TCP
// 7501.
//
//   GET  /api/v1/sensor/metadata[/sensor_info, /beam_intrinsics, …]
//   GET, POST /api/v1/sensor/config                    POST: a map of parameters, active at once
//   GET  /api/v1/sensor/cmd/NAME?args=…                 set_config_param, get_config_param, reinitialize, …
//   GET  /api/v1/system/firmware
//   TCP  one command a line: "get_config_param active", "set_config_param udp_dest 10.0.0.1", …
//
// What the parameters are together is judged when they are to become active: phase lock needs a time from
// outside, and pulses on the multipurpose IO end before the next one begins. A configuration that is refused
// leaves the active one as it is.
//
// States: INITIALIZING after start and `reinitialize`, for the start-up time; then RUNNING, or STANDBY where
// operating_mode says so. Sources: Ouster's Firmware User Manual (3.1, "HTTP API Reference", "TCP API
// Guide"), ouster-sdk (sensor_http_imp.cpp, sensor_tcp_imp.cpp).
//
// One thread at a time.
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "drivers/ouster/sensor_device.h"
#include "drivers/ouster/sensor_time.h"

namespace rigor::ouster {

class SensorControl {
 public:
  struct Identity {
    std::string product_line = "OS-1-128", serial = "992000000001", firmware = "v3.1.0";
    Duration start_up;
  };
  struct Reply {
    int status = 200;
    std::string body;
  };
  /// What the sensor does by its active configuration.
  struct Active {
    Metadata metadata;
    std::string udp_dest;
    SensorTime time;
    bool standby = false;
    std::uint64_t generation = 0;  ///< grows with each reinitialization
    MonotonicTime ready;           ///< when it has started up
  };

  /// `config`: parameters that differ from the factory's, as JSON text. bad_input: one that is unknown or out
  /// of its bounds. `device` has to live as long.
  [[nodiscard]] static Result<SensorControl> create(const SensorDevice& device, Identity identity,
                                                    std::string_view config, MonotonicTime now);
  SensorControl(SensorControl&&) noexcept;
  SensorControl& operator=(SensorControl&&) noexcept;
  ~SensorControl();

  /// `client`: its address, for set_udp_dest_auto.
  [[nodiscard]] Reply http(std::string_view method, std::string_view target, std::string_view body,
                           std::string_view client, MonotonicTime now);
  /// Without the line break.
  [[nodiscard]] std::string tcp(std::string_view line, std::string_view client, MonotonicTime now);
  [[nodiscard]] const Active& active() const;

 private:
  struct Impl;
  explicit SensorControl(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::ouster
