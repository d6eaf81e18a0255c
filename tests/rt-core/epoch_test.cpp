#include "rt-core/epoch.h"

#include <gtest/gtest.h>

#include <ctime>

namespace rigor {
namespace {

TEST(Epoch, VirtualRunsBeginWithTheYear2020) {
  std::tm date{};
  date.tm_year = 2020 - 1900;
  date.tm_mday = 1;
  EXPECT_EQ(kVirtualEpoch.utc.ns(), static_cast<std::int64_t>(timegm(&date)) * 1'000'000'000);
  EXPECT_EQ(kVirtualEpoch.to_utc(BenchTime(5)).ns(), kVirtualEpoch.utc.ns() + 5);
  EXPECT_EQ(kVirtualEpoch.to_bench(kVirtualEpoch.to_utc(BenchTime(7))).ns(), 7);
}

TEST(Epoch, WallPairIsWithinItsUncertaintyOfAnotherOne) {
  const EpochPair a = read_epoch();
  const EpochPair b = read_epoch();
  EXPECT_GT(a.sigma.ns(), 0);
  EXPECT_LT(a.sigma, milliseconds(1));
  // NTP slews by at most 500 ppm; the two pairs are at most some ms apart.
  const double error = static_cast<double>((a.to_utc(b.bench) - b.utc).ns());
  EXPECT_LT(std::abs(error), 6 * static_cast<double>((a.sigma + b.sigma).ns()) + 50'000);
}

}  // namespace
}  // namespace rigor
