#include "sensor-hal/channel/pair_watch/change_watch.h"

#include <algorithm>
#include <cmath>
#include <span>

namespace rigor::pair_watch {
namespace {

constexpr std::size_t kLeastBatches = 16;

struct Moments {
  double mean = 0, variance = 0;
  double lag1 = 0;  ///< correlation of neighbours
};

/// Of the means of `batch` numbers each; what is left over at the end is left out.
Moments moments(std::span<const double> x, std::size_t batch) noexcept {
  const std::size_t n = x.size() / batch;
  const auto mean_of = [&](std::size_t k) {
    double s = 0;
    for (std::size_t i = 0; i < batch; ++i) s += x[k * batch + i];
    return s / static_cast<double>(batch);
  };
  Moments m;
  for (std::size_t k = 0; k < n; ++k) m.mean += mean_of(k) / static_cast<double>(n);
  double squares = 0, products = 0, last = 0;
  for (std::size_t k = 0; k < n; ++k) {
    const double d = mean_of(k) - m.mean;
    squares += d * d;
    if (k > 0) products += d * last;
    last = d;
  }
  m.variance = squares / static_cast<double>(n - 1);
  m.lag1 = squares > 0 ? products / squares : 0;
  return m;
}

}  // namespace

Result<ChangeWatch> ChangeWatch::make(std::vector<Parameter> parameters, const WatchOptions& o) {
  const auto bad = [](const char* key, const char* expected, double came) {
    return fail(ErrorCode::bad_input, key,
                std::string("expected ") + expected + ", got " + std::to_string(came));
  };
  if (!(o.window_s > 0) || !std::isfinite(o.window_s)) return bad("window_s", "a length above 0", o.window_s);
  if (o.baseline_windows < kLeastBatches || o.baseline_windows > 100000)
    return bad("baseline_windows", "16 to 100000", o.baseline_windows);
  if (!(o.false_alarms_per_h > 0) || !std::isfinite(o.false_alarms_per_h))
    return bad("false_alarms_per_h", "a rate above 0", o.false_alarms_per_h);
  if (!(o.reference > 0 && o.reference <= 1)) return bad("reference", "above 0 and at most 1", o.reference);
  if (!(o.confidence > 0 && o.confidence < 1)) return bad("confidence", "between 0 and 1", o.confidence);
  if (parameters.empty() || parameters.size() > kMaxParameters)
    return bad("parameters", "1 to 40 of them", static_cast<double>(parameters.size()));
  return ChangeWatch(std::move(parameters), o);
}

ChangeWatch::ChangeWatch(std::vector<Parameter> parameters, const WatchOptions& options)
    : parameters_(std::move(parameters)), options_(options) {
  const std::size_t p = parameters_.size();
  run_length_ = static_cast<double>(p) * 3600 / (options_.false_alarms_per_h * options_.window_s);
  ring_.resize(std::max<std::size_t>(options_.baseline_windows, 256));
  column_.reserve(options_.baseline_windows);
  learned_.resize(p);
  inverse_.resize(p * p);
}

void ChangeWatch::add(const Estimate& e) noexcept {
  ring_[window_ % ring_.size()] = e;
  const std::uint64_t now = window_++;
  for (std::size_t i = 0; i < learned_.size(); ++i)
    if (!std::isfinite(e.value[i])) ++learned_[i].undetermined;
  if (state_ == WatchState::learning) {
    if (window_ - first_ >= options_.baseline_windows) learn();
    return;
  }
  double highest = 1;
  std::size_t trigger = learned_.size();
  for (std::size_t i = 0; i < learned_.size(); ++i) {
    Learned& l = learned_[i];
    if (!l.watched) continue;
    const double less_certain =
        l.within > 0 && std::isfinite(e.sigma[i]) ? std::max(1.0, e.sigma[i] / l.within) : 1;
    l.sum.add((e.value[i] - l.mean) / (l.sigma * less_certain), now);
    l.highest = std::max(l.highest, l.sum.level());
    if (l.sum.level() >= highest) highest = l.sum.level(), trigger = i;
  }
  if (state_ == WatchState::watching && trigger < learned_.size()) raise(trigger);
}

void ChangeWatch::acknowledge() noexcept {
  if (state_ != WatchState::alarm) return;
  for (Learned& l : learned_) l.sum.restart(window_);
  state_ = WatchState::watching;
}

void ChangeWatch::learn_again() noexcept {
  for (Learned& l : learned_) l = Learned{};
  first_ = window_;
  state_ = WatchState::learning;
}

void ChangeWatch::learn_one(std::size_t i) noexcept {
  Learned& l = learned_[i];
  column_.clear();
  double within = 0, counted = 0;
  for (std::uint64_t w = first_; w < window_; ++w) {
    const Estimate& e = at(w);
    if (!std::isfinite(e.value[i])) continue;
    column_.push_back(e.value[i]);
    if (std::isfinite(e.sigma[i])) within += e.sigma[i] * e.sigma[i], ++counted;
  }
  const std::size_t n = column_.size();
  if (n < kLeastBatches || 2 * n < options_.baseline_windows) return;
  l.watched = true;
  l.within = counted > 0 ? std::sqrt(within / counted) : 0;
  const double p = static_cast<double>(parameters_.size());
  // Each parameter has two chances to be out of its limits: its scale, its mean (two-sided).
  const double miss = (1 - options_.confidence) / (2 * p);
  const auto upper = [&](double variance, double freedom) {
    return std::sqrt(variance * freedom / chi_squared_quantile(miss, freedom));
  };
  Moments m = moments(column_, 1);
  l.mean = m.mean;
  l.marginal = std::sqrt(m.variance);
  l.sigma = upper(m.variance, static_cast<double>(n - 1));
  // How far off the mean may be.
  const auto off = [&](double variance, double freedom) {
    return -student_quantile(miss / 2, freedom) * std::sqrt(variance / (freedom + 1));
  };
  double mean_off = off(m.variance, static_cast<double>(n - 1));
  for (std::size_t batch = 1;; batch *= 2) {
    const std::size_t batches = n / batch;
    m = moments(column_, batch);
    const double b = static_cast<double>(batch), a = static_cast<double>(batches);
    if (batch > 1) {
      l.sigma = std::max(l.sigma, upper(b * m.variance, a - 1));
      mean_off = std::max(mean_off, off(m.variance, a - 1));
    }
    const bool correlates = m.lag1 > 1.645 / std::sqrt(a);
    if (!correlates) break;
    if (batches / 2 < kLeastBatches) {
      // Go on as a first-order process would whose neighbouring means correlate like these.
      const double rho = std::min(m.lag1, 0.95), more = std::sqrt((1 + rho) / (1 - rho));
      l.sigma = std::max(l.sigma, more * upper(b * m.variance, a - 1));
      mean_off = std::max(mean_off, more * off(m.variance, a - 1));
      l.unsettled = true;
      break;
    }
  }
  // Never less than what a window itself claims: shares that were 0 in all windows. Numbers that never
  // changed and claim to be exact (a switch): any change is one.
  l.sigma = std::max({l.sigma, l.within, 1e-9 * std::abs(l.mean), 1e-12});
  const double k = std::max(options_.reference, parameters_[i].least / (2 * l.sigma));
  // The formula is too long for larger k: a sum with them runs longer than one with k = 1.
  const double h = threshold_for(std::min(k, 1.0), run_length_);
  l.sum = Cusum(k + mean_off / l.sigma, h);
  l.sum.restart(window_);
}

void ChangeWatch::learn() noexcept {
  const std::size_t p = parameters_.size();
  for (std::size_t i = 0; i < p; ++i) learn_one(i);
  std::fill(inverse_.begin(), inverse_.end(), 0.0);
  double n = 0;
  for (std::uint64_t w = first_; w < window_; ++w) {
    const Estimate& e = at(w);
    std::array<double, kMaxParameters> z{};
    bool whole = true;
    for (std::size_t i = 0; i < p; ++i) {
      const Learned& l = learned_[i];
      if (!l.watched || !(l.marginal > 0)) continue;
      z[i] = (e.value[i] - l.mean) / l.marginal;
      whole = whole && std::isfinite(z[i]);
    }
    if (!whole) continue;
    ++n;
    for (std::size_t i = 0; i < p; ++i)
      for (std::size_t j = 0; j < p; ++j) inverse_[i * p + j] += z[i] * z[j];
  }
  const double shrink = static_cast<double>(p + 1) / (static_cast<double>(p + 1) + n);
  std::array<double, kMaxParameters> diagonal{};
  for (std::size_t i = 0; i < p; ++i) diagonal[i] = inverse_[i * p + i];
  for (std::size_t i = 0; i < p; ++i)
    for (std::size_t j = 0; j < p; ++j) {
      const double d = diagonal[i] * diagonal[j];
      inverse_[i * p + j] = i == j ? 1 : d > 0 ? (1 - shrink) * inverse_[i * p + j] / std::sqrt(d) : 0;
    }
  std::array<bool, kMaxParameters> swept{}, determined{};  // all: shrinking sees to that
  sweep_inverse(inverse_, p, swept, determined);
  state_ = WatchState::watching;
}

/// What a change of 1 of j alone does to all that are watched.
std::array<double, kMaxParameters> ChangeWatch::direction(std::size_t j) const noexcept {
  std::array<double, kMaxParameters> d{};
  d[j] = 1;
  if (parameters_[j].common < 0) return d;
  double group = 0;
  for (const Parameter& q : parameters_) group += q.common == parameters_[j].common;
  for (std::size_t i = 0; i < parameters_.size(); ++i) {
    if (!learned_[i].watched) continue;
    if (parameters_[i].common == parameters_[j].common) d[i] -= 1 / group;
    if (static_cast<int>(i) == parameters_[j].common) d[i] = 1 / group;
  }
  return d;
}

void ChangeWatch::raise(std::size_t trigger) noexcept {
  const std::size_t p = parameters_.size();
  alarm_ = Alarm{};
  alarm_.trigger = alarm_.parameter = alarm_.runner_up = static_cast<std::uint32_t>(trigger);
  alarm_.window = window_ - 1;
  // The sum may have left 0 by chance a while before the change: of the windows since then the most likely
  // first one with the change is that with the largest n · mean².
  const std::uint64_t oldest_kept = std::max<std::uint64_t>(
      {learned_[trigger].sum.since(), window_ > ring_.size() ? window_ - ring_.size() : 0,
       first_ + options_.baseline_windows});
  std::uint64_t oldest = window_ - 1;
  double sum_back = 0, count_back = 0, most = -1;
  for (std::uint64_t w = window_; w-- > oldest_kept;) {
    const double v = at(w).value[trigger] - learned_[trigger].mean;
    if (!std::isfinite(v)) continue;
    sum_back += v, ++count_back;
    if (const double gain = sum_back * sum_back / count_back; gain > most) most = gain, oldest = w;
  }
  alarm_.since = oldest;
  // Mean change of each in marginal standard deviations. What a parameter's windows do not say is no change.
  std::array<double, kMaxParameters> change{}, unit{};
  const double n = static_cast<double>(window_ - oldest);
  for (std::size_t i = 0; i < p; ++i) {
    const Learned& l = learned_[i];
    if (!l.watched) continue;
    unit[i] = l.marginal > 0 ? l.marginal : l.sigma;
    double sum = 0, count = 0;
    for (std::uint64_t w = oldest; w < window_; ++w)
      if (const double v = at(w).value[i]; std::isfinite(v)) sum += v, ++count;
    if (count > 0) change[i] = (sum / count - l.mean) / unit[i];
  }
  double best = -1, second = -1;
  for (std::size_t j = 0; j < p; ++j) {
    const Learned& l = learned_[j];
    if (!l.watched) continue;
    const auto d = direction(j);
    double s = 0, information = 0;
    for (std::size_t i = 0; i < p; ++i) {
      if (d[i] == 0) continue;
      for (std::size_t k = 0; k < p; ++k) {
        s += d[i] / unit[i] * inverse_[i * p + k] * change[k];
        if (d[k] != 0) information += d[i] / unit[i] * inverse_[i * p + k] * d[k] / unit[k];
      }
    }
    const double ratio = n * s * s / (2 * information), delta = s / information;
    if (ratio > best) {
      second = best;
      alarm_.runner_up = alarm_.parameter, alarm_.runner_up_change = alarm_.change;
      alarm_.runner_up_log_ratio = alarm_.log_ratio;
      best = ratio;
      alarm_.parameter = static_cast<std::uint32_t>(j);
      alarm_.change = delta, alarm_.log_ratio = ratio;
      // Windows hang together, and the baseline's mean is only so good.
      double within = 0, told = 0;
      for (std::uint64_t w = oldest; w < window_; ++w)
        if (const double x = at(w).sigma[j]; std::isfinite(x)) within += x * x, ++told;
      // So may the noise have grown, and these windows be less certain than those of the baseline.
      const double uncertain = told > 0 && l.within > 0 ? std::sqrt(within / told) / l.within : 1;
      const double wide =
          std::max(1.0, uncertain) * (l.marginal > 0 ? std::max(1.0, l.sigma / l.marginal) : 1);
      const double base = static_cast<double>(options_.baseline_windows);
      alarm_.sigma = wide * std::sqrt((1 / n + 1 / base) / information);
    } else if (ratio > second) {
      second = ratio;
      alarm_.runner_up = static_cast<std::uint32_t>(j);
      alarm_.runner_up_change = delta, alarm_.runner_up_log_ratio = ratio;
    }
  }
  if (second < 0) alarm_.runner_up = alarm_.parameter, alarm_.runner_up_log_ratio = 0;
  state_ = WatchState::alarm;
}

ParameterState ChangeWatch::parameter_state(std::size_t i) const noexcept {
  const Learned& l = learned_[i];
  return {l.watched, l.unsettled, l.mean,    l.sigma,       l.watched ? l.sum.level() : 0,
          l.highest, l.sum.k(),   l.sum.h(), l.undetermined};
}

}  // namespace rigor::pair_watch
