// Numbers of a message of ROS 2 by their paths, from whatever bytes come over the network. The first byte of
// the input names the type, the rest is the message. Each number that is found is one of the message.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "bridges/ros2/values.h"

using namespace rigor;
using namespace rigor::ros2;

namespace {

struct Type {
  ValueReader reader;
  std::vector<double> values;
};

std::vector<Type>& types() {
  static std::vector<Type> all = [] {
    std::vector<Type> made;
    for (const auto& [type, paths] : std::vector<std::pair<const char*, std::vector<std::string>>>{
             {"geometry_msgs/Twist", {"linear.x", "angular.z"}},
             {"sensor_msgs/JointState", {"position.a", "velocity.b"}},
             {"std_msgs/Float64MultiArray", {"data.0", "layout.data_offset"}},
             {"std_msgs/Bool", {"data"}},
             {"sensor_msgs/PointCloud2", {"width", "fields.0.offset"}},
             {"ackermann_msgs/AckermannDriveStamped", {"drive.speed", "header.stamp.sec"}}}) {
      auto definition = read_definition(type, definition_text(type));
      if (!definition) std::abort();
      auto reader = ValueReader::make(std::move(*definition), paths);
      if (!reader) std::abort();
      made.push_back({std::move(*reader), std::vector<double>(paths.size())});
    }
    return made;
  }();
  return all;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  Type& type = types()[data[0] % types().size()];
  (void)type.reader.read({reinterpret_cast<const std::byte*>(data) + 1, size - 1}, type.values);
  return 0;
}
