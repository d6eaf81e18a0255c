// Which GigE Vision cameras there are, asked with plain GVCP datagrams: quicker than a full open, bounded in
// time, with the user's names, and over loopback too.
//
//   for (auto& c : find_gige_cameras({.wait = milliseconds(250)})) print(c.id(), c.address_text());
//   if (ask_gige_camera("192.168.1.20", milliseconds(100))) …   // is it alive?
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "drivers/aravis/gvcp_codec.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::gige {

struct FoundCamera {
  DiscoveryAck identity;
  std::string address;          ///< that it answered from
  std::string local_address;    ///< of this machine, on the interface that leads to it
  std::string local_interface;  ///< "eth0"
  [[nodiscard]] std::string id() const { return identity.manufacturer + "-" + identity.serial; }
  [[nodiscard]] std::string mac() const;
  /// True where `selector` is its id, serial, user name, MAC or address.
  [[nodiscard]] bool answers_to(const std::string& selector) const;
};

struct DiscoveryOptions {
  std::string interface;  ///< local IPv4 address or interface name; empty: all that are up
  Duration wait = milliseconds(250);
  std::function<bool()> cancelled;  ///< looked at every 50 ms
};

/// Broadcasts on each interface and collects answers for `wait`. bad_input where the interface that is named
/// does not exist. Blocks; setup or I/O thread.
[[nodiscard]] Result<std::vector<FoundCamera>> find_gige_cameras(const DiscoveryOptions& options);

/// Asks one address; empty when no answer came within `wait`. Blocks; setup or I/O thread.
[[nodiscard]] std::optional<FoundCamera> ask_gige_camera(const std::string& address, Duration wait);

}  // namespace rigor::gige
