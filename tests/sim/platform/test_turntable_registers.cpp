// The turntable as its masters and its cameras see it.
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <thread>

#include "sim/platform/turntable.h"

namespace rigor {
namespace {

constexpr double kDeg = 0.017453292519943295;

class TurntableRegisters : public testing::Test {
 protected:
  static BenchTime at(double s) { return BenchTime(0) + seconds_from(s); }
  void write(std::uint16_t address, std::vector<std::uint16_t> values, double t) {
    ASSERT_TRUE(table_.write(RegisterTable::holding_registers, address, values, at(t)));
  }
  void write_s32(std::uint16_t address, std::int32_t v, double t) {
    const auto u = static_cast<std::uint32_t>(v);
    write(address, {static_cast<std::uint16_t>(u >> 16), static_cast<std::uint16_t>(u)}, t);
  }
  std::uint16_t input(std::uint16_t address, double t) {
    std::uint16_t r = 0;
    EXPECT_TRUE(table_.read(RegisterTable::input_registers, address, {&r, 1}, at(t)));
    return r;
  }
  std::int32_t input_s32(std::uint16_t address, double t) {
    std::uint16_t r[2];
    EXPECT_TRUE(table_.read(RegisterTable::input_registers, address, r, at(t)));
    return static_cast<std::int32_t>(std::uint32_t{r[0]} << 16 | r[1]);
  }
  Turntable table_{{.max_rate_radps = 90 * kDeg, .max_acceleration_radps2 = 180 * kDeg}};
};

TEST_F(TurntableRegisters, StandsStillUntilItIsEnabled) {
  write_s32(4, 30000, 1);
  EXPECT_EQ(input_s32(0, 5), 0);
  EXPECT_EQ(input(4, 5), 0);
  write(0, {1}, 6);
  EXPECT_EQ(input(4, 6.05) & 3, 3);
  // 30 deg/s at 180 deg/s²: 1/6 s of ramp over 2.5 deg.
  EXPECT_EQ(input_s32(0, 7), 2500 + 25000);
  EXPECT_EQ(input_s32(2, 7), 30000);
  EXPECT_EQ(input(4, 7), 1 | 2 | 4);
}

TEST_F(TurntableRegisters, MovesToAPositionAndSaysThatItIsThere) {
  write_s32(2, -45000, 0);
  write_s32(4, 60000, 0);
  write(0, {1, 1}, 0);
  EXPECT_EQ(input(4, 0.5) & 4, 0);
  EXPECT_LT(input_s32(2, 0.5), 0);
  EXPECT_EQ(input_s32(0, 10), -45000);
  EXPECT_EQ(input(4, 10), 1 | 4);
}

TEST_F(TurntableRegisters, BrakesWhenItsMasterIsSilentForLongerThanItsTimeout) {
  write(6, {500}, 0);
  write_s32(4, 36000, 0);
  write(0, {1}, 0);
  EXPECT_EQ(input(4, 0.45) & 3, 3);
  write(0, {1}, 0.45);  // the master lives
  EXPECT_EQ(input(4, 0.9) & 9, 1);
  EXPECT_NEAR(table_.motion_at(at(0.9)).joint[0].rate_radps, 36 * kDeg, 1e-9);
  // Silent since 0.45 s. Cameras see it brake from 0.95 s on at 180 deg/s², before anybody reads a register.
  EXPECT_NEAR(table_.motion_at(at(1.05)).joint[0].rate_radps, 18 * kDeg, 1e-6);
  EXPECT_EQ(table_.motion_at(at(1.2)).joint[0].rate_radps, 0);
  EXPECT_NEAR(table_.motion_at(at(0.9)).joint[0].rate_radps, 36 * kDeg, 1e-9);
  EXPECT_EQ(input(4, 2) & 11, 8) << "faulty, neither enabled nor moving";
  EXPECT_EQ(input(5, 2), 2);
  const auto rest = input_s32(0, 2);
  write(0, {1}, 3);
  EXPECT_EQ(input_s32(0, 4), rest) << "a master that returns has to disable it first";
  write(0, {0}, 4);
  write(0, {1}, 4);
  EXPECT_EQ(input(5, 4.2), 0);
  EXPECT_GT(input_s32(0, 4.4), rest);
}

TEST_F(TurntableRegisters, DisablingBrakesWithoutAStep) {
  write_s32(4, 90000, 0);
  write(0, {1}, 0);
  write(0, {0}, 2);
  EXPECT_EQ(input_s32(2, 2), 90000);
  EXPECT_EQ(input_s32(2, 2.25), 45000);
  EXPECT_EQ(input_s32(2, 2.5), 0);
  const auto held = input_s32(0, 2.5);
  EXPECT_EQ(held, 22500 + 135000 + 22500);
  EXPECT_EQ(input_s32(0, 86400), held);
}

TEST_F(TurntableRegisters, WhatTheMotorCannotDoIsLimitedAndSaid) {
  write_s32(4, 500000, 0);
  write(0, {1}, 0);
  EXPECT_EQ(input_s32(2, 5), 90000);
  EXPECT_EQ(input(4, 5) & 16, 16);
  write_s32(4, -2147483647 - 1, 6);
  EXPECT_EQ(input_s32(2, 10), -90000);
}

TEST_F(TurntableRegisters, ModeThatIsNoneIsAFaultThatDisablingClears) {
  write_s32(4, 30000, 0);
  write(0, {1, 0}, 0);
  write(1, {7}, 1);
  EXPECT_EQ(input(5, 1), 1);
  EXPECT_EQ(input(4, 3), 8);
  EXPECT_EQ(input_s32(2, 3), 0);
  write(1, {0}, 4);
  EXPECT_EQ(input(5, 4), 1);  // stays until disabled
  write(0, {0}, 5);
  write(0, {1}, 6);
  EXPECT_EQ(input(5, 6), 0);
  EXPECT_EQ(input_s32(2, 7), 30000);
}

TEST_F(TurntableRegisters, OtherAddressesDoNotExist) {
  std::array<std::uint16_t, 9> r{};
  EXPECT_FALSE(table_.read(RegisterTable::input_registers, 0, {r.data(), 9}, at(0)));
  EXPECT_FALSE(table_.read(RegisterTable::input_registers, 65535, {r.data(), 1}, at(0)));
  EXPECT_FALSE(table_.read(RegisterTable::coils, 0, {r.data(), 1}, at(0)));
  EXPECT_FALSE(table_.write(RegisterTable::holding_registers, 6, {r.data(), 2}, at(0)));
  EXPECT_FALSE(table_.write(RegisterTable::input_registers, 0, {r.data(), 1}, at(0)));
  EXPECT_TRUE(table_.read(RegisterTable::holding_registers, 0, {r.data(), 7}, at(0)));
}

TEST_F(TurntableRegisters, DaysLaterTheAngleIsExact) {
  write_s32(4, 10000, 0);
  write(0, {1}, 0);
  // 10 deg/s with 1/18 s of ramp: q(t) = 10·(t − 1/36) deg
  const double ten_days_s = 864000;
  const double exact_deg = 10 * (ten_days_s - 1.0 / 36);
  EXPECT_NEAR(table_.motion_at(at(ten_days_s)).joint[0].position_rad / kDeg, exact_deg, 1e-7);
  const auto counts = static_cast<std::int64_t>(std::llround(exact_deg * 1000));
  EXPECT_EQ(input_s32(0, ten_days_s), static_cast<std::int32_t>(static_cast<std::uint32_t>(counts)));
}

TEST_F(TurntableRegisters, AngleWithinTheTurnWraps) {
  write_s32(2, 179999, 0);
  write(0, {1, 1}, 0);
  EXPECT_EQ(input_s32(6, 20), 179999);
  write_s32(2, 180000, 20);
  EXPECT_EQ(input_s32(6, 30), -180000);
  EXPECT_EQ(input_s32(0, 30), 180000);
  write_s32(2, -540001, 30);
  EXPECT_EQ(input_s32(6, 60), 179999);
}

TEST_F(TurntableRegisters, MotionIsThatOfTheRegistersAndUniformAroundT) {
  write_s32(4, 45000, 0);
  write(0, {1}, 0);
  const auto m = table_.motion_at(at(0.1));
  ASSERT_EQ(m.count, 1u);
  EXPECT_NEAR(m.joint[0].at(at(0.1)) / kDeg, 0.9, 1e-9);
  EXPECT_NEAR(m.joint[0].rate_radps / kDeg, 18, 1e-9);
  const double ahead = m.joint[0].at(at(0.101)), exact = table_.motion_at(at(0.101)).joint[0].position_rad;
  EXPECT_NEAR(exact - ahead, 0.5 * 180 * kDeg * 1e-6, 1e-9);
}

TEST_F(TurntableRegisters, MotionBeforeTheLatestCommandIsWhatItWas) {
  write(0, {1}, 0);
  for (int i = 1; i <= 20; ++i) write_s32(4, i % 2 ? 20000 : -20000, i);
  std::vector<double> now;
  Turntable other({.max_rate_radps = 90 * kDeg, .max_acceleration_radps2 = 180 * kDeg});
  const std::uint16_t on = 1;
  ASSERT_TRUE(other.write(RegisterTable::holding_registers, 0, {&on, 1}, at(0)));
  for (int i = 1; i <= 20; ++i) {
    const double before = i - 0.5;
    EXPECT_EQ(table_.motion_at(at(before)).joint[0].position_rad,
              other.motion_at(at(before)).joint[0].position_rad)
        << i;
    const auto u = static_cast<std::uint32_t>(i % 2 ? 20000 : -20000);
    const std::uint16_t r[2] = {static_cast<std::uint16_t>(u >> 16), static_cast<std::uint16_t>(u)};
    ASSERT_TRUE(other.write(RegisterTable::holding_registers, 4, r, at(i)));
  }
}

TEST_F(TurntableRegisters, RepeatedCommandsStartNoNewProfile) {
  write_s32(4, 10000, 0);
  write(0, {1}, 0);
  for (int i = 1; i < 1000; ++i) write_s32(4, 10000, i * 0.001);
  // With a profile for each, the first one would be out of the history and 0.02 s would read as the start of
  // another.
  EXPECT_NEAR(table_.motion_at(at(0.02)).joint[0].position_rad / kDeg, 0.5 * 180 * 0.02 * 0.02, 1e-9);
}

// Commands move the table from rest to rest, in moves of 10 deg that are over before the next; each reader
// looks where the table rested a while ago. That no profile is half of another is Published's to prove, in
// its own test.
TEST_F(TurntableRegisters, ReadersSeeThePlaceOfTheirInstantWhileCommandsCome) {
  constexpr int kMoves = 200000, kBack = 40;
  std::atomic<bool> done{false};
  std::atomic<int> latest{0};
  std::atomic<int> wrong{0}, good{0};
  write(0, {1, 1}, 0);
  std::vector<std::thread> readers;
  for (int r = 0; r < 3; ++r)
    readers.emplace_back([&] {
      while (!done.load()) {
        const int n = latest.load();
        if (n <= kBack) continue;
        const double deg = table_.motion_at(at(10.0 * (n - kBack) + 9)).joint[0].position_rad / kDeg;
        const int moves = static_cast<int>(std::lround(deg / 10));
        // Beyond the history the oldest profile answers; within it the place must be the one of that instant.
        const bool in_reach = latest.load() - (n - kBack) < 60;
        (moves == n - kBack || (!in_reach && moves > n - kBack) ? good : wrong).fetch_add(1);
      }
    });
  for (int i = 1; i < kMoves; ++i) {
    write_s32(2, 10000 * i, 10.0 * i);
    latest.store(i);
  }
  done = true;
  for (auto& t : readers) t.join();
  EXPECT_EQ(wrong.load(), 0);
  EXPECT_GT(good.load(), 0);
}

}  // namespace
}  // namespace rigor
