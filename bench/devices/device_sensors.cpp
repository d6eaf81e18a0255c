#include "bench/devices/device_sensors.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "sensor-hal/channel/typed_values.h"
#include "sensor-hal/config/rate.h"

namespace rigor {
namespace {

constexpr std::size_t kRegistersOfAValue = 4;

SampleKind read_kind(const ConfigNode& n) {
  const std::string word = n.choice("kind", {"imu", "nav_fix", "odometry"});
  return word == "imu" ? SampleKind::imu : word == "nav_fix" ? SampleKind::nav_fix : SampleKind::odometry;
}

}  // namespace

Result<std::shared_ptr<DeviceSensors>> DeviceSensors::make(const ConfigNode& params, const std::string& name,
                                                           std::shared_ptr<const MotionSource> motion,
                                                           const InertialMaker& make_sensor) {
  return catch_config([&] {
    for (const char* other : {"platform", "model", "signals", "registers"})
      if (params.has(other))
        throw params.error(other, std::string("expected either `sensors` or `") + other +
                                      "`, got both; give the sensors an emulator of their own");
    auto device = std::make_shared<DeviceSensors>();
    device->motion_ = std::move(motion);
    const ConfigNode map = params.map("sensors");
    for (const std::string& sensor : map.keys()) {
      const ConfigNode n = map.map(sensor);
      const SampleKind kind = read_kind(n);
      Sensor s;
      s.period = read_rate(n, "rate_hz", {.min = 1e-3, .max = 1e5});
      auto provider = make_sensor(kind, n, name + "." + sensor, s.period);
      if (!provider) throw ConfigError(provider.error());
      n.finish();
      s.provider = std::move(*provider);
      s.first = device->signals_.size();
      for (const ValueName& v : values_of_kind(kind)) {
        for (const Signal& known : device->signals_)
          if (known.name == v.name)
            throw map.error(
                sensor, fmt::format("expected sensors of different kinds on one device, got a second `{}`; "
                                    "give it an emulator of its own",
                                    v.name));
        device->signals_.push_back({v.name, v.unit, false});
        device->sensor_of_.push_back(device->sensors_.size());
      }
      s.count = device->signals_.size() - s.first;
      s.values.assign(s.count, std::numeric_limits<double>::quiet_NaN());
      device->sensors_.push_back(std::move(s));
    }
    if (device->sensors_.empty()) throw params.error("sensors", "expected at least one sensor, got none");
    return device;
  });
}

double DeviceSensors::value(std::size_t signal, BenchTime t) {
  Sensor& s = sensors_[sensor_of_[signal]];
  if (!s.begun) s.t_start = t;
  if (!s.begun || t > s.t) {
    s.begun = true;
    s.t = t;
    // The nearest step: who reads on the sensor's own grid with jitter gets each once.
    const auto index = static_cast<std::uint64_t>(s.period.nearest_index(t - s.t_start));
    Sample sample;
    const bool measured =
        s.provider->capture({index, t, s.t_start, motion_->motion_at(t), 0}, sample).has_value();
    if (measured)
      values_of_sample(sample, s.values);
    else
      std::fill(s.values.begin(), s.values.end(), std::numeric_limits<double>::quiet_NaN());
  }
  return s.values[signal - s.first];
}

double DeviceSensors::read(std::size_t signal, BenchTime t) {
  const std::lock_guard lock(mutex_);
  return signal < signals_.size() ? value(signal, t) : std::numeric_limits<double>::quiet_NaN();
}

bool DeviceSensors::read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                         BenchTime t) {
  if (table != RegisterTable::input_registers || address + out.size() > kRegistersOfAValue * signals_.size())
    return false;
  const std::lock_guard lock(mutex_);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const std::size_t at = address + i;
    const auto bits = std::bit_cast<std::uint64_t>(value(at / kRegistersOfAValue, t));
    out[i] = static_cast<std::uint16_t>(bits >> (48 - 16 * (at % kRegistersOfAValue)));
  }
  return true;
}

}  // namespace rigor
