#include "calibration/latency/latency_fit.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <span>

#include "calibration/core/chi_squared.h"
#include "calibration/latency/order_statistics.h"

namespace rigor::calibration {
namespace {

using Sorted = std::vector<std::int64_t>;

/// By nearest rank.
std::int64_t at_quantile(const Sorted& sorted, double quantile) {
  const double n = static_cast<double>(sorted.size());
  const double rank = std::clamp(std::ceil(quantile * n), 1.0, n);
  return sorted[static_cast<std::size_t>(rank) - 1];
}

/// Upper bound of a quantile beyond the samples whose excesses over the (k+1)-largest are exponential: their
/// sum over the mean μ is Gamma(k), which bounds μ; the share above that sample is (k + 1)/(n + 1) in the
/// mean.
std::int64_t bound_by_tail(const Sorted& sorted, const LatencyOptions& options) {
  const std::size_t n = sorted.size(), k = std::max(kFewestLatencies / 2, n / 10);
  const std::int64_t threshold = sorted[n - k - 1];
  double sum = 0;
  for (std::size_t i = n - k; i < n; ++i) sum += static_cast<double>(sorted[i] - threshold);
  const double dof = 2 * static_cast<double>(k);
  const double mean = 2 * sum / chi_squared_quantile(1 - options.confidence, dof);
  const double share = static_cast<double>(k + 1) / static_cast<double>(n + 1);
  const double beyond = mean * std::log(share / (1 - options.quantile));
  return std::max(sorted.back(), threshold + static_cast<std::int64_t>(std::ceil(std::max(0.0, beyond))));
}

std::int64_t bound_of(const Sorted& sorted, const LatencyOptions& options) {
  const auto rank = upper_rank(sorted.size(), options.quantile, options.confidence);
  return rank ? sorted[*rank - 1] : bound_by_tail(sorted, options);
}

struct Interval {
  std::int64_t low, high;
};
/// With `miss` as the probability of each end to lie on the wrong side.
std::optional<Interval> interval_of(const Sorted& sorted, double quantile, double miss) {
  const auto low = lower_rank(sorted.size(), quantile, 1 - miss);
  const auto high = upper_rank(sorted.size(), quantile, 1 - miss);
  if (!low || !high) return std::nullopt;
  return Interval{sorted[*low - 1], sorted[*high - 1]};
}

/// Whether the parts' intervals of a quantile fail to meet by more than rounding and a twentieth of the
/// bound would hide: with many samples the smallest drift is significant.
bool contradict(const std::vector<Interval>& intervals, std::int64_t bound_ns) {
  std::int64_t highest_low = intervals.front().low, lowest_high = intervals.front().high;
  for (const Interval& i : intervals)
    highest_low = std::max(highest_low, i.low), lowest_high = std::min(lowest_high, i.high);
  return highest_low - lowest_high > std::max(kLatencyStep_ns, bound_ns / 20);
}

/// Fills parts, part_quantile and stationary.
void judge_parts(LatencyFit& fit, const std::vector<LatencyPart>& parts, const std::vector<Sorted>& sorted,
                 const LatencyOptions& options) {
  std::vector<double> quantiles{options.quantile, 0.99, 0.9, 0.5};
  std::sort(quantiles.rbegin(), quantiles.rend());
  quantiles.erase(std::unique(quantiles.begin(), quantiles.end()), quantiles.end());
  // One in a hundred of all samples without a change may seem to have one.
  const double miss = 0.01 / (2 * static_cast<double>(parts.size() * quantiles.size()));
  for (const double quantile : quantiles) {
    std::vector<Interval> intervals;
    for (const Sorted& s : sorted)
      if (const auto i = interval_of(s, quantile, miss)) intervals.push_back(*i);
    if (intervals.size() < parts.size()) continue;
    const bool differ = contradict(intervals, fit.bound_ns);
    if (!differ && !fit.parts.empty()) continue;
    fit.parts.clear();
    for (std::size_t i = 0; i < parts.size(); ++i)
      fit.parts.push_back({parts[i].name, sorted[i].size(), intervals[i].low, intervals[i].high});
    fit.part_quantile = quantile;
    fit.stationary = !differ;
    if (differ) return;
  }
}

std::vector<LatencyPart> halves_of(const LatencyPart& whole) {
  const auto middle = whole.latency_ns.begin() + static_cast<std::ptrdiff_t>(whole.latency_ns.size() / 2);
  return {{"first half", {whole.latency_ns.begin(), middle}},
          {"second half", {middle, whole.latency_ns.end()}}};
}

}  // namespace

std::int64_t round_latency_up(std::int64_t latency_ns) {
  if (latency_ns <= 0) return 0;
  return (latency_ns + kLatencyStep_ns - 1) / kLatencyStep_ns * kLatencyStep_ns;
}

Result<LatencyFit> fit_latency(const std::vector<LatencyPart>& parts, const LatencyOptions& options) {
  for (const auto& [name, value] :
       {std::pair("quantile", options.quantile), std::pair("confidence", options.confidence)})
    if (!(value > 0 && value < 1))
      return fail(ErrorCode::bad_input, name,
                  "expected a number between 0 and 1, got " + std::to_string(value));
  std::vector<LatencyPart> filled;
  for (const LatencyPart& p : parts)
    if (!p.latency_ns.empty()) filled.push_back(p);
  Sorted all;
  for (const LatencyPart& p : filled) all.insert(all.end(), p.latency_ns.begin(), p.latency_ns.end());
  std::sort(all.begin(), all.end());
  if (all.size() < kFewestLatencies)
    return fail(ErrorCode::bad_input, "samples",
                "expected at least " + std::to_string(kFewestLatencies) + " samples, got " +
                    std::to_string(all.size()) + ": record for longer");

  LatencyFit fit;
  fit.samples = all.size();
  fit.p50_ns = at_quantile(all, 0.5);
  fit.p99_ns = at_quantile(all, 0.99);
  fit.p999_ns = at_quantile(all, 0.999);
  fit.max_ns = all.back();
  const auto middle = interval_of(all, 0.5, (1 - options.confidence) / 2);
  fit.p50_low_ns = middle ? middle->low : all.front();
  fit.p50_high_ns = middle ? middle->high : all.back();
  fit.samples_needed = samples_needed(options.quantile, options.confidence);
  fit.proven_quantile = quantile_below_largest(all.size(), options.confidence);
  fit.method =
      all.size() >= fit.samples_needed ? LatencyBound::order_statistic : LatencyBound::exponential_tail;
  fit.bound_ns = bound_of(all, options);

  if (filled.size() == 1) filled = halves_of(filled.front());
  std::vector<Sorted> sorted;
  for (const LatencyPart& p : filled) {
    sorted.push_back(p.latency_ns);
    std::sort(sorted.back().begin(), sorted.back().end());
  }
  judge_parts(fit, filled, sorted, options);
  if (!fit.stationary)
    for (const Sorted& s : sorted)
      if (s.size() >= kFewestLatencies) fit.bound_ns = std::max(fit.bound_ns, bound_of(s, options));
  fit.recommended_ns = round_latency_up(fit.bound_ns + 2 * options.sigma_ns);
  return fit;
}

}  // namespace rigor::calibration
