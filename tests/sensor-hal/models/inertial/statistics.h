// Limits for counts and means, at 0.001 two-sided.
#pragma once

#include <gtest/gtest.h>

#include <cmath>

namespace rigor::models::test {

inline constexpr double kLimit = 3.29;  // of the standard normal

/// That `hits` of `n` independent trials happen with probability p, by the normal approximation.
inline void expect_share(int hits, int n, double p, const char* what) {
  const double sigma = std::sqrt(n * p * (1 - p));
  EXPECT_NEAR(hits, n * p, kLimit * sigma + 0.5) << what << ": " << hits << " of " << n;
}

/// Mean and its standard error.
class Mean {
 public:
  void add(double v) {
    ++n_;
    const double d = v - mean_;
    mean_ += d / n_;
    squares_ += d * (v - mean_);
  }
  [[nodiscard]] double mean() const { return mean_; }
  [[nodiscard]] double error() const { return std::sqrt(squares_ / (n_ - 1) / n_); }

 private:
  int n_ = 0;
  double mean_ = 0, squares_ = 0;
};
inline void expect_mean(const Mean& m, double expected, const char* what) {
  EXPECT_NEAR(m.mean(), expected, kLimit * m.error()) << what;
}

}  // namespace rigor::models::test
