// The keys of a channel behind `backend: usb`.
//
//   protocol: scip            scip: a Hokuyo scanner; bulk: frames as `frame` describes them (bulk_frame.h)
//   transport: usb            usb, tty, tcp
//     usb   vendor: 0x15d1, product: 0x0000, serial (any), usb_path: "1-2.3" (bus and ports; any)
//     tty   device: /dev/ttyACM0, baud: 115200
//     tcp   address, port: 10940
//   of scip:
//     serial                  also what VV has to say
//     start_step, end_step    default: the detection range
//     cluster: 1              steps merged into their smallest range (1 … 99)
//     skip: 0                 scans left out between two (0 … 9)
//     intensity: false        remission by ME, where the scanner has it
//     characters: 3           of a range on the wire; 2 hold 4095 mm
//     clock_every_s: 1        how often the scanner is asked for its clock while it measures; 0: never
//   of bulk with usb:
//     interface: 0, endpoint: 0x81
//   slots: 16                 samples pending, held by the application and by the recorder
#pragma once

#include <functional>
#include <optional>

#include "drivers/serial/byte_link.h"
#include "drivers/usb/scip_client.h"
#include "sensor-hal/channel/channel.h"

namespace rigor::usb {

using serial::ByteLink;

enum class Transport : std::uint8_t { usb, tty, tcp };

struct UsbAddress {
  std::uint16_t vendor = 0x15d1, product = 0x0000;
  std::string serial, path;
  /// -1: by class, as a CDC-ACM device.
  int interface = -1;
  std::uint8_t endpoint = 0;
};

struct LinkSettings {
  Transport transport = Transport::usb;
  UsbAddress usb;
  std::string device;
  unsigned baud = 115200;
  std::string address;
  std::uint16_t port = 10940;

  [[nodiscard]] serial::SerialSettings serial_line() const {
    serial::SerialSettings s;
    s.device = device;
    s.baud = baud;
    return s;
  }
};

struct ScipSettings {
  LinkSettings link;
  std::string serial;
  ScipClient::Options client;
  std::size_t slots = 16;
};

/// Throw ConfigError. Keys that were not asked for are the caller's to refuse.
[[nodiscard]] LinkSettings read_link_settings(const ConfigNode& n, bool bulk);
[[nodiscard]] ScipSettings read_scip_settings(const ChannelConfig& config);
/// Most points of one scan that these settings can give.
[[nodiscard]] std::size_t most_points(const ScanSettings& scan);

/// Makes the link that a channel's settings name.
using LinkFactory = std::function<std::unique_ptr<ByteLink>(const LinkSettings&)>;
/// tty and tcp; usb gives null.
[[nodiscard]] std::unique_ptr<ByteLink> make_plain_link(const LinkSettings& settings);

}  // namespace rigor::usb
