// A rig's `emulators:` entry of this driver as a camera: what it calls itself, and where its pictures come
// from. The emulator on the network and the stand-in in virtual time are made from the same lines, so they
// are the same camera.
//
//   emulators:
//     left:
//       backend: aravis
//       address: 127.0.0.1
//       vendor: Rigor
//       serial: left             # the camera's id is then Rigor-left
//       rate_hz: 25
//       trigger_line: { rate_hz: 25, phase_us: 500 }   # what is wired to Line1: pulses on the bench's clock
//       ptp: { settle_s: 2, offset_ns: 200 }           # has a clock that follows a PTP master
//       as: gige                 # or usb3vision: a USB device that a host imports by USB/IP from `address`,
//       port: 3240               # `port`, as `bus_id`; `start_ms` is what AcquisitionStart takes, and
//       bus_id: 1-1              # `response_ms` how long a host is to wait for an answer
//       range_scale_mm: 0.25     # of a 3D camera, whose `sensor` is a time-of-flight camera's: mm for a
//       count amplitude_scale: 1
#pragma once

#include <optional>
#include <string>

#include "drivers/aravis/gige_device_model.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor {

struct EmulatedCameraSettings {
  std::string address, vendor, model, serial, user_name;
  double rate_hz = 25;
  Duration readout;
  bool align_to_clock = true;
  double link_bits_per_s = 1e9;
  Period line_period;  ///< of what is wired to Line1; 0: nothing
  Duration line_phase;
  gige::GigeCameraConfig::Ptp ptp;
  double range_scale_mm = 0.25, amplitude_scale = 1;  ///< of a count of a 3D camera
  bool usb3vision = false;
  std::uint16_t port = 3240;  ///< of USB/IP; 0: any
  std::string bus_id = "1-1";
  Duration start_delay, response = seconds(1);
};

/// Throws ConfigError. `name`: of the entry, the default serial number.
[[nodiscard]] EmulatedCameraSettings read_emulated_camera(const ConfigNode& params, const std::string& name,
                                                          const Period& period);

/// What the parts' sensor gives: a picture, or range and amplitude. Nothing where there is neither.
struct EmulatedSensor {
  ImageProvider::Geometry geometry;
  bool range = false;
};
[[nodiscard]] std::optional<EmulatedSensor> sensor_of(const DeviceParts& parts);

/// A camera whose sensor is the provider's; it offers every format, the provider's default first. A 3D camera
/// has one.
[[nodiscard]] gige::GigeCameraConfig camera_config(const EmulatedCameraSettings& settings,
                                                   const EmulatedSensor& sensor);

/// Pictures for the camera. `device_zero`: bench time where the emulated camera's clock is 0.
[[nodiscard]] gige::FillFrame picture_of(const DeviceParts& parts, const EmulatedCameraSettings& settings,
                                         BenchTime device_zero);

[[nodiscard]] gige::PixelFormat to_gige(PixelFormat f);
/// False for a format that samples do not have.
[[nodiscard]] bool from_gige(gige::PixelFormat from, PixelFormat& to);

}  // namespace rigor
