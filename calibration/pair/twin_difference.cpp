#include "calibration/pair/twin_difference.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "rt-core/numbers.h"

namespace rigor::calibration {
namespace {

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

/// Quantile of numbers that were rounded to multiples of `step`: each stands for all within half a step.
double grouped_quantile(const std::vector<double>& sorted, double q, double step) {
  const double v = quantile(sorted, q);
  if (!(step > 0) || sorted.empty()) return v;
  const double at = step * std::round(v / step);
  const auto first = std::lower_bound(sorted.begin(), sorted.end(), at - step / 2);
  const auto last = std::lower_bound(first, sorted.end(), at + step / 2);
  const double below = static_cast<double>(first - sorted.begin()), n = static_cast<double>(last - first);
  if (!(n > 0)) return v;
  return at + step * ((q * static_cast<double>(sorted.size()) - below) / n - 0.5);
}

/// Standard deviation of a normal distribution with this middle half.
double spread(const std::vector<double>& sorted, double step) {
  return (grouped_quantile(sorted, 0.75, step) - grouped_quantile(sorted, 0.25, step)) / 1.3489795;
}

/// Covariance of the means over samples of (a, b, c), and of c/b as the fourth, by batch means.
Eigen::Matrix4d covariance_of(const std::vector<std::array<double, 3>>& each) {
  const std::size_t n = each.size() > 0 ? each.size() - 1 : 0;  // the first has no sample before it
  const Eigen::Matrix4d nothing = Eigen::Vector4d::Constant(INFINITY).asDiagonal();
  if (n < 8) return nothing;
  const std::size_t batches = std::clamp<std::size_t>(n / 4, 4, 20);
  std::vector<Eigen::Vector4d> means(batches, Eigen::Vector4d::Zero());
  Eigen::Vector4d mean = Eigen::Vector4d::Zero();
  for (std::size_t k = 0; k < batches; ++k) {
    const std::size_t from = 1 + k * n / batches, to = 1 + (k + 1) * n / batches;
    for (std::size_t i = from; i < to; ++i)
      for (int c = 0; c < 3; ++c)
        means[k][c] += each[i][static_cast<std::size_t>(c)] / static_cast<double>(to - from);
    means[k][3] = means[k][1] > 0 ? means[k][2] / means[k][1] : 0;
    mean += means[k] / static_cast<double>(batches);
  }
  if (!mean.allFinite()) return nothing;
  Eigen::Matrix4d scatter = Eigen::Matrix4d::Zero();
  for (const auto& m : means) scatter += (m - mean) * (m - mean).transpose();
  return scatter / static_cast<double>(batches * (batches - 1));
}

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

TwinComparer::Values TwinComparer::sorted_values(std::span<const TwinElement> sample) {
  Values v;
  v.reserve(sample.size());
  for (const auto& e : sample)
    if (std::isfinite(e.value)) v.push_back(e);
  const auto by_key = [](const TwinElement& a, const TwinElement& b) { return a.key < b.key; };
  if (!std::is_sorted(v.begin(), v.end(), by_key)) std::sort(v.begin(), v.end(), by_key);
  return v;
}

double TwinComparer::noise(const Values& before, const Values& now, Thinned& into) const {
  std::vector<double> change;
  auto a = before.begin();
  for (const auto& [key, value] : now) {
    while (a != before.end() && a->key < key) ++a;
    if (a == before.end()) break;
    if (a->key == key) change.push_back(value - a->value);
  }
  for (const double d : change) into.add(d / std::sqrt(2.0));
  return spread(sorted(std::move(change)), step_) / std::sqrt(2.0);
}

void TwinComparer::add(std::span<const TwinElement> real, std::span<const TwinElement> simulated) {
  Values r = sorted_values(real), s = sorted_values(simulated);
  auto a = r.begin();
  double sum = 0, both = 0;
  for (const auto& [key, value] : s) {
    while (a != r.end() && a->key < key) ++a, ++only_real_;
    if (a == r.end() || a->key != key) {
      ++only_simulated_;
      continue;
    }
    const double d = value - a->value;
    ++a, ++elements_;
    sum += d, ++both;
    sum_ += d, squares_ += d * d;
    differences_.add(d);
  }
  only_real_ += static_cast<std::uint64_t>(std::distance(a, r.end()));
  std::array<double, 3> each{both > 0 ? sum / both : kNaN, kNaN, kNaN};
  if (samples_++ > 0) {
    each[1] = noise(real_, r, real_noise_);
    each[2] = noise(simulated_, s, simulated_noise_);
  }
  each_.push_back(each);
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
  const double step = step_ / std::sqrt(2.0);
  t.real_noise = spread(r, step), t.simulated_noise = spread(s, step);
  t.covariance = covariance_of(each_);
  t.noise_distance = distance(r, s);
  t.differences = few(d), t.real_noise_sorted = few(r), t.simulated_noise_sorted = few(s);
  return t;
}

}  // namespace rigor::calibration
