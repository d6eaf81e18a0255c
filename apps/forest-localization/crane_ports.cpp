#include "apps/forest-localization/crane_ports.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "apps/forest-localization/rig_ports.h"

namespace rigor::forest {
namespace {
constexpr std::array<const char*, 5> kToldNames{"slew", "boom", "stick", "telescope", "felled"};
constexpr std::array<const char*, 7> kCommandNames{"slew_to",   "boom_to", "stick_to", "telescope_to",
                                                   "rotate_to", "grip_to", "fell"};
constexpr std::size_t kRotate = 4;
}  // namespace

CranePorts::CranePorts(const ConfigNode& n, const ApplicationPorts& ports) : work_(read(n)) {
  best_slew_rad_ = n.number_or("best_slew_deg", 50, {.min = 0, .max = 180}) * kRadPerDeg;
  hide_m_ = n.number_or("hide_m", 0.6, {.min = 0, .max = 5});
  find(n, ports);
  n.finish();
}

CraneWorkConfig CranePorts::read(const ConfigNode& n) {
  CraneWorkConfig c;
  const auto foot = n.numbers("foot_m", 3);
  c.crane.foot_x_m = foot[0], c.crane.foot_y_m = foot[1], c.crane.foot_z_m = foot[2];
  c.crane.boom_m = n.number("boom_m", {.min = 0.1, .max = 50});
  c.crane.stick_m = n.number("stick_m", {.min = 0.1, .max = 50});
  c.crane.head_m = n.number("head_m", {.min = 0, .max = 10});
  const auto stops = [&](const char* key, double scale, double& least, double& greatest) {
    const auto two = n.numbers(key, 2);
    if (!(two[0] <= two[1])) throw n.error(key, "expected the least and the greatest value, in this order");
    least = two[0] * scale, greatest = two[1] * scale;
  };
  stops("slew_deg", kRadPerDeg, c.crane.least.slew_rad, c.crane.greatest.slew_rad);
  stops("boom_deg", kRadPerDeg, c.crane.least.boom_rad, c.crane.greatest.boom_rad);
  stops("stick_deg", kRadPerDeg, c.crane.least.stick_rad, c.crane.greatest.stick_rad);
  stops("telescope_m", 1, c.crane.least.telescope_m, c.crane.greatest.telescope_m);
  const ConfigNode rest = n.map("rest");
  c.rest = {rest.number("slew_deg") * kRadPerDeg, rest.number("boom_deg") * kRadPerDeg,
            rest.number("stick_deg") * kRadPerDeg, rest.number("telescope_m")};
  rest.finish();
  c.cut_height_m = n.number_or("cut_height_m", 0.4, {.min = -2, .max = 5});
  return c;
}

void CranePorts::find(const ConfigNode& n, const ApplicationPorts& ports) {
  for (const ConfigNode& item : n.list("channels")) {
    const std::string name = item.as_text();
    const auto it = ports.inputs.find(name);
    if (it == ports.inputs.end() || it->second.description->kind != SampleKind::register_block)
      throw n.error("channels", "expected the names of channels of kind registers, got \"" + name + "\"");
    const auto& names = it->second.description->names;
    for (std::size_t i = 0; i < kTold; ++i)
      if (const auto at = std::find(names.begin(), names.end(), kToldNames[i]); at != names.end())
        sources_[i] = {it->second.port, static_cast<std::size_t>(at - names.begin())};
  }
  for (std::size_t i = 0; i < kTold; ++i)
    if (!sources_[i].port)
      throw n.error("channels", std::string("expected a value ") + kToldNames[i] + " in one of them");
  std::array<bool, kCommanded> found{};
  for (const ConfigNode& item : n.list("sinks")) {
    const std::string name = item.as_text();
    const auto it = ports.outputs.find(name);
    if (it == ports.outputs.end())
      throw n.error("sinks", "expected the names of sinks, got \"" + name + "\"");
    const auto& names = it->second->describe().names;
    Output out;
    out.port = it->second;
    for (const std::string& value : names) {
      const auto at = std::find(kCommandNames.begin(), kCommandNames.end(), value);
      if (at == kCommandNames.end() || out.count == out.value.size())
        throw n.error("sinks",
                      "expected sinks of the crane's values alone (slew_to, boom_to, stick_to, "
                      "telescope_to, rotate_to, grip_to, fell), got \"" +
                          value + "\" in " + name);
      out.value[out.count++] = static_cast<std::size_t>(at - kCommandNames.begin());
      found[out.value[out.count - 1]] = true;
    }
    outputs_.push_back(out);
  }
  for (std::size_t i = 0; i < kCommanded; ++i)
    if (!found[i] && i != kRotate)
      throw n.error("sinks", std::string("expected a value ") + kCommandNames[i] + " in one of them");
}

void CranePorts::listen() noexcept {
  const std::array<double*, kTold> to{&now_.angles.slew_rad, &now_.angles.boom_rad, &now_.angles.stick_rad,
                                      &now_.angles.telescope_m, &now_.felled};
  for (std::size_t i = 0; i < kTold; ++i) {
    const SamplePort& port = *sources_[i].port;
    const auto* block = port.sample() ? port.sample()->as<RegisterBlock>() : nullptr;
    if (!block || sources_[i].index >= block->count) continue;
    const double value = block->value[sources_[i].index];
    if (!std::isfinite(value)) continue;
    *to[i] = i < 3 ? value * kRadPerDeg : value;
    known_ |= 1u << i;
  }
}

void CranePorts::step(BenchTime now) noexcept {
  listen();
  const CraneCommand c = work_.step(now_, now);
  const std::array<double, kCommanded> value{c.to.slew_rad / kRadPerDeg,
                                             c.to.boom_rad / kRadPerDeg,
                                             c.to.stick_rad / kRadPerDeg,
                                             c.to.telescope_m,
                                             c.rotate_rad / kRadPerDeg,
                                             c.grip,
                                             c.fell};
  for (const Output& out : outputs_) {
    std::array<double, 16> values{};
    for (std::size_t i = 0; i < out.count; ++i) values[i] = value[out.value[i]];
    (void)out.port->send(now, std::span(values).first(out.count));  // a full ring is counted by the sink
  }
}

bool CranePorts::begin(double x_m, double y_m, BenchTime now) noexcept {
  return known_ == (1u << kTold) - 1 && work_.begin(x_m, y_m, now_, now);
}

double CranePorts::cost(double x_m, double y_m) const noexcept {
  const CraneGeometry& c = work_.config().crane;
  if (!work_.reaches(x_m, y_m)) return std::numeric_limits<double>::infinity();
  return std::abs(std::abs(std::atan2(y_m - c.foot_y_m, x_m - c.foot_x_m)) - best_slew_rad_);
}

std::optional<IgnoredStrip> CranePorts::strip() const noexcept {
  constexpr unsigned kAngles = 15;
  if ((known_ & kAngles) != kAngles || hide_m_ <= 0) return std::nullopt;
  const CraneGeometry& c = work_.config().crane;
  const CranePlace head = place_of_head(c, now_.angles);
  // Half folded, the elbow may lie farther out than the head.
  const double elbow_m = c.boom_m * std::cos(now_.angles.boom_rad);
  const double head_m = std::hypot(head.x_m - c.foot_x_m, head.y_m - c.foot_y_m);
  const double reach_m = std::max(elbow_m, head_m);
  return IgnoredStrip{c.foot_x_m, c.foot_y_m, c.foot_x_m + reach_m * std::cos(now_.angles.slew_rad),
                      c.foot_y_m + reach_m * std::sin(now_.angles.slew_rad), hide_m_};
}

}  // namespace rigor::forest
