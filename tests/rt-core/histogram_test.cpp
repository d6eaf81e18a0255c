#include "rt-core/histogram.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace rigor {
namespace {

TEST(Histogram, IsExactBelow64ns) {
  for (std::int64_t v = 0; v < 64; ++v) {
    Histogram h;
    h.record(Duration(v));
    h.record(Duration(1'000'000));
    EXPECT_EQ(h.percentile(0.5).ns(), v);
  }
}

TEST(Histogram, KeepsItsErrorBoundOverTheWholeRange) {
  std::mt19937_64 rng(1);
  double worst = 0;
  for (int bits = 6; bits < 63; ++bits) {
    for (int i = 0; i < 200; ++i) {
      const auto v =
          static_cast<std::int64_t>((std::uint64_t{1} << bits) | (rng() & ((std::uint64_t{1} << bits) - 1)));
      Histogram h;
      h.record(Duration(v));
      h.record(Duration(v));
      h.record(Duration(std::numeric_limits<std::int64_t>::max()));
      h.record(Duration(0));
      const double got = static_cast<double>(h.percentile(0.75).ns());
      worst = std::max(worst, std::abs(got - static_cast<double>(v)) / static_cast<double>(v));
    }
  }
  EXPECT_LE(worst, Histogram::kRelativeError);
  EXPECT_GT(worst, Histogram::kRelativeError / 3) << "the bound should not be loose either";
}

TEST(Histogram, PercentilesAreThoseOfTheSortedValues) {
  std::mt19937_64 rng(2);
  std::lognormal_distribution<double> d(10, 2);
  std::vector<std::int64_t> values;
  Histogram h;
  for (int i = 0; i < 50'000; ++i) {
    values.push_back(static_cast<std::int64_t>(d(rng)));
    h.record(Duration(values.back()));
  }
  std::sort(values.begin(), values.end());
  for (const double p : {0.0, 0.01, 0.5, 0.9, 0.99, 0.999, 1.0}) {
    const auto rank = std::max<std::size_t>(1, static_cast<std::size_t>(std::ceil(p * 50'000)));
    const double exact = static_cast<double>(values[rank - 1]);
    EXPECT_NEAR(static_cast<double>(h.percentile(p).ns()), exact, exact * Histogram::kRelativeError + 0.5)
        << p;
  }
  EXPECT_EQ(h.min().ns(), values.front());
  EXPECT_EQ(h.max().ns(), values.back());
}

TEST(Histogram, MergingIsRecordingIntoOne) {
  Histogram a, b, both;
  std::mt19937_64 rng(3);
  for (int i = 0; i < 1000; ++i) {
    const Duration v(static_cast<std::int64_t>(rng() % 1'000'000));
    (i % 3 ? a : b).record(v);
    both.record(v);
  }
  a.merge(b);
  EXPECT_EQ(a.count(), both.count());
  EXPECT_EQ(a.min(), both.min());
  EXPECT_EQ(a.max(), both.max());
  EXPECT_DOUBLE_EQ(a.mean_ns(), both.mean_ns());
  for (double p = 0; p <= 1; p += 0.05) EXPECT_EQ(a.percentile(p), both.percentile(p));
  std::uint64_t drawn = 0;
  a.for_each([&](Duration lower, Duration upper, std::uint64_t n) {
    EXPECT_LT(lower, upper);
    drawn += n;
  });
  EXPECT_EQ(drawn, a.count());
}

TEST(Histogram, EmptyAndNegative) {
  Histogram h;
  EXPECT_EQ(h.percentile(0.5).ns(), 0);
  EXPECT_EQ(h.min().ns(), 0);
  h.record(Duration(-5));
  EXPECT_EQ(h.below_zero(), 1u);
  EXPECT_EQ(h.percentile(1).ns(), 0);
}

}  // namespace
}  // namespace rigor
