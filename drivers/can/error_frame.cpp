#include "drivers/can/error_frame.h"

#include <linux/can/error.h>

namespace rigor::can {

const char* state_name(BusState state) noexcept {
  switch (state) {
    case BusState::unknown:
      return "unknown";
    case BusState::error_active:
      return "error-active";
    case BusState::error_warning:
      return "error-warning";
    case BusState::error_passive:
      return "error-passive";
    case BusState::bus_off:
      return "bus-off";
    case BusState::stopped:
      return "stopped";
  }
  return "?";
}

BusErrors read_error(const CanFrame& f) noexcept {
  BusErrors e;
  if (!f.error) return e;
  e.bus_off = (f.id & CAN_ERR_BUSOFF) != 0;
  e.restarted = (f.id & CAN_ERR_RESTARTED) != 0;
  e.tx_timeout = (f.id & CAN_ERR_TX_TIMEOUT) != 0;
  e.lost_arbitration = (f.id & CAN_ERR_LOSTARB) != 0;
  e.no_acknowledge = (f.id & CAN_ERR_ACK) != 0;
  e.bus_error = (f.id & CAN_ERR_BUSERROR) != 0;
  e.protocol = (f.id & CAN_ERR_PROT) != 0;
  e.transceiver = (f.id & CAN_ERR_TRX) != 0;
  e.controller = (f.id & CAN_ERR_CRTL) != 0;
  if (e.controller) {
    e.rx_overflow = (f.data[1] & CAN_ERR_CRTL_RX_OVERFLOW) != 0;
    e.tx_overflow = (f.data[1] & CAN_ERR_CRTL_TX_OVERFLOW) != 0;
  }
  e.tx_count = f.data[6];
  e.rx_count = f.data[7];
  return e;
}

BusState state_after(const CanFrame& f, BusState before) noexcept {
  if (!f.error) return before;
  if ((f.id & CAN_ERR_BUSOFF) != 0) return BusState::bus_off;
  if ((f.id & CAN_ERR_RESTARTED) != 0) return BusState::error_active;
  if ((f.id & CAN_ERR_CRTL) != 0) {
    if ((f.data[1] & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0)
      return BusState::error_passive;
    if ((f.data[1] & (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)) != 0)
      return BusState::error_warning;
    if ((f.data[1] & CAN_ERR_CRTL_ACTIVE) != 0) return BusState::error_active;
  }
  if ((f.id & CAN_ERR_PROT) != 0 && (f.data[2] & CAN_ERR_PROT_ACTIVE) != 0) return BusState::error_active;
  return before;
}

std::string describe_error(const CanFrame& f) {
  if (!f.error) return {};
  const BusErrors e = read_error(f);
  std::string out;
  const auto add = [&](bool is, const char* text) {
    if (is) out += (out.empty() ? "" : "; ") + std::string(text);
  };
  add(e.bus_off, "bus-off");
  add(e.restarted, "restarted after bus-off");
  add(e.tx_timeout, "transmission timed out");
  add(e.lost_arbitration, "lost arbitration");
  add(e.no_acknowledge, "nobody acknowledged");
  add(e.bus_error, "bus error");
  add(e.protocol, "protocol violation");
  add(e.transceiver, "transceiver");
  if (e.controller) {
    add(e.rx_overflow, "controller lost received frames");
    add(e.tx_overflow, "controller lost frames to be sent");
    add((f.data[1] & (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)) != 0, "error warning");
    add((f.data[1] & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0, "error passive");
    add((f.data[1] & CAN_ERR_CRTL_ACTIVE) != 0, "error active");
  }
  if (e.tx_count != 0 || e.rx_count != 0)
    add(true,
        ("error counters tx " + std::to_string(e.tx_count) + " rx " + std::to_string(e.rx_count)).c_str());
  return out.empty() ? "unspecified" : out;
}

}  // namespace rigor::can
