// The turntable as a node on a bus: the same device as behind its registers.
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "sim/platform/turntable.h"

namespace rigor {
namespace {

std::size_t index_of(Turntable& t, const std::string& name) {
  for (std::size_t i = 0; i < t.signals().size(); ++i)
    if (t.signals()[i].name == name) return i;
  ADD_FAILURE() << "no signal " << name;
  return 0;
}
BenchTime at(double s) { return BenchTime(0) + seconds_from(s); }

TEST(TurntableSignals, ARateIsFollowedAndSeenInBothWays) {
  Turntable t;
  ASSERT_TRUE(t.write(index_of(t, "target_rate"), 18, at(0)));
  EXPECT_EQ(t.read(index_of(t, "rate"), at(0.5)), 0) << "not enabled yet";
  ASSERT_TRUE(t.write(index_of(t, "enable"), 1, at(1)));
  // 180 deg/s² up to 18 deg/s: 0.1 s and 0.9 deg, then uniform.
  EXPECT_NEAR(t.read(index_of(t, "rate"), at(1.05)), 9, 1e-9);
  EXPECT_NEAR(t.read(index_of(t, "position"), at(2.1)), 0.9 + 18, 1e-9);
  EXPECT_EQ(static_cast<int>(t.read(index_of(t, "status"), at(2.1))), 1 | 2 | 4);
  EXPECT_EQ(t.read(index_of(t, "target_rate"), at(2.1)), 18);
  std::array<std::uint16_t, 2> words{};
  ASSERT_TRUE(t.read(RegisterTable::input_registers, 0, words, at(2.1)));
  EXPECT_EQ((words[0] << 16 | words[1]), 18900);
}

TEST(TurntableSignals, APositionModeEndsAtTheTarget) {
  Turntable t;
  ASSERT_TRUE(t.write(index_of(t, "mode"), 1, at(0)));
  ASSERT_TRUE(t.write(index_of(t, "target_position"), -30.5, at(0)));
  ASSERT_TRUE(t.write(index_of(t, "enable"), 1, at(0)));
  EXPECT_NEAR(t.read(index_of(t, "position"), at(10)), -30.5, 1e-9);
  EXPECT_NEAR(t.read(index_of(t, "angle"), at(10)), -30.5, 1e-9);
}

TEST(TurntableSignals, WhatARegisterCannotHoldIsRefused) {
  Turntable t;
  EXPECT_FALSE(t.write(index_of(t, "enable"), -1, at(0)));
  EXPECT_FALSE(t.write(index_of(t, "target_rate"), 3e6, at(0)));
  EXPECT_FALSE(t.write(index_of(t, "target_rate"), std::nan(""), at(0)));
  EXPECT_FALSE(t.write(index_of(t, "position"), 0, at(0))) << "it is not commanded";
  EXPECT_FALSE(t.write(99, 0, at(0)));
  EXPECT_EQ(t.read(index_of(t, "target_rate"), at(1)), 0);
}

}  // namespace
}  // namespace rigor
