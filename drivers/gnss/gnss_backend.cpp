#include "drivers/gnss/gnss_backend.h"

#include <filesystem>

#include "drivers/gnss/gnss_emulator.h"
#include "drivers/gnss/gnss_source.h"
#include "drivers/gnss/gnss_virtual_source.h"

namespace rigor {
namespace {

/// Pulse inputs of the kernel; receivers themselves are serial ports (`serial`).
std::vector<FoundDevice> find_pulses() {
  std::vector<FoundDevice> found;
  std::error_code none;
  for (const auto& e : std::filesystem::directory_iterator("/sys/class/pps", none)) {
    const std::string name = e.path().filename();
    found.push_back({"gnss", name, "time pulse, for the key pps", "/dev/" + name});
  }
  return found;
}

std::vector<DoctorFinding> doctor() {
  using Level = DoctorFinding::Level;
  std::error_code none;
  std::vector<DoctorFinding> out;
  out.push_back({Level::good, "satellite receivers need a serial port (see serial) or TCP alone", ""});
  if (!std::filesystem::exists("/sys/class/pps", none))
    out.push_back({Level::note,
                   "no time pulse of a receiver is connected: its stamps are those of messages, good to "
                   "milliseconds",
                   "a pulse on the DCD line of a serial port: sudo modprobe pps_ldisc && sudo ldattach PPS "
                   "/dev/ttyS0"});
  return out;
}

}  // namespace

Backend gnss_backend() {
  Backend b;
  b.name = "gnss";
  b.summary =
      "satellite receivers: NMEA 0183 and UBX over serial lines and TCP, their recordings, and an emulated "
      "one";
  b.make_source = [] { return std::make_unique<gnss::GnssSource>(); };
  b.make_emulator = [] { return std::make_unique<gnss::GnssEmulator>(); };
  b.make_virtual_source = [](DeviceParts parts, ConfigNode params) -> Result<std::unique_ptr<Source>> {
    return std::make_unique<gnss::GnssVirtualSource>(std::move(parts), std::move(params));
  };
  b.reads_recording = [](const ConfigNode& params) { return params.has("file"); };
  b.gives_typed_samples = true;
  b.files = [](const ConfigNode& params) {
    std::vector<std::filesystem::path> files;
    if (const std::string log = params.text_or("log", ""); !log.empty()) files.emplace_back(log);
    return files;
  };
  b.find_devices = find_pulses;
  b.doctor = doctor;
  return b;
}

}  // namespace rigor
