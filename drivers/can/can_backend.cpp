#include "drivers/can/can_backend.h"

#include <linux/can.h>
#include <sys/socket.h>

#include "drivers/can/can_emulator.h"
#include "drivers/can/can_interfaces.h"
#include "drivers/can/can_sink.h"
#include "drivers/can/can_source.h"
#include "drivers/can/can_virtual.h"
#include "drivers/can/fault_signals.h"

namespace rigor {
namespace {

std::string rates(const can::Interface& i) {
  std::string out;
  if (i.bitrate != 0) out += ", " + std::to_string(i.bitrate / 1000) + " kbit/s";
  if (i.data_bitrate != 0) out += ", data " + std::to_string(i.data_bitrate / 1000) + " kbit/s";
  return out;
}

std::vector<FoundDevice> find_devices() {
  std::vector<FoundDevice> out;
  const auto interfaces = can::list_interfaces();
  if (!interfaces) return out;
  for (const auto& i : *interfaces) {
    FoundDevice d;
    d.backend = "can";
    d.id = i.name;
    d.address = i.name;
    d.description = (i.kind.empty() ? "CAN" : i.kind) + std::string(i.up ? ", up" : ", down") + rates(i) +
                    (i.fd ? ", FD" : "") + (i.hardware_stamps ? ", hardware stamps" : "");
    if (i.state != can::BusState::unknown) d.description += std::string(", ") + can::state_name(i.state);
    out.push_back(std::move(d));
  }
  return out;
}

std::vector<DoctorFinding> doctor() {
  using Level = DoctorFinding::Level;
  if (const auto missing = can::can_missing(); !missing.empty())
    return {
        {Level::note, "this kernel has no CAN (" + missing + "); virtual time needs none",
         "sudo modprobe can-raw, or a kernel with CONFIG_CAN; without hardware also: sudo modprobe vcan"}};
  std::vector<DoctorFinding> out{{Level::good, "the kernel has CAN", ""}};
  if (const auto m = can::protocol_missing(SOCK_DGRAM, CAN_BCM); !m.empty())
    out.push_back(
        {Level::missing, "no broadcast manager (" + m + "), which sinks send with", "sudo modprobe can-bcm"});
  if (const auto m = can::protocol_missing(SOCK_DGRAM, CAN_ISOTP); !m.empty())
    out.push_back({Level::note, "no ISO-TP (" + m + ")", "sudo modprobe can-isotp"});
  const auto interfaces = can::list_interfaces();
  if (!interfaces) return out;
  if (interfaces->empty())
    out.push_back(
        {Level::note, "no CAN interface",
         "plug an adapter in; for a bus without hardware: sudo ip link add vcan0 type vcan && sudo ip link "
         "set vcan0 up"});
  for (const auto& i : *interfaces) {
    if (!i.up)
      out.push_back({Level::missing, i.name + " is down",
                     "sudo ip link set " + i.name +
                         (i.kind == "can" ? " up type can bitrate 500000 restart-ms 100 (the bus's own rate)"
                                          : " up")});
    if (i.state == can::BusState::bus_off)
      out.push_back({Level::missing, i.name + " is bus-off: check wiring, termination and bit rate",
                     "sudo ip link set " + i.name + " type can restart"});
    if (i.up && i.hardware_stamps)
      out.push_back({Level::good, i.name + " stamps frames by its own clock", ""});
    else if (i.up)
      out.push_back({Level::good, i.name + " has no hardware stamps: frames are stamped by the kernel", ""});
    if (i.up && i.kind == "can" && i.restart_ms == 0)
      out.push_back({Level::note, i.name + " stays off after bus-off, until it is restarted by hand",
                     "sudo ip link set " + i.name + " down && sudo ip link set " + i.name +
                         " up type can restart-ms 100, or `restart_ms` of the channel"});
  }
  return out;
}

}  // namespace

Backend can_backend() {
  Backend b;
  b.name = "can";
  b.summary = "SocketCAN: frames, signals by DBC, cyclic commands, emulated nodes";
  b.make_source = [] { return std::make_unique<can::CanSource>(); };
  b.make_sink = [] { return std::make_unique<can::CanSink>(); };
  b.make_emulator = [] { return std::make_unique<can::CanEmulator>(); };
  const auto buses = std::make_shared<can::VirtualBuses>();
  b.make_virtual_source = [buses](const DeviceParts& parts,
                                  const ConfigNode& params) -> Result<std::unique_ptr<Source>> {
    return buses->node(parts, params).map([](auto node) {
      return can::make_virtual_source(std::move(node));
    });
  };
  b.make_virtual_sink = [buses](const DeviceParts& parts,
                                const ConfigNode& params) -> Result<std::unique_ptr<Sink>> {
    return buses->node(parts, params).map([](auto node) { return can::make_virtual_sink(std::move(node)); });
  };
  b.files = [](const ConfigNode& params) {
    std::vector<std::filesystem::path> logs;
    if (params.has("log")) logs.emplace_back(params.text("log"));
    return logs;
  };
  b.find_signal = find_dbc_signal;
  b.find_devices = find_devices;
  b.doctor = doctor;
  return b;
}

}  // namespace rigor
