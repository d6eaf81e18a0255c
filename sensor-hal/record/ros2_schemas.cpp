// The .msg files of the types in ros2_messages.h, and how they are joined for a recording's schema.
#include <algorithm>
#include <array>

#include "sensor-hal/record/ros2_messages.h"

namespace rigor::record {
namespace {

struct Definition {
  std::string_view type;  ///< `pkg/Name`
  std::string_view text;
};

constexpr std::array kDefinitions{
    Definition{"builtin_interfaces/Time", R"(int32 sec
uint32 nanosec
)"},
    Definition{"std_msgs/Header", R"(builtin_interfaces/Time stamp
string frame_id
)"},
    Definition{"geometry_msgs/Point", R"(float64 x
float64 y
float64 z
)"},
    Definition{"geometry_msgs/Vector3", R"(float64 x
float64 y
float64 z
)"},
    Definition{"geometry_msgs/Quaternion", R"(float64 x
float64 y
float64 z
float64 w
)"},
    Definition{"geometry_msgs/Pose", R"(Point position
Quaternion orientation
)"},
    Definition{"geometry_msgs/PoseStamped", R"(std_msgs/Header header
Pose pose
)"},
    Definition{"geometry_msgs/PoseWithCovariance", R"(Pose pose
float64[36] covariance
)"},
    Definition{"geometry_msgs/Twist", R"(Vector3 linear
Vector3 angular
)"},
    Definition{"geometry_msgs/TwistWithCovariance", R"(Twist twist
float64[36] covariance
)"},
    Definition{"geometry_msgs/Transform", R"(Vector3 translation
Quaternion rotation
)"},
    Definition{"geometry_msgs/TransformStamped", R"(std_msgs/Header header
string child_frame_id
Transform transform
)"},
    Definition{"rosgraph_msgs/Clock", R"(builtin_interfaces/Time clock
)"},
    Definition{"tf2_msgs/TFMessage", R"(geometry_msgs/TransformStamped[] transforms
)"},
    Definition{"nav_msgs/Odometry", R"(std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
)"},
    Definition{"sensor_msgs/Image", R"(std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
)"},
    Definition{"sensor_msgs/CompressedImage", R"(std_msgs/Header header
string format
uint8[] data
)"},
    Definition{"sensor_msgs/RegionOfInterest", R"(uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
)"},
    Definition{"sensor_msgs/CameraInfo", R"(std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
RegionOfInterest roi
)"},
    Definition{"sensor_msgs/PointField", R"(uint8 INT8=1
uint8 UINT8=2
uint8 INT16=3
uint8 UINT16=4
uint8 INT32=5
uint8 UINT32=6
uint8 FLOAT32=7
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
)"},
    Definition{"sensor_msgs/PointCloud2", R"(std_msgs/Header header
uint32 height
uint32 width
PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
)"},
    Definition{"sensor_msgs/LaserScan", R"(std_msgs/Header header
float32 angle_min
float32 angle_max
float32 angle_increment
float32 time_increment
float32 scan_time
float32 range_min
float32 range_max
float32[] ranges
float32[] intensities
)"},
    Definition{"sensor_msgs/Imu", R"(std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
)"},
    Definition{"sensor_msgs/Temperature", R"(std_msgs/Header header
float64 temperature
float64 variance
)"},
    Definition{"sensor_msgs/JointState", R"(std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
)"},
    Definition{"sensor_msgs/NavSatStatus", R"(int8 STATUS_NO_FIX=-1
int8 STATUS_FIX=0
int8 STATUS_SBAS_FIX=1
int8 STATUS_GBAS_FIX=2
uint16 SERVICE_GPS=1
uint16 SERVICE_GLONASS=2
uint16 SERVICE_COMPASS=4
uint16 SERVICE_GALILEO=8
int8 status
uint16 service
)"},
    Definition{"sensor_msgs/NavSatFix", R"(uint8 COVARIANCE_TYPE_UNKNOWN=0
uint8 COVARIANCE_TYPE_APPROXIMATED=1
uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2
uint8 COVARIANCE_TYPE_KNOWN=3
std_msgs/Header header
NavSatStatus status
float64 latitude
float64 longitude
float64 altitude
float64[9] position_covariance
uint8 position_covariance_type
)"},
    Definition{"can_msgs/Frame", R"(std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
)"},
    Definition{"diagnostic_msgs/KeyValue", R"(string key
string value
)"},
    Definition{"diagnostic_msgs/DiagnosticStatus", R"(byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
KeyValue[] values
)"},
    Definition{"diagnostic_msgs/DiagnosticArray", R"(std_msgs/Header header
DiagnosticStatus[] status
)"},
    Definition{
        "rigor_msgs/SampleStamp",
        R"(# All that Rigor knows about a sample beside its value; on the topic `<topic>/stamp`, at the same log time, before it.
# Times are nanoseconds on the bench clock; validity bits as in rt-core/stamp.h; kind as in sensor-hal/types/sample.h.
string channel
uint64 sequence
int64 t_capture_ns
int64 t_release_ns
int64 t_arrival_ns
int64 sigma_capture_ns
uint32 lost_before
uint32 validity
uint8 kind
)"},
    Definition{
        "rigor_msgs/ImageSettings",
        R"(# What sensor_msgs/Image has no place for; on the topic `<topic>/settings`. Pixel format by its PFNC name.
std_msgs/Header header
string pixel_format
uint32 offset_x_px
uint32 offset_y_px
int64 exposure_ns
float64 gain_db
)"},
    Definition{"rigor_msgs/CanFdFrame",
               R"(# A CAN FD frame, or any that can_msgs/Frame cannot hold; on the topic `<topic>/fd`.
std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
bool is_fd
bool bit_rate_switch
uint8[] data
)"},
    Definition{
        "rigor_msgs/RegisterBlock",
        R"(# A group of registers: values in their units; raw register contents where the device gave them.
std_msgs/Header header
string[] names
float64[] values
string[] units
uint16[] raw
)"},
    Definition{"rigor_msgs/NavFixQuality",
               R"(# What sensor_msgs/NavSatFix has no place for; on the topic `<topic>/quality`.
# status: 0 none, 1 single, 2 SBAS, 3 RTK float, 4 RTK fixed. satellites: used in the fix, 0 also where unknown.
std_msgs/Header header
uint8 status
uint16 satellites
)"},
    Definition{"rigor_msgs/PortEntry", R"(# What one port showed in a cycle; status as in rt-core/port.h.
string channel
uint64 sequence
uint8 status
int64 t_capture_ns
int64 t_arrival_ns
int64 t_release_ns
)"},
    Definition{"rigor_msgs/PortVisibility", R"(# Which samples the application saw in a cycle of the bench.
uint64 cycle
int64 t_bench_ns
PortEntry[] entries
)"},
    Definition{"rigor_msgs/Event", R"(std_msgs/Header header
string channel
string kind
uint32 code
float64 value
string text
)"},
    Definition{"rigor_msgs/Fault", R"(# A fault begins or ends.
std_msgs/Header header
# The channel or sink; of a side of a pair left.real.
string channel
# In its channel, those of the rig first.
uint32 index
string kind
# Injected while the run went on.
bool live
bool begins
# Samples so far, while it was on: all, and of these.
uint64 seen
uint64 dropped
uint64 changed
uint64 delayed
# The fault with all its keys, as JSON.
string fault
)"},
    Definition{"rigor_msgs/Command",
               R"(# A command to an actuator; takes effect at t_effect_ns on the bench clock.
std_msgs/Header header
string channel
uint64 sequence
int64 t_effect_ns
string[] names
float64[] values
)"},
};

const Definition* find(std::string_view package, std::string_view type) {
  std::string full(type);
  if (type.find('/') == std::string_view::npos) full = std::string(package) + "/" + full;
  for (const Definition& definition : kDefinitions)
    if (definition.type == full) return &definition;
  return nullptr;
}

/// Adds the types of the fields of `of`, and of their fields, each once.
void collect(const Definition& of, std::vector<const Definition*>& all) {
  const std::string_view package = of.type.substr(0, of.type.find('/'));
  for (std::string_view rest = of.text; !rest.empty();) {
    const std::string_view line = rest.substr(0, rest.find('\n'));
    rest.remove_prefix(std::min(rest.size(), line.size() + 1));
    const Definition* field = find(package, line.substr(0, line.find_first_of(" [")));
    if (field == nullptr || std::find(all.begin(), all.end(), field) != all.end()) continue;
    all.push_back(field);
    collect(*field, all);
  }
}

}  // namespace

std::string schema_text(std::string_view type) {
  const std::size_t at = type.find("/msg/");
  if (at == std::string_view::npos) return {};
  const Definition* definition = find(type.substr(0, at), type.substr(at + 5));
  if (definition == nullptr) return {};
  std::vector<const Definition*> needed;
  collect(*definition, needed);
  std::string text(definition->text);
  for (const Definition* part : needed) {
    text += std::string(80, '=') + "\nMSG: ";
    text += part->type;
    text += '\n';
    text += part->text;
  }
  return text;
}

}  // namespace rigor::record
