#include "sensor-hal/record/pair_diagnostics.h"

#include <array>
#include <charconv>
#include <cmath>

#include "sensor-hal/channel/pair_monitor.h"

namespace rigor::record {
namespace {

std::string number(double v) {
  std::array<char, 40> text{};
  return {text.data(), std::to_chars(text.data(), text.data() + text.size(), v).ptr};
}

}  // namespace

msg::DiagnosticStatus pair_diagnostics(const std::string& channel, SampleKind kind,
                                       std::span<const pair_watch::Parameter> parameters,
                                       const PairWindow& w) {
  using pair_watch::WatchState;
  msg::DiagnosticStatus d;
  d.level = w.state == WatchState::alarm ? 2 : w.state == WatchState::learning ? 1 : 0;
  d.name = channel + " pair";
  d.hardware_id = channel;
  d.message = w.state == WatchState::alarm      ? "the simulation no longer describes the device"
              : w.state == WatchState::learning ? "learning: " + std::to_string(w.learned) + " of " +
                                                      std::to_string(w.baseline) + " windows"
                                                : "as in the baseline";
  const auto add = [&](std::string key, double value) {
    if (std::isfinite(value)) d.values.push_back({std::move(key), number(value)});
  };
  const std::string unit = kind == SampleKind::image                                            ? " [DN]"
                           : kind == SampleKind::point_cloud || kind == SampleKind::range_image ? " [m]"
                                                                                                : "";
  add("pairs", static_cast<double>(w.compared));
  add("pairs unlike", static_cast<double>(w.unlike));
  if (w.difference.count > 0) add("bias" + unit, w.difference.bias), add("sigma" + unit, w.difference.sigma);
  add("residual left" + unit, w.estimate.left);
  add("shift [px]", w.estimate.shift_px);
  add("features [px]", w.estimate.features_px);
  for (std::size_t i = 0; i < parameters.size() && i < w.parameters; ++i) {
    const pair_watch::Parameter& p = parameters[i];
    if (!std::isfinite(w.estimate.value[i])) continue;
    add(p.name + (p.unit == "1" || p.unit.empty() ? "" : " [" + p.unit + "]"), w.estimate.value[i]);
    add(p.name + " sigma", w.estimate.sigma[i]);
    add(p.name + " level", static_cast<double>(w.level[i]));
  }
  return d;
}

}  // namespace rigor::record
