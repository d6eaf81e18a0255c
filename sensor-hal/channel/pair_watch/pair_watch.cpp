#include "sensor-hal/channel/pair_watch/pair_watch.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace rigor::pair_watch {

template <class T>
Result<PairWatch> PairWatch::make(Result<T> change, const std::vector<Parameter>& parameters,
                                  const WatchOptions& options) {
  auto watch = ChangeWatch::make(parameters, options);
  if (!watch) return tl::unexpected<Error>(watch.error());
  return PairWatch(Change(std::move(*change)), std::move(*watch), options);
}

Result<PairWatch> PairWatch::of_images(const CameraModel& camera, const ImageInfo& shape,
                                       const ImageChangeOptions& image, const WatchOptions& watch) {
  auto change = ImageChange::make(camera, shape, image);
  if (!change) return tl::unexpected<Error>(change.error());
  const auto parameters = change->parameters();
  return make(std::move(change), parameters, watch);
}

Result<PairWatch> PairWatch::of_clouds(const CloudChangeOptions& cloud, const WatchOptions& watch) {
  auto change = CloudChange::make(cloud);
  if (!change) return tl::unexpected<Error>(change.error());
  const auto parameters = change->parameters();
  return make(std::move(change), parameters, watch);
}

Result<PairWatch> PairWatch::of_range_images(const RangeImageInfo& shape,
                                             const RangeImageChangeOptions& range,
                                             const WatchOptions& watch) {
  auto change = RangeImageChange::make(shape, range);
  if (!change) return tl::unexpected<Error>(change.error());
  const auto parameters = change->parameters();
  return make(std::move(change), parameters, watch);
}

Result<PairWatch> PairWatch::of_registers(const std::vector<WatchedRegister>& registers,
                                          const WatchOptions& watch) {
  std::vector<WatchedValue> values;
  std::vector<std::uint32_t> index;
  for (const WatchedRegister& r : registers) {
    if (r.index >= RegisterBlock::kMax)
      return fail(ErrorCode::bad_input, r.value.name,
                  "expected a place below " + std::to_string(RegisterBlock::kMax) + ", got " +
                      std::to_string(r.index));
    values.push_back(r.value), index.push_back(r.index);
  }
  auto change = ValueChange::make(values);
  if (!change) return tl::unexpected<Error>(change.error());
  const auto parameters = change->parameters();
  return make(Result<Registers>(Registers{std::move(*change), std::move(index)}), parameters, watch);
}

Result<PairWatch> PairWatch::of_numbers(SampleKind kind, const WatchOptions& watch) {
  auto change = KindNumbers::make(kind);
  if (!change) return tl::unexpected<Error>(change.error());
  const auto parameters = change->parameters();
  return make(std::move(change), parameters, watch);
}

void PairWatch::add(const Sample& real, const Sample& simulated) noexcept {
  const BenchTime t = real.stamp.t_capture;
  if (!any_) {
    any_ = true, start_ = t;
  } else if (t < start_) {  // the clock was set back
    end_window();
    start_ = t;
  } else if (t - start_ >= window_) {
    end_window();
    start_ = start_ + window_ * ((t - start_) / window_);
  }
  const auto taken = [&](auto& change) {
    using T = std::decay_t<decltype(change)>;
    if constexpr (std::is_same_v<T, Registers>) {
      const auto *a = real.as<RegisterBlock>(), *b = simulated.as<RegisterBlock>();
      if (!a || !b || a->count > RegisterBlock::kMax || b->count > RegisterBlock::kMax) return false;
      std::array<double, kMaxParameters> x{}, y{};
      for (std::size_t i = 0; i < change.index.size(); ++i) {
        const std::uint32_t at = change.index[i];
        if (at >= a->count || at >= b->count) return false;
        x[i] = a->value[at], y[i] = b->value[at];
      }
      const std::size_t n = change.index.size();
      return change.values.add((t - BenchTime{}).seconds(), {x.data(), n}, {y.data(), n});
    } else if constexpr (std::is_same_v<T, KindNumbers>) {
      return change.add((t - BenchTime{}).seconds(), real, simulated);
    } else {
      return change.add(real, simulated);
    }
  };
  ++(std::visit(taken, change_) ? compared_ : unlike_);
}

void PairWatch::end_window() noexcept {
  std::visit(
      [&](auto& change) {
        if constexpr (requires { change.values; })
          change.values.finish(last_);
        else
          change.finish(last_);
      },
      change_);
  starts_[watch_.windows() % kStarts] = last_start_ = start_;
  const bool before = watch_.state() == WatchState::alarm;
  watch_.add(last_);
  if (before || watch_.state() != WatchState::alarm) return;
  ++alarms_;
  const Alarm& a = watch_.alarm();
  t_alarm_ = start_ + window_;
  // A change that began longer ago than is kept: at least since then.
  const std::uint64_t kept = a.window + 1 > kStarts ? a.window + 1 - kStarts : 0;
  t_since_ = starts_[std::max(a.since, kept) % kStarts];
}

PairWatchSnapshot PairWatch::snapshot() const noexcept {
  PairWatchSnapshot s;
  s.state = watch_.state();
  s.compared = compared_, s.unlike = unlike_;
  s.windows = watch_.windows();
  s.baseline_windows = baseline_windows_;
  s.learned = static_cast<std::uint32_t>(watch_.learned());
  s.parameters = static_cast<std::uint32_t>(watch_.parameters().size());
  s.alarms = alarms_;
  s.alarm = watch_.alarm();
  s.t_alarm = t_alarm_, s.t_since = t_since_;
  s.last = last_, s.t_last = last_start_;
  for (std::size_t i = 0; i < s.parameters; ++i)
    s.level[i] = static_cast<float>(watch_.parameter_state(i).level);
  return s;
}

std::string text_of(const PairWatch& watch, const PairWatchSnapshot& s, BenchTime t0) {
  if (s.alarms == 0) return {};
  const Parameter &p = watch.parameters()[s.alarm.parameter], &q = watch.parameters()[s.alarm.runner_up];
  const std::string unit = p.unit == "1" ? "" : " " + p.unit;
  char text[400];
  // As many decimals as the uncertainty has, with two digits of it.
  const double order = std::floor(std::log10(s.alarm.sigma));
  const int decimals = std::isfinite(order) ? static_cast<int>(std::clamp(1 - order, 0.0, 9.0)) : 6;
  const double since_s = (s.t_since - t0).seconds();
  int n = std::snprintf(text, sizeof text, "%s has changed by %+.*f ± %.*f%s, since %.*f s", p.name.c_str(),
                        decimals, s.alarm.change, decimals, s.alarm.sigma, unit.c_str(),
                        since_s < 100 ? 1 : 0, since_s);
  if (s.alarm.runner_up != s.alarm.parameter && n > 0 && n < static_cast<int>(sizeof text))
    std::snprintf(text + n, sizeof text - static_cast<std::size_t>(n),
                  "; next best: %s (log ratios %.0f, %.0f)", q.name.c_str(), s.alarm.log_ratio,
                  s.alarm.runner_up_log_ratio);
  return text;
}

}  // namespace rigor::pair_watch
