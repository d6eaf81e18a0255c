// Faults of raw CAN channels by the signals of a DBC file.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "drivers/can/dbc.h"
#include "drivers/can/fault_signals.h"
#include "drivers/can/signal_codec.h"
#include "tests/paths.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;

const std::string kDbc = rigor::test::source_dir() + "/configs/buses/seekurjr.dbc";

std::shared_ptr<const FrameSignal> find(const std::string& name, std::string* refused = nullptr) {
  const auto node = ConfigDocument::parse("{dbc: " + kDbc + ", value: " + name + "}", "rig.yaml");
  EXPECT_TRUE(node);
  try {
    return find_dbc_signal(*node, name);
  } catch (const ConfigError& e) {
    if (refused) *refused = e.error().text();
    return nullptr;
  }
}

TEST(FaultSignals, ChangeOneSignalOfItsFrameAndNothingElse) {
  const auto dbc = can::load_dbc(kDbc);
  ASSERT_TRUE(dbc);
  const can::Message* rates = dbc->message("WheelRates");
  ASSERT_NE(rates, nullptr);
  CanFrame frame = can::blank_frame(*rates);
  std::size_t bad = 0;
  const std::array<double, 3> values{1.5, -2, 80};
  ASSERT_EQ(can::encode(*rates, values, frame, bad), can::EncodeStatus::good);
  const auto signal = find("WheelRates.right_rate");
  ASSERT_NE(signal, nullptr);
  EXPECT_DOUBLE_EQ(signal->read(frame), -2);
  EXPECT_TRUE(signal->write(frame, -2.25));
  std::array<double, 3> after{};
  can::decode(*rates, {frame.data.data(), frame.length}, after);
  EXPECT_THAT(after, ::testing::ElementsAre(1.5, -2.25, 80));
  // Beyond what the file allows: to the end of its range.
  EXPECT_TRUE(signal->write(frame, 1e9));
  EXPECT_DOUBLE_EQ(signal->read(frame), 32);
  EXPECT_FALSE(signal->write(frame, std::nan("")));
  // Frames of other messages do not show it.
  frame.id = 1;
  EXPECT_TRUE(std::isnan(signal->read(frame)));
}

TEST(FaultSignals, AreNamedAloneWhereTheyAreUniqueAndRefusedWithTheNearest) {
  EXPECT_NE(find("battery"), nullptr);
  std::string why;
  EXPECT_EQ(find("batery", &why), nullptr);
  EXPECT_THAT(why, HasSubstr("did you mean 'battery'?"));
}

}  // namespace
}  // namespace rigor::test
