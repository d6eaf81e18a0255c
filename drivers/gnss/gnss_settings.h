// The keys of `backend: gnss`: of channels, and of the emulators that stand for receivers.
//
//   kind: nav_fix                 # or registers (all of the solution), point_cloud (satellites in view)
//   device: /dev/ttyACM0          # a serial line; or address and port of a server; or file, a recording
//   baud: 38400                   # or auto; parity, data_bits, stop_bits, rs485: drivers/serial
//   address: 192.168.1.20
//   port: 2947
//   file: drive.ubx               # UBX and NMEA as the receiver sent it, against the rig's folder
//   configure:                    # left away: the receiver is taken as it is
//     generation: auto            # 8 (CFG-PRT, CFG-MSG, CFG-RATE), 9 (CFG-VALSET); auto: by MON-VER
//     interface: uart1            # of the receiver, by which it is connected: uart1, uart2, usb
//     messages: [pvt, cov, dop, timegps, sat, eoe]   # those that it is to send: also hpposllh, tim_tp, rawx,
//     or
//                                               # gga, gll, gsa, gsv, rmc, vtg, gst, zda
//     baud: 230400                # the line changes to it
//   corrections:                  # RTCM 3 that is passed on to the receiver
//     address: 127.0.0.1          # a server of it (an NTRIP client, a base station); or device and baud
//     port: 2101
//   time: device                  # utc, arrival: receiver_stream.h
//   pps: /dev/pps0                # the receiver's time pulse as the kernel sees it; needs tim_tp
//   output_delay_ms: 30
//   output_delay_sigma_ms: 10
//   range_error_m: 5              # where the receiver tells its dilution of precision alone
//   silence_s: 3                  # without a message the receiver is gone
//   ready_s: 5                    # for the first message, and each answer
//   log: raw.ubx                  # what comes is written as well, against the working directory
//   buffers: 16
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "drivers/gnss/receiver_stream.h"
#include "drivers/serial/byte_link.h"
#include "sensor-hal/channel/channel.h"

namespace rigor::gnss {

/// A message that can be switched on, in both generations.
struct OutputMessage {
  const char* name;
  UbxId id;           ///< of NMEA: class 0xF0
  std::uint32_t key;  ///< config_key, of I2C
  bool nmea;
};
[[nodiscard]] std::span<const OutputMessage> output_messages();

enum class Interface : std::uint8_t { uart1 = 1, uart2 = 2, usb = 3 };

struct ConfigureSettings {
  unsigned generation = 0;  ///< 8, 9; 0: asked
  Interface interface = Interface::uart1;
  std::vector<std::string> messages;
  unsigned baud = 0;  ///< 0: as it is
  friend bool operator==(const ConfigureSettings&, const ConfigureSettings&) = default;
};

/// A serial line or a server.
struct LineSettings {
  std::optional<serial::SerialSettings> serial;  ///< baud 0: to be found out
  std::string address;
  std::uint16_t port = 0;
  [[nodiscard]] std::string text() const;
  [[nodiscard]] std::unique_ptr<serial::ByteLink> make(const std::string& device,
                                                       const std::string& advice) const;
  friend bool operator==(const LineSettings&, const LineSettings&) = default;
};

/// What channels of one receiver share; they have to say the same.
struct ReceiverSettings {
  LineSettings line;
  std::optional<ConfigureSettings> configure;
  std::optional<LineSettings> corrections;
  TimeSource time = TimeSource::device;
  std::string pps;
  Duration period;
  Duration output_delay = milliseconds(30), output_delay_sigma = milliseconds(10);
  Duration silence = seconds(3), ready = seconds(5);
  double range_error_m = 5;
  std::string log;
  friend bool operator==(const ReceiverSettings&, const ReceiverSettings&) = default;
};

struct ChannelSettings {
  ReceiverSettings receiver;
  std::filesystem::path file;
  std::string frame_id;
  std::size_t buffers = 16;
};
/// Throws ConfigError. `needs_line`: not in virtual time. Setup.
[[nodiscard]] ChannelSettings read_channel_settings(const ChannelConfig& config, bool needs_line);

/// Keys of an emulator beside `sensor` and what belongs to it:
///   as: pty                  # tcp
///   link: /tmp/gnss          # a name of the pseudo-terminal that stays
///   address: 127.0.0.1
///   port: 2947               # 0 takes a free one
///   rate_hz: 10
///   generation: 9            # 8
///   speaks: ubx              # nmea, both: until a client configures it
///   messages: [pvt, …]       # in place of what `speaks` means
///   high_precision: false    # more digits in NMEA
///   baud: 38400              # a client at a pseudo-terminal with another speed gets garbage
///   processing_ms: 20        # from an instant to its messages
///   geoid_separation_m: 0
///   velocity_sigma_mps: 0.03
///   leap_seconds: 18
///   week_rollovers: 0        # its dates are so many times 1024 weeks behind, as of old firmware
///   corrections_timeout_s: 0 # so long after the last RTCM message it falls back to a fix without; 0: never
struct EmulatorSettings {
  enum class As : std::uint8_t { pty, tcp } as = As::pty;
  std::string link, address = "127.0.0.1";
  std::uint16_t port = 2947;
  Period period = milliseconds(100);
  unsigned generation = 9;
  std::vector<std::string> messages;
  bool high_precision = false;
  unsigned baud = 38400;
  Duration processing = milliseconds(20);
  double geoid_separation_m = 0, velocity_sigma_mps = 0.03;
  int leap_seconds = 18;
  std::int64_t week_rollovers = 0;
  Duration corrections_timeout;
};
/// Throws ConfigError. Setup.
[[nodiscard]] EmulatorSettings read_emulator_settings(const ConfigNode& params);

}  // namespace rigor::gnss
