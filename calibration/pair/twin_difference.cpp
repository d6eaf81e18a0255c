#include "calibration/pair/twin_difference.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rigor::calibration {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

double quantile(const std::vector<double>& sorted, double q) {
  if (sorted.empty()) return kNaN;
  const double at = q * static_cast<double>(sorted.size() - 1);
  const auto i = static_cast<std::size_t>(at);
  const double next = i + 1 < sorted.size() ? sorted[i + 1] : sorted[i];
  return sorted[i] + (at - static_cast<double>(i)) * (next - sorted[i]);
}

std::vector<double> sorted(std::vector<double> x) {
  std::sort(x.begin(), x.end());
  return x;
}

/// Standard deviation of a normal distribution with this middle half.
double spread(const std::vector<double>& x) { return (quantile(x, 0.75) - quantile(x, 0.25)) / 1.3489795; }

std::vector<double> few(const std::vector<double>& x) {
  constexpr std::size_t kMost = 4096;
  if (x.size() <= kMost) return x;
  std::vector<double> out;
  for (std::size_t i = 0; i < kMost; ++i) out.push_back(x[i * (x.size() - 1) / (kMost - 1)]);
  return out;
}

double distance(const std::vector<double>& a, const std::vector<double>& b) {
  if (a.empty() || b.empty()) return kNaN;
  double worst = 0;
  std::size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    // Equal values (whole numbers) move both sides before they are compared.
    const double x = std::min(a[i], b[j]);
    while (i < a.size() && a[i] <= x) ++i;
    while (j < b.size() && b[j] <= x) ++j;
    worst = std::max(worst, std::abs(static_cast<double>(i) / static_cast<double>(a.size()) -
                                     static_cast<double>(j) / static_cast<double>(b.size())));
  }
  return worst;
}

}  // namespace

void TwinComparer::Thinned::add(double x) {
  if (seen_++ % every_ == 0) values_.push_back(x);
  if (values_.size() < std::size_t{1} << 17) return;
  for (std::size_t i = 0; 2 * i < values_.size(); ++i) values_[i] = values_[2 * i];
  values_.resize(values_.size() / 2);
  every_ *= 2;
}

void TwinComparer::noise(const Values& before, const Values& now, Thinned& into) {
  auto a = before.begin();
  for (const auto& [key, value] : now) {
    while (a != before.end() && a->first < key) ++a;
    if (a == before.end()) return;
    if (a->first == key) into.add((value - a->second) / std::sqrt(2.0));
  }
}

void TwinComparer::add(std::span<const TwinElement> real, std::span<const TwinElement> simulated) {
  Values r, s;
  for (const auto& e : real)
    if (std::isfinite(e.value)) r.emplace_hint(r.end(), e.key, e.value);
  for (const auto& e : simulated)
    if (std::isfinite(e.value)) s.emplace_hint(s.end(), e.key, e.value);
  auto a = r.begin();
  for (const auto& [key, value] : s) {
    while (a != r.end() && a->first < key) ++a, ++only_real_;
    if (a == r.end() || a->first != key) {
      ++only_simulated_;
      continue;
    }
    const double d = value - a->second;
    ++a, ++elements_;
    sum_ += d, squares_ += d * d;
    differences_.add(d);
  }
  only_real_ += static_cast<std::uint64_t>(std::distance(a, r.end()));
  if (samples_++ > 0) {
    noise(real_, r, real_noise_);
    noise(simulated_, s, simulated_noise_);
  }
  real_ = std::move(r), simulated_ = std::move(s);
}

TwinDifference TwinComparer::result() const {
  TwinDifference t;
  t.samples = samples_, t.elements = elements_;
  t.only_real = only_real_, t.only_simulated = only_simulated_;
  const double n = static_cast<double>(elements_);
  t.bias = elements_ > 0 ? sum_ / n : kNaN;
  t.rms = elements_ > 0 ? std::sqrt(squares_ / n) : kNaN;
  const auto d = sorted(differences_.values());
  t.q05 = quantile(d, 0.05), t.q25 = quantile(d, 0.25), t.median = quantile(d, 0.5),
  t.q75 = quantile(d, 0.75), t.q95 = quantile(d, 0.95);
  const auto r = sorted(real_noise_.values()), s = sorted(simulated_noise_.values());
  t.real_noise = spread(r), t.simulated_noise = spread(s);
  t.noise_distance = distance(r, s);
  t.differences = few(d), t.real_noise_sorted = few(r), t.simulated_noise_sorted = few(s);
  return t;
}

}  // namespace rigor::calibration
