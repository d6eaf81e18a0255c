// Numbers of messages by their paths, and what is no message.
#include "bridges/ros2/values.h"

#include <gmock/gmock.h>

#include <cstring>

#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor::ros2 {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
namespace msg = record::msg;

ValueReader reader_of(const char* type, std::vector<std::string> paths) {
  auto definition = read_definition(type, definition_text(type));
  EXPECT_TRUE(definition);
  auto reader = ValueReader::make(std::move(*definition), std::move(paths));
  EXPECT_TRUE(reader) << reader.error().text();
  return std::move(*reader);
}

template <class M>
std::vector<std::byte> encoded(const M& message) {
  record::CdrWriter writer;
  const auto pieces = writer.write(message);
  EXPECT_TRUE(pieces);
  std::vector<std::byte> all;
  for (const auto& p : *pieces) all.insert(all.end(), p.begin(), p.end());
  return all;
}

TEST(Values, OfFieldsOfFields) {
  auto reader = reader_of("geometry_msgs/Twist", {"angular.z", "linear.x"});
  std::array<double, 2> v{};
  ASSERT_TRUE(reader.read(encoded(msg::Twist{{1.5, 2, 3}, {4, 5, -6.25}}), v));
  EXPECT_THAT(v, ElementsAre(-6.25, 1.5));
}

TEST(Values, OfJointsByTheirNamesInWhateverOrderTheyCome) {
  auto reader = reader_of("sensor_msgs/JointState", {"position.elbow", "velocity.shoulder"});
  std::array<double, 2> v{};
  msg::JointState joints{{{12, 34}, "base"}, {"shoulder", "elbow"}, {1, 2}, {3, 4}, {}};
  ASSERT_TRUE(reader.read(encoded(joints), v));
  EXPECT_THAT(v, ElementsAre(2, 3));
  joints.name = {"elbow", "wrist_of_seven_letters", "shoulder"};
  joints.position = {7, 8, 9};
  joints.velocity = {10, 11, 12};
  ASSERT_TRUE(reader.read(encoded(joints), v));
  EXPECT_THAT(v, ElementsAre(7, 12));
  joints.velocity.clear();
  const auto missing = reader.read(encoded(joints), v);
  ASSERT_FALSE(missing);
  EXPECT_THAT(missing.error().message, HasSubstr("expected velocity.shoulder in the message, found none"));
}

TEST(Values, OfElementsOfArrays) {
  auto reader =
      reader_of("sensor_msgs/Imu", {"orientation_covariance.8", "linear_acceleration.z", "header.stamp.sec"});
  msg::Imu imu;
  imu.header.stamp.sec = -3;
  imu.header.frame_id = "x";
  imu.orientation_covariance[8] = 0.125;
  imu.linear_acceleration.z = 9.81;
  std::array<double, 3> v{};
  ASSERT_TRUE(reader.read(encoded(imu), v));
  EXPECT_THAT(v, ElementsAre(0.125, 9.81, -3));
}

TEST(Values, OfTheOtherByteOrder) {
  auto reader = reader_of("std_msgs/Float32", {"data"});
  const std::array<unsigned char, 8> big{0, 0, 0, 0, 0x3f, 0xc0, 0, 0};  // 1.5
  std::array<double, 1> v{};
  ASSERT_TRUE(reader.read(std::as_bytes(std::span(big)), v));
  EXPECT_EQ(v[0], 1.5);
}

TEST(Values, APathThatLeadsToNoNumberIsRefusedWithThoseThereAre) {
  const auto make = [](const char* type, const char* path) {
    return ValueReader::make(*read_definition(type, definition_text(type)), {path});
  };
  const auto typo = make("geometry_msgs/Twist", "linear.y1");
  ASSERT_FALSE(typo);
  EXPECT_THAT(typo.error().message, HasSubstr("one of linear.x, linear.y, linear.z, angular.x"));
  EXPECT_THAT(typo.error().message, HasSubstr("did you mean linear.y"));
  EXPECT_FALSE(make("geometry_msgs/Twist", "linear"));
  EXPECT_FALSE(make("sensor_msgs/Imu", "orientation_covariance.9"));
  EXPECT_FALSE(make("std_msgs/Float64MultiArray", "data"));
  EXPECT_FALSE(make("std_msgs/Float64MultiArray", "data.-1"));
  EXPECT_TRUE(make("std_msgs/Float64MultiArray", "data.17"));
}

/// Every message that is cut short, and counts that lie, end in an error and in no read beyond the bytes
/// (which the address sanitizer would see: the bytes lie at the end of their memory).
TEST(Values, OfCutAndLyingMessagesAreErrors) {
  auto reader = reader_of("sensor_msgs/JointState", {"position.a"});
  const auto whole = encoded(msg::JointState{{{1, 2}, "f"}, {"a", "b"}, {1, 2}, {3, 4}, {5, 6}});
  std::array<double, 1> v{};
  for (std::size_t n = 0; n < whole.size(); ++n) {
    const auto cut = std::make_unique<std::byte[]>(n);
    std::copy_n(whole.begin(), n, cut.get());
    EXPECT_FALSE(reader.read({cut.get(), n}, v)) << n << " of " << whole.size() << " bytes";
  }
  for (std::size_t at = 4; at + 4 <= whole.size(); at += 4) {
    auto lying = whole;
    const std::uint32_t huge = 0xfffffff0u;
    std::memcpy(lying.data() + at, &huge, 4);
    (void)reader.read(lying, v);  // an error, or a number that differs
  }
  auto longer = whole;
  longer.resize(whole.size() + 8);
  EXPECT_FALSE(reader.read(longer, v)) << "a message of another type goes on after the last field";
  longer = whole;
  longer[1] = std::byte{7};
  EXPECT_FALSE(reader.read(longer, v)) << "XCDR2 is another encoding";
}

}  // namespace
}  // namespace rigor::ros2
