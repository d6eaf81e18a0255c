// The machine's CAN interfaces, by rtnetlink: what they are, and what a bench asks of them.
//
// Source: linux/if_link.h, linux/can/netlink.h; the attributes are those that `ip -details link show` prints.
// Setup context; each call opens a socket of its own. Changes need CAP_NET_ADMIN.
#pragma once

#include <string>
#include <vector>

#include "drivers/can/error_frame.h"
#include "rt-core/result.h"

namespace rigor::can {

struct Interface {
  std::string name;
  std::string kind;  ///< can, vcan, vxcan, slcan; empty: the kernel does not say
  bool up = false;
  bool fd = false;                              ///< its MTU takes CAN FD frames
  std::uint32_t bitrate = 0, data_bitrate = 0;  ///< 0: not known (virtual ones have none)
  std::uint32_t restart_ms = 0;                 ///< the kernel's own restart after bus-off; 0: by hand
  BusState state = BusState::unknown;
  bool hardware_stamps = false;  ///< it stamps the frames that it receives by its own clock (`ethtool -T`)
};

/// All interfaces whose link layer is CAN. unavailable, io.
[[nodiscard]] Result<std::vector<Interface>> list_interfaces();
/// not_found with what to do.
[[nodiscard]] Result<Interface> find_interface(const std::string& name);
/// Empty where the kernel has PF_CAN; else what the kernel says.
[[nodiscard]] std::string can_missing();
/// Why a socket of a protocol (CAN_BCM, CAN_ISOTP) cannot be had; empty: it can.
[[nodiscard]] std::string protocol_missing(int type, int protocol);

[[nodiscard]] Status create_vcan(const std::string& name);
[[nodiscard]] Status remove_interface(const std::string& name);
[[nodiscard]] Status set_up(const std::string& name, bool up);
/// A controller that is bus-off takes part again; `ip link set NAME type can restart`.
[[nodiscard]] Status restart_controller(const std::string& name);

}  // namespace rigor::can
