// Distributions of numbers of a topic in bounded memory: what `rigor check` takes for usual.
#pragma once

#include <cmath>
#include <cstdint>
#include <map>

namespace rigor {

/// Counts of numbers in bins of 1 % width, negative ones mirrored; numbers below `smallest` share the bin of
/// 0. Quantiles are the mean of their bin: exact where all numbers of a bin are the same.
class LogHistogram {
 public:
  explicit LogHistogram(double smallest) : smallest_(smallest) {}
  void add(double v) {
    if (!std::isfinite(v)) return;
    Bin& bin = bins_[place(v)];
    ++bin.count;
    bin.sum += v;
    ++total_;
  }
  [[nodiscard]] std::uint64_t total() const { return total_; }
  /// NaN where there are no numbers.
  [[nodiscard]] double quantile(double share) const {
    auto left = static_cast<std::uint64_t>(share * static_cast<double>(total_));
    for (const auto& [at, bin] : bins_) {
      if (left < bin.count) return bin.sum / static_cast<double>(bin.count);
      left -= bin.count;
    }
    return bins_.empty() ? std::nan("")
                         : bins_.rbegin()->second.sum / static_cast<double>(bins_.rbegin()->second.count);
  }
  [[nodiscard]] double median() const { return quantile(0.5); }
  /// How many lie within `tolerance` · v of v, to the width of a bin.
  [[nodiscard]] std::uint64_t near(double v, double tolerance) const {
    std::uint64_t n = 0;
    for (const auto& [at, bin] : bins_)
      if (std::abs(bin.sum / static_cast<double>(bin.count) - v) <= tolerance * std::abs(v)) n += bin.count;
    return n;
  }

 private:
  struct Bin {
    std::uint64_t count = 0;
    double sum = 0;
  };
  [[nodiscard]] int place(double v) const {
    const double size = std::abs(v) / smallest_;
    if (!(size > 1)) return 0;
    // 1 % steps; a double has 71 000 of them at most.
    const int at = 1 + static_cast<int>(std::log(size) / 0.01);
    return v < 0 ? -at : at;
  }
  double smallest_;
  std::uint64_t total_ = 0;
  std::map<int, Bin> bins_;
};

}  // namespace rigor
