#include "drivers/velodyne/velodyne_device.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

namespace rigor::velodyne {
namespace {

constexpr DeviceFacts kFacts[] = {
    {Model::vlp16, "VLP-16", "vlp16", 0x22, 16, 2, 2304, 55296},
    {Model::hdl32e, "HDL-32E", "hdl32e", 0x21, 32, 1, 1152, 46080},
};

}  // namespace

const DeviceFacts& facts_of(Model model) { return kFacts[static_cast<std::size_t>(model)]; }

std::optional<Model> model_of(std::uint8_t product) {
  for (const DeviceFacts& f : kFacts)
    if (f.product == product) return f.model;
  return {};
}
std::optional<Model> model_named(std::string_view key) {
  for (const DeviceFacts& f : kFacts)
    if (f.key == key) return f.model;
  return {};
}

Calibration factory_calibration(Model model) {
  constexpr double kRadPerDegree = std::numbers::pi / 180;
  // VLP-16 manual, table 9-1: elevation and vertical offset by laser id.
  constexpr double kVlpElevation_deg[] = {-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15};
  constexpr double kVlpOffset_mm[] = {11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1,
                                      5.1,  -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2};
  // HDL-32E manual: from -30.67 to 10.67 degrees in steps of 4/3, the lower and the upper half in turn.
  Calibration c;
  c.lasers.resize(facts_of(model).lasers);
  for (std::size_t i = 0; i < c.lasers.size(); ++i) {
    if (model == Model::vlp16) {
      c.lasers[i].elevation_rad = kVlpElevation_deg[i] * kRadPerDegree;
      c.lasers[i].vertical_offset_m = kVlpOffset_mm[i] * 1e-3;
    } else {
      const double step = static_cast<double>(i % 2 == 0 ? i / 2 : 16 + i / 2);
      c.lasers[i].elevation_rad = std::round((-92.0 / 3 + step * 4 / 3) * 100) / 100 * kRadPerDegree;
    }
  }
  return c;
}

std::vector<std::uint16_t> elevation_order(const Calibration& c) {
  std::vector<std::uint16_t> by(c.lasers.size()), place(c.lasers.size());
  std::iota(by.begin(), by.end(), std::uint16_t{0});
  std::stable_sort(by.begin(), by.end(),
                   [&](auto a, auto b) { return c.lasers[a].elevation_rad < c.lasers[b].elevation_rad; });
  for (std::size_t i = 0; i < by.size(); ++i) place[by[i]] = static_cast<std::uint16_t>(i);
  return place;
}

void ModelEvidence::add(const DataPacket& packet) noexcept {
  const std::uint32_t us = packet.timestamp_us();
  const std::uint32_t step = us - last_us_;  // backwards and over the hour: large, fits nothing
  const bool known = any_;
  last_us_ = us;
  any_ = true;
  if (!known) return;
  for (const DeviceFacts& f : kFacts) {
    const double expected_us = static_cast<double>(f.packet_ns(packet.dual())) * 1e-3;
    if (std::abs(step - expected_us) < 0.02 * expected_us) ++votes_[static_cast<std::size_t>(f.model)];
  }
}

std::optional<Model> ModelEvidence::model() const noexcept {
  const std::uint64_t a = votes_[0], b = votes_[1];
  if (a >= 8 && a > 10 * b) return Model::vlp16;
  if (b >= 8 && b > 10 * a) return Model::hdl32e;
  return {};
}

}  // namespace rigor::velodyne
