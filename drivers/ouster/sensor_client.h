// A client of a sensor's configuration: its metadata, and parameters that are to be active. HTTP, and where
// it has no metadata (firmware before 2.1) the commands of TCP 7501.
#pragma once

#include <string>

#include "drivers/ouster/sensor_metadata.h"

namespace rigor::ouster {

struct SensorAddress {
  std::string host;
  std::uint16_t http_port = 80, tcp_port = 7501;  ///< 0: there is none
  int cut_fd = -1;                                ///< readable when everything is to end
};

/// not_found: nobody there; timeout; protocol or bad_input: what it answers is no metadata. I/O or setup
/// thread.
[[nodiscard]] Result<Metadata> fetch_metadata(const SensorAddress& sensor, MonotonicTime limit);

/// The same once it says RUNNING; unavailable where it does not until `limit`, or is in STANDBY.
[[nodiscard]] Result<Metadata> wait_for_metadata(const SensorAddress& sensor, MonotonicTime limit);

/// Makes parameters (a map as JSON) active where the sensor has other values; `udp_dest` may be "auto": the
/// address that this machine has for the sensor. bad_input: the sensor refuses one. Whether it starts up
/// anew.
[[nodiscard]] Result<bool> configure_sensor(const SensorAddress& sensor, const std::string& parameters,
                                            MonotonicTime limit);

}  // namespace rigor::ouster
