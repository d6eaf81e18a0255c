// Hashes of message types against those that ROS 2 computes itself.
#include "bridges/ros2/type_hash.h"

#include <gtest/gtest.h>

#include "bridges/ros2/names.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor::ros2 {
namespace {

struct Golden {
  const char *type, *hash;
};

// Sources: the code that rosidl_generator_c of ROS 2 Kilted writes for each type (`…__get_type_hash` in
// hpmicro/hpm_sdk, middleware/microros/kilted/include), and the type descriptions of
// osrf/ros:jazzy-desktop (/opt/ros/jazzy/share/PACKAGE/msg/TYPE.json), as CARLA lists them in its test of
// type hashes (libcarla, test_type_hash). Both have the same values for the types that both have.
const Golden kGolden[] = {
    {"builtin_interfaces/Time", "b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197"},
    {"std_msgs/Header", "f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01"},
    {"std_msgs/Float32", "7170d3d8f841f7be3172ce5f4f59f3a4d7f63b0447e8b33327601ad64d83d6e2"},
    {"std_msgs/Float64", "705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a"},
    {"std_msgs/MultiArrayDimension", "5e773a60a4c7fc8a54985f307c7837aa2994252a126c301957a24e31282c9cbe"},
    {"std_msgs/MultiArrayLayout", "4c66e6f78e740ac103a94cf63259f968e48c617e7699e829b63c21a5cb50dac6"},
    {"std_msgs/Float64MultiArray", "1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f"},
    {"geometry_msgs/Point", "6963084842a9b04494d6b2941d11444708d892da2f4b09843b9c43f42a7f6881"},
    {"geometry_msgs/Vector3", "cc12fe83e4c02719f1ce8070bfd14aecd40f75a96696a67a2a1f37f7dbb0765d"},
    {"geometry_msgs/Quaternion", "8a765f66778c8ff7c8ab94afcc590a2ed5325a1d9a076ffff38fbce36f458684"},
    {"geometry_msgs/Pose", "d501954e9476cea2996984e812054b68026ae0bfae789d9a10b23daf35cc90fa"},
    {"geometry_msgs/PoseStamped", "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"},
    {"geometry_msgs/PoseWithCovariance", "9a7c0fd234b7f45c6098745ecccd773ca1085670e64107135397aee31c02e1bb"},
    {"geometry_msgs/Twist", "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"},
    {"geometry_msgs/TwistWithCovariance", "49f574f033f095d8b6cd1beaca5ca7925e296e84af1716d16c89d38b059c8c18"},
    {"geometry_msgs/Transform", "beb83fbe698636351461f6f35d1abb20010c43d55374d81bd041f1ba2581fddc"},
    {"geometry_msgs/TransformStamped", "0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206"},
    {"tf2_msgs/TFMessage", "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"},
    {"nav_msgs/Odometry", "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"},
    {"sensor_msgs/Image", "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"},
    {"sensor_msgs/CompressedImage", "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"},
    {"sensor_msgs/CameraInfo", "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"},
    {"sensor_msgs/RegionOfInterest", "ad16bcba5f9131dcdba6fbded19f726f5440e3c513b4fb586dd3027eeed8abb1"},
    {"sensor_msgs/PointField", "5c6a4750728c2bcfbbf7037225b20b02d4429634732146b742dee1726637ef01"},
    {"sensor_msgs/PointCloud2", "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"},
    {"sensor_msgs/LaserScan", "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"},
    {"sensor_msgs/Imu", "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"},
    {"sensor_msgs/JointState", "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"},
    {"sensor_msgs/NavSatStatus", "d1ed3befa628e09571bd273b888ba1c1fd187c9a5e0006b385d7e5e9095a3204"},
    {"sensor_msgs/NavSatFix", "62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404"},
    {"diagnostic_msgs/DiagnosticArray", "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"},
    {"rosgraph_msgs/Clock", "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564"},
};

TEST(TypeHash, IsThatOfRos2ForStandardMessages) {
  for (const Golden& golden : kGolden) {
    const auto definition = read_definition(golden.type, definition_text(golden.type));
    ASSERT_TRUE(definition) << golden.type << ": " << definition.error().text();
    const auto hash = type_hash(*definition);
    ASSERT_TRUE(hash) << hash.error().text();
    EXPECT_EQ(*hash, std::string("RIHS01_") + golden.hash) << golden.type;
  }
}

TEST(TypeHash, DependsOnEachFieldAndOnNoCommentOrConstant) {
  const auto hash = [](const char* text) {
    const auto definition = read_definition("p/T", text);
    EXPECT_TRUE(definition);
    return *type_hash(*definition);
  };
  const std::string plain = hash("int32 a\nstring b\n");
  EXPECT_EQ(hash("# what it is\nint32 a   # metres\n\nuint8 X=1\nstring b\n"), plain);
  EXPECT_EQ(hash("int32 a 7\nstring b\n"), plain);  // a default value
  EXPECT_NE(hash("int32 a\nstring c\n"), plain);
  EXPECT_NE(hash("int64 a\nstring b\n"), plain);
  EXPECT_NE(hash("int32[] a\nstring b\n"), plain);
  EXPECT_NE(hash("int32[3] a\nstring b\n"), hash("int32[4] a\nstring b\n"));
}

TEST(Definition, RefusesWhatIsNoField) {
  const auto bad = read_definition("p/T", "int32 a\nnonsense\n");
  ASSERT_FALSE(bad);
  EXPECT_NE(bad.error().message.find("got \"nonsense\""), std::string::npos) << bad.error().message;
  const auto missing = read_definition("p/T", "Other b\n");
  ASSERT_FALSE(missing);
  EXPECT_NE(missing.error().message.find("p/msg/Other"), std::string::npos) << missing.error().message;
}

TEST(Names, AreThoseOfRos2OnDds) {
  EXPECT_EQ(dds_topic("/left/image"), "rt/left/image");
  EXPECT_EQ(dds_type("sensor_msgs/msg/Image"), "sensor_msgs::msg::dds_::Image_");
  EXPECT_EQ(dds_type("sensor_msgs/Image"), "sensor_msgs::msg::dds_::Image_");
  EXPECT_EQ(dds_type("sensor_msgs/srv/SetCameraInfo"), "");
  EXPECT_EQ(dds_type("Image"), "");
  EXPECT_EQ(ros_topic("/front-left/image"), "/front_left/image");
}

}  // namespace
}  // namespace rigor::ros2
