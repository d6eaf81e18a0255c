#include "drivers/usb/emulated_scanner.h"

#include <algorithm>

namespace rigor::usb {

EmulatedScannerSettings read_emulated_scanner(const ConfigNode& n) {
  EmulatedScannerSettings s;
  s.model = *find_scanner_model(n.choice_or("model", {"urg-04lx", "utm-30lx"}, "urg-04lx"));
  s.model.identity.serial = n.text_or("serial", s.model.identity.serial);
  if (s.model.identity.serial.empty() || s.model.identity.serial.size() > 32 ||
      s.model.identity.serial.find_first_of(";\n\r") != std::string::npos)
    throw n.error("serial", "expected 1 … 32 characters without semicolon");
  s.options.clock_ppm = n.number_or("clock_ppm", 0, {.min = -10000, .max = 10000});
  s.options.clock_start_ms = static_cast<std::uint32_t>(
      n.integer_or("clock_start_ms", 0, {.min = 0, .max = kScipClockModulus - 1.0}));
  return s;
}

WorldScans::WorldScans(DeviceParts parts, const ScannerModel& model, BenchTime power_on,
                       std::uint64_t first_scan)
    : parts_(std::move(parts)), model_(model), power_on_(power_on), first_scan_(first_scan) {
  sample_.reserve(
      std::max<std::size_t>(parts_.samples ? parts_.samples->geometry().max_bytes : 0, sizeof(LidarPoint)));
}

void WorldScans::remember_motion(DeviceTime t_first) {
  if (!parts_.motion) return;
  if (motions_.size() > 64) motions_.pop_front();
  motions_.emplace_back(t_first, parts_.motion->motion_at(power_on_ + Duration(t_first.ns())));
}

bool WorldScans::measure(std::uint64_t scan, DeviceTime t_first, std::span<std::uint32_t> range_mm,
                         std::span<std::uint32_t> intensity) {
  if (!parts_.samples) return false;
  SampleProvider::Request request;
  request.index = scan - first_scan_;
  request.t_capture = power_on_ + Duration(t_first.ns());
  while (!motions_.empty() && motions_.front().first < t_first) motions_.pop_front();
  if (!motions_.empty() && motions_.front().first == t_first)
    request.motion = motions_.front().second;
  else if (parts_.motion)
    request.motion = parts_.motion->motion_at(request.t_capture);
  if (!parts_.samples->capture(request, sample_)) return false;
  const auto* cloud = sample_.as<PointCloudInfo>();
  if (!cloud || cloud->count * sizeof(LidarPoint) > sample_.bytes().size()) return false;
  measure_points({reinterpret_cast<const LidarPoint*>(sample_.bytes().data()), cloud->count}, model_,
                 range_mm, intensity);
  return true;
}

}  // namespace rigor::usb
