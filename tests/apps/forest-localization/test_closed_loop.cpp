// The whole application: 200 m through a forest of discs, undisturbed and with everything that goes wrong.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <new>

#include "tests/apps/forest-localization/closed_loop.h"

namespace rigor::forest::test {
thread_local bool watching = false;
thread_local std::size_t allocations = 0;
}  // namespace rigor::forest::test

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wmismatched-new-delete"  // inlined in parts, these two look like strangers
#endif
void* operator new(std::size_t size) {
  if (rigor::forest::test::watching) ++rigor::forest::test::allocations;
  if (void* p = std::malloc(size ? size : 1)) return p;
  throw std::bad_alloc();
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

namespace rigor::forest {
namespace {

using test::LoopOptions;
using test::LoopResult;

LoopResult run(const char* what, const LoopOptions& options) {
  const LoopResult r = test::run_loop(options);
  std::printf("%-28s %5.1f m in %5.1f s: error median %5.1f, p95 %5.1f, worst %6.1f mm; end %5.1f mm off%s\n",
              what, r.driven_m, r.elapsed_s, 1e3 * r.quantile(0.5), 1e3 * r.quantile(0.95),
              1e3 * r.quantile(1), 1e3 * r.end_error_m, r.done ? "" : ", NOT DONE");
  EXPECT_EQ(r.allocations, 0u) << what;
  return r;
}
/// Arrived, and never far from where it believed to be.
void expect_good(const LoopResult& r, double p95_m, double worst_m) {
  EXPECT_TRUE(r.done);
  EXPECT_LT(r.end_error_m, 0.3);
  EXPECT_GT(r.driven_m, 180);
  EXPECT_LT(r.quantile(0.95), p95_m);
  EXPECT_LT(r.quantile(1), worst_m);
}

TEST(ForestLoop, Drives200MetresAndStopsAtTheEnd) {
  for (unsigned seed = 1; seed <= 3; ++seed) expect_good(run("undisturbed", {.seed = seed}), 0.06, 0.2);
}
TEST(ForestLoop, DoesSoWithoutAnInertialUnit) { expect_good(run("no imu", {.imu = false}), 0.08, 0.3); }
TEST(ForestLoop, LivesWithAFifthOfAllScansLostAndPointsThatAreNone) {
  expect_good(run("20 % of scans lost, 5 % NaN", {.scan_loss = 0.2, .nan_share = 0.05}), 0.08, 0.3);
}
TEST(ForestLoop, LivesWithWheelsThatSlip) {
  expect_good(run("slips", {.slips_per_s = 0.1}), 0.15, 0.6);
  expect_good(run("slips, no imu", {.seed = 2, .imu = false, .slips_per_s = 0.1}), 0.2, 0.8);
}
TEST(ForestLoop, LivesWithOutagesOfOdometryAndOfScans) {
  expect_good(run("odometry out for 3 s", {.odometry_out_from_s = 60, .odometry_out_for_s = 3}), 0.1, 0.6);
  expect_good(run("scans out for 4 s", {.scans_out_from_s = 60, .scans_out_for_s = 4}), 0.1, 0.8);
}
TEST(ForestLoop, FindsItselfAgainWhenItIsCarriedAway) {
  const LoopResult r = run("kidnapped at 60 s", {.kidnap_at_s = 60, .max_s = 90});
  std::printf("found again after %.2f s\n", r.found_after_s);
  EXPECT_GT(r.found_after_s, 0);
  EXPECT_LT(r.found_after_s, 5);
  const LoopResult g = run("kidnapped, with receiver", {.kidnap_at_s = 60, .with_gnss = true, .max_s = 90});
  std::printf("found again after %.2f s\n", g.found_after_s);
  EXPECT_GT(g.found_after_s, 0);
  EXPECT_LT(g.found_after_s, 5);
}
TEST(ForestLoop, BeginsWithoutAPose) { expect_good(run("no start", {.with_start = false}), 0.08, 0.3); }
TEST(ForestLoop, StandsWhereThereIsNothingToSee) {
  const LoopResult r = run("no stems nearby", {.scans_out_from_s = 20, .scans_out_for_s = 1e9, .max_s = 120});
  EXPECT_FALSE(r.done);
  EXPECT_EQ(r.worst_lost_speed_mps, 0);
  EXPECT_LT(r.driven_m, 120);
}

}  // namespace
}  // namespace rigor::forest
