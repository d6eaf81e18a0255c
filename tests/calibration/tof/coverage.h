// Whether stated uncertainties are true: over many seeds, by the chi-squared and the binomial distribution.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <vector>

#include "calibration/core/chi_squared.h"
#include "calibration/core/fit_result.h"

namespace rigor::calibration {

/// RIGOR_TEST_SEEDS=1000: a sharper look, by hand.
inline const std::uint64_t kSeeds =
    std::getenv("RIGOR_TEST_SEEDS") ? std::strtoull(std::getenv("RIGOR_TEST_SEEDS"), nullptr, 10) : 100;

/// Collects the errors of fits whose truth is known.
class Coverage {
 public:
  /// Of parameters whose uncertainties are finite.
  void add(const FitResult& fit, const std::vector<std::pair<std::string, double>>& truth) {
    const auto n = static_cast<Eigen::Index>(truth.size());
    Eigen::VectorXd e(n);
    Eigen::MatrixXd c(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto& [name, value] = truth[static_cast<std::size_t>(i)];
      const int at = fit.index_of(name);
      ASSERT_GE(at, 0) << name;
      e[i] = fit.parameters[static_cast<std::size_t>(at)].value - value;
      for (Eigen::Index j = 0; j < n; ++j)
        c(i, j) = fit.covariance(at, fit.index_of(truth[static_cast<std::size_t>(j)].first));
      ASSERT_TRUE(std::isfinite(c(i, i)) && c(i, i) > 0) << name;
      inside_ += std::abs(e[i]) < 1.959964 * std::sqrt(c(i, i));
      ++intervals_;
      const double z = e[i] / std::sqrt(c(i, i));
      if (by_name_.size() <= static_cast<std::size_t>(i)) by_name_.push_back({name, 0, 0});
      by_name_[static_cast<std::size_t>(i)].sum += z;
      by_name_[static_cast<std::size_t>(i)].squares += z * z;
    }
    // In units of the uncertainties: the parameters have very different ones.
    const Eigen::VectorXd s = c.diagonal().cwiseSqrt().cwiseInverse();
    const Eigen::MatrixXd unit = s.asDiagonal() * c * s.asDiagonal();
    const Eigen::VectorXd z = s.asDiagonal() * e;
    chi_ += z.dot(unit.ldlt().solve(z));
    const Eigen::VectorXd own = unit.llt().matrixL().solve(z);
    for (Eigen::Index i = 0; i < n; ++i) own_inside_ += std::abs(own[i]) < 1.959964;
    freedom_ += static_cast<double>(n);
    ++fits_;
  }
  /// Both at 0.001, two-sided. The binomial distribution is that of intervals that go their own ways: where
  /// `together` (coefficients of one curve, which share their errors), the intervals are those of the
  /// parameters' independent combinations (Cholesky).
  void expect_true(bool together = false) const {
    std::string all;
    for (const auto& n : by_name_) {
      char text[160];
      std::snprintf(text, sizeof text, "%s: mean %.2f, RMS %.2f standard uncertainties; ", n.name.c_str(),
                    n.sum / fits_, std::sqrt(n.squares / fits_));
      all += text;
    }
    EXPECT_GT(chi_, chi_squared_quantile(0.0005, freedom_)) << all;
    EXPECT_LT(chi_, chi_squared_quantile(0.9995, freedom_)) << all;
    const double p = 0.95, n = intervals_;
    const double away = 3.2905 * std::sqrt(n * p * (1 - p)) + 0.5;
    EXPECT_NEAR(together ? own_inside_ : inside_, n * p, away) << all;
    std::printf("[ coverage ] %d fits, chi-squared %.1f of %.0f, inside %d (of combinations %d) of %d; %s\n",
                fits_, chi_, freedom_, static_cast<int>(inside_), static_cast<int>(own_inside_),
                static_cast<int>(intervals_), all.c_str());
  }

 private:
  struct Name {
    std::string name;
    double sum, squares;
  };
  std::vector<Name> by_name_;
  double inside_ = 0, own_inside_ = 0, intervals_ = 0, chi_ = 0, freedom_ = 0;
  int fits_ = 0;
};

}  // namespace rigor::calibration
