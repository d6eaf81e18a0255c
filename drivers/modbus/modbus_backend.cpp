#include "drivers/modbus/modbus_backend.h"

#include <modbus/modbus.h>

#include <algorithm>
#include <fstream>
#include <map>

#include "drivers/modbus/modbus_emulator.h"
#include "drivers/modbus/modbus_sink.h"
#include "drivers/modbus/modbus_source.h"
#include "drivers/modbus/virtual_device.h"

namespace rigor {
namespace {

using modbus::VirtualDevice;

/// The devices of virtual time, by their models or, of plain registers, by their place in the rig; a device
/// lives as long as a channel of it does.
class VirtualDevices {
 public:
  [[nodiscard]] Result<std::shared_ptr<VirtualDevice>> of(const DeviceParts& parts,
                                                          const ConfigNode& params) {
    auto settings = catch_config([&] { return modbus::EmulatorSettings::parse(params); });
    if (!settings) return tl::unexpected<Error>(settings.error());
    const auto model = parts.registers ? parts.registers : settings->registers;
    if (!model)
      return fail(
          ErrorCode::bad_input, params.place(),
          "expected an emulator with registers (`model: turntable`, or a list `registers`), got none");
    std::erase_if(devices_, [](const auto& entry) { return entry.second.expired(); });
    auto& known = devices_[{parts.registers.get(), parts.registers ? "" : params.place()}];
    auto device = known.lock();
    if (!device) known = device = std::make_shared<VirtualDevice>(model, *settings);
    return device;
  }

 private:
  std::map<std::pair<const RegisterModel*, std::string>, std::weak_ptr<VirtualDevice>> devices_;
};

std::vector<DoctorFinding> doctor() {
  using Level = DoctorFinding::Level;
  std::vector<DoctorFinding> out;
  const unsigned major = libmodbus_version_major, minor = libmodbus_version_minor,
                 micro = libmodbus_version_micro;
  out.push_back(
      {Level::good,
       "libmodbus " + std::to_string(major) + "." + std::to_string(minor) + "." + std::to_string(micro), ""});
  int first_free = 1024;
  std::ifstream("/proc/sys/net/ipv4/ip_unprivileged_port_start") >> first_free;
  if (first_free > 502)
    out.push_back({Level::note,
                   "port 502, Modbus' own, is for programs with CAP_NET_BIND_SERVICE; only emulators need it",
                   "give the emulator a `port` of " + std::to_string(first_free) +
                       " or more, or: sudo sysctl net.ipv4.ip_unprivileged_port_start=502"});
  return out;
}

}  // namespace

Backend modbus_backend() {
  Backend b;
  b.name = "modbus";
  b.summary = "Modbus TCP and RTU: typed registers as source, sink and emulated device (libmodbus)";
  b.make_source = [] { return std::make_unique<modbus::ModbusSource>(); };
  b.make_sink = [] { return std::make_unique<modbus::ModbusSink>(); };
  b.make_emulator = [] { return std::make_unique<modbus::ModbusEmulator>(); };
  const auto devices = std::make_shared<VirtualDevices>();
  b.make_virtual_source = [devices](const DeviceParts& parts,
                                    const ConfigNode& params) -> Result<std::unique_ptr<Source>> {
    return devices->of(parts, params).map([](auto device) {
      return modbus::make_virtual_source(std::move(device));
    });
  };
  b.make_virtual_sink = [devices](const DeviceParts& parts,
                                  const ConfigNode& params) -> Result<std::unique_ptr<Sink>> {
    return devices->of(parts, params).map([](auto device) {
      return modbus::make_virtual_sink(std::move(device));
    });
  };
  // Modbus has no discovery, and knocking at every address of a network or a line is not what a bench may do
  // unasked. Serial ports are listed by drivers/serial.
  b.find_devices = [] { return std::vector<FoundDevice>{}; };
  b.doctor = doctor;
  return b;
}

}  // namespace rigor
