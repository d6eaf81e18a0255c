// Periods of rates: no drift, each instant the nearest nanosecond, indices the inverse of instants, and text.
#include "rt-core/period.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace rigor {
namespace {

using testing::HasSubstr;

__extension__ typedef __int128 Int128;  // NOLINT: `using` has no place for the word

constexpr std::int64_t kTenYears_ns = 3653LL * 86400 * 1'000'000'000;

struct Ratio {
  std::int64_t num, den;
};
std::vector<Ratio> rates() {
  std::vector<Ratio> all{{30, 1},        {60, 1},
                         {15, 1},        {2997, 100},
                         {60000, 1001},  {24000, 1001},
                         {1000, 1},      {960, 1},
                         {7, 1},         {1, 3},
                         {1'000'000, 1}, {999'983, 7919},
                         {1, 1'000'000}, {123'456'789, 1000},
                         {20'000, 3},    {999'999'937, 1'000'003}};
  std::mt19937_64 random(1);
  for (int i = 0; i < 200; ++i) {
    const auto den = static_cast<std::int64_t>(random() % 1'000'000 + 1);
    all.push_back(
        {static_cast<std::int64_t>(random() % 100'000 * static_cast<std::uint64_t>(den) / 10 + 1), den});
  }
  return all;
}

TEST(Period, PutsEachInstantOnItsNearestNanosecondTenYearsOn) {
  std::mt19937_64 random(2);
  for (const Ratio r : rates()) {
    const Period p = Period::of_rate(r.num, r.den);
    const auto most = static_cast<std::int64_t>(Int128(kTenYears_ns) * r.num / r.den / 1'000'000'000);
    for (int i = 0; i < 200; ++i) {
      const std::int64_t k =
          i == 0 ? most : static_cast<std::int64_t>(random() % static_cast<std::uint64_t>(most + 1));
      // |2 (instant·num − k·den·10⁹)| ≤ num, and a tie only upwards: by the definition, not by the code.
      const auto twice_off =
          static_cast<std::int64_t>(2 * (Int128((p * k).ns()) * r.num - Int128(k) * r.den * 1'000'000'000));
      ASSERT_LE(twice_off, r.num) << rate_text(p) << " at " << k;
      ASSERT_GT(twice_off, -r.num) << rate_text(p) << " at " << k;
    }
  }
}

TEST(Period, InstantsIncreaseByTheNominalPeriodToWithinANanosecond) {
  std::mt19937_64 random(3);
  for (const Ratio r : rates()) {
    const Period p = Period::of_rate(r.num, r.den);
    const auto most = static_cast<std::int64_t>(Int128(kTenYears_ns) * r.num / r.den / 1'000'000'000);
    const auto from = static_cast<std::int64_t>(random() % static_cast<std::uint64_t>(most + 1));
    for (std::int64_t k = from; k < from + 500; ++k) {
      const Duration step = p * (k + 1) - p * k;
      ASSERT_GT(step.ns(), 0);
      ASSERT_LE(std::abs(step.ns() - p.ns()), 1) << rate_text(p) << " at " << k;
    }
  }
}

TEST(Period, IndicesAreTheInverseOfInstants) {
  std::mt19937_64 random(4);
  for (const Ratio r : rates()) {
    const Period p = Period::of_rate(r.num, r.den);
    const auto most = static_cast<std::int64_t>(Int128(kTenYears_ns) * r.num / r.den / 1'000'000'000);
    for (int i = 0; i < 100; ++i) {
      auto k = static_cast<std::int64_t>(random() % static_cast<std::uint64_t>(most + 1));
      if (i % 2 == 1) k = -k;
      const Duration t = p * k;
      ASSERT_EQ(t / p, k) << rate_text(p);
      ASSERT_EQ((t - nanoseconds(1)) / p, k - 1) << rate_text(p);
      ASSERT_EQ(p.nearest_index(t), k) << rate_text(p);
      if (p.ns() > 4) {
        ASSERT_EQ(p.nearest_index(t + p / 2 - nanoseconds(1)), k) << rate_text(p);
      }
      ASSERT_EQ(p.first_index_from(t), std::max<std::int64_t>(k, 0)) << rate_text(p);
      ASSERT_EQ(p.first_index_from(t + nanoseconds(1)), std::max<std::int64_t>(k + 1, 0)) << rate_text(p);
    }
  }
}

TEST(Period, OfAWholeNumberOfNanosecondsCountsAsADurationDoes) {
  for (const std::int64_t ns : {1, 7, 1000, 50'000, 1'000'000, 40'000'000, 33'333'333}) {
    const Period p = nanoseconds(ns);
    const Period same = Period::of_rate(1'000'000'000, ns);
    EXPECT_TRUE(p.whole() && same.whole());
    EXPECT_TRUE(p.same_as(same));
    EXPECT_EQ(p.seconds(), Duration(ns).seconds());
    for (const std::int64_t k : {0LL, 1LL, 2LL, 999'999'999LL, -5LL}) EXPECT_EQ(p * k, Duration(ns) * k);
    for (const std::int64_t d : {0LL, 1LL, 39'999'999LL, 40'000'000LL, 123'456'789'012LL})
      EXPECT_EQ(Duration(d) / p, d / ns);
  }
  EXPECT_EQ(Period::of_rate(25), milliseconds(40));
  EXPECT_TRUE(Period::of_rate(25).whole());
  EXPECT_FALSE(Period::of_rate(30).whole());
}

TEST(Period, RoundsTiesToTheLaterInstant) {
  const Period p = Period::of_rate(400'000'000);  // 2.5 ns
  EXPECT_EQ((p * 1).ns(), 3);
  EXPECT_EQ((p * 3).ns(), 8);
  EXPECT_EQ((p * -1).ns(), -2);
  EXPECT_EQ(nanoseconds(3) / p, 1);
  EXPECT_EQ(nanoseconds(2) / p, 0);
}

TEST(Period, StaysAtTheEndsOfTimeBeyondThem) {
  const Period p = Period::of_rate(30);
  const std::int64_t k = std::numeric_limits<std::int64_t>::max();
  EXPECT_EQ((p * k).ns(), std::numeric_limits<std::int64_t>::max());
  EXPECT_EQ((p * -k).ns(), std::numeric_limits<std::int64_t>::min());
  const Period widest = Period::of_rate(999'999'999'999'999'999, 999'999'999'999'999'998);
  EXPECT_EQ((widest * 9'000'000'000).ns(), 9'000'000'000'000'000'000 - 9);
}

TEST(Period, ReadsRatesExactly) {
  const auto expect = [](const char* text, std::int64_t num, std::int64_t den) {
    const auto p = parse_rate(text);
    ASSERT_TRUE(p) << text << ": " << p.error().text();
    EXPECT_EQ(p->rate_num(), num) << text;
    EXPECT_EQ(p->rate_den(), den) << text;
    const auto again = parse_rate(rate_text(*p));
    ASSERT_TRUE(again) << rate_text(*p);
    EXPECT_TRUE(again->same_as(*p)) << rate_text(*p);
  };
  expect("30", 30, 1);
  expect("29.97", 2997, 100);
  expect("29.970", 2997, 100);
  expect("23.976", 2997, 125);  // as it is written, and not 24000/1001
  expect("60000/1001", 60000, 1001);
  expect(" 60000 / 1001 ", 60000, 1001);
  expect("30/1", 30, 1);
  expect("1e3", 1000, 1);
  expect("1.5E-1", 3, 20);
  expect("+2.5", 5, 2);
  expect("0x10", 16, 1);
  expect("0o17", 15, 1);
  expect(".5", 1, 2);
  expect("5.", 5, 1);
  expect("0.000000001", 1, 1'000'000'000);
  EXPECT_EQ(rate_text(Period::of_rate(2997, 100)), "29.97");
  EXPECT_EQ(rate_text(Period::of_rate(1, 20)), "0.05");
  EXPECT_EQ(rate_text(Period::of_rate(60000, 1001)), "60000/1001");
  EXPECT_EQ(rate_text(milliseconds(40)), "25");
}

TEST(Period, RefusesWhatIsNoRateAndSaysWhatToWrite) {
  for (const char* text : {"",
                           "fast",
                           "nan",
                           "inf",
                           "-30",
                           "0",
                           "0.0",
                           "30/0",
                           "0/5",
                           "-1/3",
                           "1/-3",
                           "1/2/3",
                           "1.5/2",
                           "30Hz",
                           "1e",
                           "1e300",
                           "1e-300",
                           "1e99999999999",
                           "2e9",
                           "/5",
                           "5/",
                           "0x",
                           "1234567890123456789",
                           "0.1234567890123456789",
                           "99999999999999999999/3",
                           "1e9999"}) {
    const auto p = parse_rate(text);
    ASSERT_FALSE(p) << text;
    EXPECT_EQ(p.error().code, ErrorCode::bad_input) << text;
    EXPECT_THAT(p.error().message, HasSubstr("expected a rate")) << text;
    EXPECT_THAT(p.error().message, HasSubstr(std::string("got ") + (*text ? text : "nothing"))) << text;
    EXPECT_THAT(p.error().message, HasSubstr("; ")) << text;
  }
}

TEST(Period, FindsTheFractionThatADeviceSaysAsADouble) {
  for (const Ratio r : rates()) {
    const Period p = Period::of_rate(r.num, r.den), found = Period::of_hz(p.hz());
    EXPECT_EQ(found.hz(), p.hz()) << rate_text(p);
    EXPECT_EQ(found, p) << rate_text(p);
  }
  EXPECT_TRUE(Period::of_hz(60000.0 / 1001).same_as(Period::of_rate(60000, 1001)));
  EXPECT_TRUE(Period::of_hz(29.97).same_as(Period::of_rate(2997, 100)));
  EXPECT_TRUE(Period::of_hz(1 / 0.03).same_as(milliseconds(30)));
}

}  // namespace
}  // namespace rigor
