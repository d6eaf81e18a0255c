#include "calibration/procedures/pair_changes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "bench/run/pair_watches.h"
#include "sensor-hal/channel/pair_watch/pair_watch.h"

namespace rigor {
namespace {

using pair_watch::Alarm;
using pair_watch::ChangeWatch;
using pair_watch::Estimate;
using pair_watch::PairWatch;
using pair_watch::WatchOptions;
using pair_watch::WatchState;

// A third of the windows is taken for normal; a watch needs sixteen to learn.
constexpr std::size_t kWindows = 96, kLeastWindows = 48;
constexpr double kFalseAlarms = 0.01;  // in a recording

struct Window {
  BenchTime start;
  Estimate estimate;
};

/// What the watch compares, of the kind's first pair.
ChannelDescription described(const RecordedPair& pair, const Sample& sample) {
  ChannelDescription d;
  d.kind = pair.kind;
  if (const auto* image = sample.as<ImageInfo>())
    d.width_px = image->width_px, d.height_px = image->height_px, d.format = image->format;
  else if (const auto* range = sample.as<RangeImageInfo>())
    d.width_px = range->width_px, d.height_px = range->height_px;
  else if (const auto* block = sample.as<RegisterBlock>())
    for (std::uint32_t i = 0; i < block->count; ++i) {
      d.names.push_back(i < pair.register_names.size() ? pair.register_names[i]
                                                       : fmt::format("number {}", i));
      d.units.push_back(i < pair.register_units.size() ? pair.register_units[i] : "");
    }
  return d;
}

/// The alarm of a watch that sees these windows, and the number of the first window that has the change.
std::optional<std::pair<Alarm, std::size_t>> alarm_of(const std::vector<pair_watch::Parameter>& parameters,
                                                      const WatchOptions& options,
                                                      const std::vector<const Window*>& windows) {
  auto watch = ChangeWatch::make(parameters, options);
  if (!watch) return std::nullopt;
  for (const Window* w : windows) {
    watch->add(w->estimate);
    if (watch->state() == WatchState::alarm) break;
  }
  if (watch->state() != WatchState::alarm) return std::nullopt;
  return std::pair{watch->alarm(), std::min<std::size_t>(watch->alarm().since, windows.size() - 1)};
}

}  // namespace

std::string RecordedChange::text() const {
  const double order = std::floor(std::log10(sigma));
  const int decimals = std::isfinite(order) ? static_cast<int>(std::clamp(1 - order, 0.0, 9.0)) : 6;
  return fmt::format("{} has changed by {:+.{}f} ± {:.{}f}{} at {:.2f} s", parameter, change, decimals, sigma,
                     decimals, unit.empty() || unit == "1" ? "" : " " + unit, at_s);
}

Result<ChangeSearch> find_change(const RecordedPair& pair, const calibration::ForEachPair& pairs,
                                 const StopToken& stop) {
  ChangeSearch out;
  std::vector<std::int64_t> captures;
  if (auto s = pairs([&](const Sample& a, const Sample&) { captures.push_back(a.stamp.t_capture.ns()); }); !s)
    return tl::unexpected<Error>(s.error());
  if (captures.size() < kLeastWindows || stop.stop_requested()) return out;
  const auto [first, last] = std::ranges::minmax_element(captures);
  const double span_s = static_cast<double>(*last - *first) * 1e-9;
  const double period_s = span_s / static_cast<double>(captures.size() - 1);
  const std::size_t wanted = std::clamp(captures.size() / 2, kLeastWindows, kWindows);
  WatchOptions options;
  options.window_s = std::max(period_s, pair.entry.period.seconds());
  options.window_s = std::max(options.window_s, span_s / static_cast<double>(wanted));
  options.baseline_windows = static_cast<std::uint32_t>(wanted / 3);
  options.false_alarms_per_h = 0.5 * kFalseAlarms * 3600 / std::max(span_s, options.window_s);

  std::optional<PairWatch> watch;
  std::vector<Window> windows;
  Status made;
  const auto take = [&](const Sample& real, const Sample& simulated) {
    if (!made || stop.stop_requested()) return;
    if (!watch) {
      ChannelEntry entry = pair.entry;
      entry.watch = PairWatchConfig{options.window_s, options.baseline_windows, options.false_alarms_per_h};
      auto w = make_pair_watch(entry, described(pair, real), described(pair, simulated));
      if (!w) {
        made = tl::unexpected<Error>(w.error());
        return;
      }
      watch.emplace(std::move(*w));
    }
    const std::uint64_t before = watch->watch().windows();
    watch->add(real, simulated);
    if (watch->watch().windows() == before) return;
    const pair_watch::PairWatchSnapshot s = watch->snapshot();
    windows.push_back({s.t_last, s.last});
  };
  if (auto s = pairs(take); !s) return tl::unexpected<Error>(s.error());
  // More numbers than a watch takes, or a sensor model that cannot be read: the fit says so where it is
  // wrong.
  if (!made) return out;
  if (windows.size() < kLeastWindows / 2) return out;
  out.enough = true;

  std::vector<const Window*> in_order;
  for (const Window& w : windows) in_order.push_back(&w);
  const auto forwards = alarm_of(watch->parameters(), options, in_order);
  std::ranges::reverse(in_order);
  const auto backwards = alarm_of(watch->parameters(), options, in_order);
  if (!forwards && !backwards) return out;
  // Of the two the one that is surer. Backwards the first window with the change is the last before it, and
  // the change has the other sign.
  const bool back = !forwards || (backwards && backwards->first.log_ratio > forwards->first.log_ratio);
  const Alarm& a = back ? backwards->first : forwards->first;
  const std::size_t window = back ? windows.size() - backwards->second : forwards->second;
  const BenchTime at = windows[std::min(window, windows.size() - 1)].start;
  RecordedChange change;
  change.at_s = pair.t0_known ? (at - pair.t0).seconds() : (at - windows.front().start).seconds();
  change.window_s = options.window_s;
  change.parameter = watch->parameters()[a.parameter].name;
  change.unit = watch->parameters()[a.parameter].unit;
  change.change = back ? -a.change : a.change;
  change.sigma = a.sigma;
  out.change = std::move(change);
  return out;
}

}  // namespace rigor
