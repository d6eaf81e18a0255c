#include "calibration/latency/latency_fit.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

#include "calibration/latency/order_statistics.h"

namespace rigor::calibration {
namespace {

constexpr double kMs = 1e6;
using Draw = std::function<double(std::mt19937_64&)>;

std::vector<std::int64_t> draw(const Draw& one, std::size_t n, std::mt19937_64& random) {
  std::vector<std::int64_t> v;
  for (std::size_t i = 0; i < n; ++i) v.push_back(static_cast<std::int64_t>(std::llround(one(random))));
  return v;
}
LatencyFit fit_of(std::vector<LatencyPart> parts, const LatencyOptions& options = {}) {
  const auto fit = fit_latency(parts, options);
  EXPECT_TRUE(fit) << fit.error().text();
  return fit.value_or(LatencyFit{});
}
/// Share of `trials` recordings whose bound is at or above the true quantile.
double coverage(const Draw& one, double true_quantile_ns, std::size_t n, const LatencyOptions& options,
                LatencyBound method) {
  std::mt19937_64 random(7);
  int good = 0;
  constexpr int kTrials = 4000;
  for (int i = 0; i < kTrials; ++i) {
    const LatencyFit fit = fit_of({{"", draw(one, n, random)}}, options);
    EXPECT_EQ(fit.method, method);
    good += static_cast<double>(fit.bound_ns) >= true_quantile_ns;
  }
  return good / static_cast<double>(kTrials);
}
/// Four standard deviations of a share of 4000.
double spread(double share) { return 4 * std::sqrt(share * (1 - share) / 4000); }

double exponential(std::mt19937_64& r) { return 5 * kMs + std::exponential_distribution<>(1 / kMs)(r); }
double uniform(std::mt19937_64& r) { return std::uniform_real_distribution<>(0, 10 * kMs)(r); }
/// One in fifty is resent and comes 20 ms later.
double resent(std::mt19937_64& r) {
  return exponential(r) + (std::bernoulli_distribution(0.02)(r) ? 20 * kMs : 0);
}
double cauchy(std::mt19937_64& r) { return std::abs(std::cauchy_distribution<>(0, kMs)(r)); }

TEST(LatencyFit, TheBoundCoversTheQuantileOfAnyDistributionAsOftenAsItSays) {
  const LatencyOptions o{.quantile = 0.99, .confidence = 0.95};
  constexpr std::size_t kSamples = 600;
  // As often as the rank does, which is a whole number and so covers a little more than was asked for.
  double exact = 0;
  const std::size_t above = kSamples - *upper_rank(kSamples, o.quantile, o.confidence);
  for (double k = 0; k <= static_cast<double>(above); k += 1)
    exact += std::exp(std::lgamma(601.0) - std::lgamma(k + 1) - std::lgamma(601.0 - k) + k * std::log(0.01) +
                      (600 - k) * std::log(0.99));
  exact = 1 - exact;
  ASSERT_GE(exact, o.confidence);
  const auto test = [&](const char* name, const Draw& one, double quantile_ns) {
    EXPECT_NEAR(coverage(one, quantile_ns, kSamples, o, LatencyBound::order_statistic), exact, spread(exact))
        << name;
  };
  test("exponential", exponential, (5 - std::log(0.01)) * kMs);
  test("uniform", uniform, 9.9 * kMs);
  test("cauchy", cauchy, std::tan(0.99 * M_PI / 2) * kMs);
  // P(X > 25 + y) = 0.02 e^-y for y > 0, and 0.98 e^-20 more: half of the resent lie above the quantile.
  test("resent", resent, (25 + std::log(2)) * kMs);
}

TEST(LatencyFit, OfTooFewSamplesTheTailIsExtrapolatedAndItSaysHowManyAreNeeded) {
  const LatencyOptions o{.quantile = 0.999, .confidence = 0.95};
  for (const std::size_t n : {20u, 100u, 1000u}) {
    const double covered =
        coverage(exponential, (5 - std::log(0.001)) * kMs, n, o, LatencyBound::exponential_tail);
    EXPECT_GT(covered, 0.95 - spread(0.95)) << n;
    EXPECT_LT(covered, 0.99) << n << ": wider than it says";
    // A lighter tail only makes it wider.
    EXPECT_GT(coverage(uniform, 9.99 * kMs, n, o, LatencyBound::exponential_tail), 0.99) << n;
  }
  std::mt19937_64 random(3);
  const LatencyFit few = fit_of({{"", draw(cauchy, 100, random)}}, o);
  EXPECT_EQ(few.samples_needed, 2995u);
  EXPECT_NEAR(few.proven_quantile, std::pow(0.05, 0.01), 1e-12);
  EXPECT_GE(few.bound_ns, few.max_ns);
}

TEST(LatencyFit, StatisticsAreThoseOfTheSamples) {
  std::vector<std::int64_t> v;
  for (int i = 1; i <= 4000; ++i) v.push_back(i * 1000);  // 1 µs … 4 ms
  std::shuffle(v.begin(), v.end(), std::mt19937_64(1));
  const LatencyFit fit = fit_of({{"", v}});
  EXPECT_EQ(fit.samples, 4000u);
  EXPECT_EQ(fit.p50_ns, 2'000'000);
  EXPECT_EQ(fit.p99_ns, 3'960'000);
  EXPECT_EQ(fit.p999_ns, 3'996'000);
  EXPECT_EQ(fit.max_ns, 4'000'000);
  EXPECT_EQ(fit.method, LatencyBound::order_statistic);
  EXPECT_EQ(fit.bound_ns, 1000 * static_cast<std::int64_t>(*upper_rank(4000, 0.999, 0.95)));
  EXPECT_LT(fit.p50_low_ns, 2'000'000);
  EXPECT_GT(fit.p50_high_ns, 2'000'000);
  EXPECT_GT(fit.p50_low_ns, 1'900'000);
  EXPECT_LT(fit.p50_high_ns, 2'100'000);
}

TEST(LatencyFit, TheRecommendationHasTheClocksUncertaintyAndIsRoundedUp) {
  const std::vector<std::int64_t> v(4000, 12'340'001);
  EXPECT_EQ(fit_of({{"", v}}).recommended_ns, 12'400'000);
  EXPECT_EQ(fit_of({{"", v}}, {.sigma_ns = 50'000}).recommended_ns, 12'500'000);
  EXPECT_EQ(round_latency_up(12'400'000), 12'400'000);
  EXPECT_EQ(round_latency_up(12'400'001), 12'500'000);
  EXPECT_EQ(round_latency_up(-5), 0);
}

TEST(LatencyFit, HalvesThatContradictEachOtherAreSaidAndTheSlowerOneCounts) {
  std::mt19937_64 random(11);
  auto v = draw(exponential, 4000, random);
  const LatencyFit before = fit_of({{"", v}});
  EXPECT_TRUE(before.stationary);
  ASSERT_EQ(before.parts.size(), 2u);
  for (std::size_t i = 2000; i < 4000; ++i) v[i] += static_cast<std::int64_t>(6 * kMs);
  const LatencyFit fit = fit_of({{"", v}});
  EXPECT_FALSE(fit.stationary);
  ASSERT_EQ(fit.parts.size(), 2u);
  EXPECT_EQ(fit.parts[0].name, "first half");
  EXPECT_LT(fit.parts[0].high_ns, fit.parts[1].low_ns);
  EXPECT_GE(fit.bound_ns, *std::max_element(v.begin(), v.end()));  // 2000 samples alone are too few for 0.999

  // Recordings are the parts where there are several.
  const LatencyFit two =
      fit_of({{"a.mcap", {v.begin(), v.begin() + 2000}}, {"b.mcap", {v.begin() + 2000, v.end()}}});
  EXPECT_FALSE(two.stationary);
  EXPECT_EQ(two.parts[1].name, "b.mcap");
}

TEST(LatencyFit, ChanceAndDriftsThatDoNotMatterAreNoContradiction) {
  std::mt19937_64 random(13);
  int contradictions = 0;
  for (int i = 0; i < 1000; ++i) contradictions += !fit_of({{"", draw(resent, 400, random)}}).stationary;
  EXPECT_LE(contradictions, 20);
  // 30 µs are told from 0 by so many samples, and matter to nobody.
  std::vector<std::int64_t> v;
  for (int i = 0; i < 20'000; ++i) v.push_back(10'000'000 + i % 7 + (i < 10'000 ? 0 : 30'000));
  EXPECT_TRUE(fit_of({{"", v}}).stationary);
}

TEST(LatencyFit, BadInputIsRefused) {
  const auto refused = [](std::vector<LatencyPart> parts, const LatencyOptions& o) {
    const auto fit = fit_latency(parts, o);
    EXPECT_FALSE(fit);
    return fit ? std::string() : fit.error().text();
  };
  const std::vector<std::int64_t> few(kFewestLatencies - 1, 1), enough(kFewestLatencies, 1);
  EXPECT_NE(refused({{"", few}}, {}).find("at least 20 samples, got 19"), std::string::npos);
  EXPECT_TRUE(fit_latency({{"", enough}}, {}));
  EXPECT_NE(refused({}, {}).find("got 0"), std::string::npos);
  for (const double bad : {0.0, 1.0, -1.0, std::nan("")}) {
    EXPECT_NE(refused({{"", enough}}, {.quantile = bad}).find("between 0 and 1"), std::string::npos);
    EXPECT_NE(refused({{"", enough}}, {.confidence = bad}).find("between 0 and 1"), std::string::npos);
  }
}

}  // namespace
}  // namespace rigor::calibration
