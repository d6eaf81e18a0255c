#include "bridges/ros2/definition.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <set>

#include "bridges/ros2/names.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor::ros2 {
namespace {

constexpr std::array<std::pair<std::string_view, Primitive>, 16> kPrimitives{
    {{"int8", Primitive::int8},
     {"uint8", Primitive::uint8},
     {"int16", Primitive::int16},
     {"uint16", Primitive::uint16},
     {"int32", Primitive::int32},
     {"uint32", Primitive::uint32},
     {"int64", Primitive::int64},
     {"uint64", Primitive::uint64},
     {"float32", Primitive::float32},
     {"float64", Primitive::float64},
     {"char", Primitive::uint8},
     {"bool", Primitive::boolean},
     {"boolean", Primitive::boolean},
     {"byte", Primitive::byte},
     {"string", Primitive::string},
     {"wstring", Primitive::wstring}}};

/// Types that recordings do not have. What they refer to is here, or among those of recordings.
constexpr std::array<std::pair<std::string_view, std::string_view>, 17> kMore{
    {{"std_msgs/Bool", "bool data\n"},
     {"std_msgs/Int32", "int32 data\n"},
     {"std_msgs/Int64", "int64 data\n"},
     {"std_msgs/UInt8", "uint8 data\n"},
     {"std_msgs/Float32", "float32 data\n"},
     {"std_msgs/Float64", "float64 data\n"},
     {"std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride\n"},
     {"std_msgs/MultiArrayLayout", "MultiArrayDimension[] dim\nuint32 data_offset\n"},
     {"std_msgs/Float32MultiArray", "MultiArrayLayout layout\nfloat32[] data\n"},
     {"std_msgs/Float64MultiArray", "MultiArrayLayout layout\nfloat64[] data\n"},
     {"geometry_msgs/TwistStamped", "std_msgs/Header header\nTwist twist\n"},
     {"geometry_msgs/Vector3Stamped", "std_msgs/Header header\nVector3 vector\n"},
     {"geometry_msgs/Wrench", "Vector3 force\nVector3 torque\n"},
     {"geometry_msgs/WrenchStamped", "std_msgs/Header header\nWrench wrench\n"},
     {"geometry_msgs/PointStamped", "std_msgs/Header header\nPoint point\n"},
     {"ackermann_msgs/AckermannDrive",
      "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 "
      "jerk\n"},
     {"ackermann_msgs/AckermannDriveStamped", "std_msgs/Header header\nAckermannDrive drive\n"}}};

std::string_view next_line(std::string_view& rest) {
  const std::size_t end = rest.find('\n');
  const std::string_view line = rest.substr(0, end);
  rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
  return line;
}

std::string_view trimmed(std::string_view text) {
  const auto is_space = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  while (!text.empty() && is_space(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_space(text.back())) text.remove_suffix(1);
  return text;
}

/// A line `float64[36] covariance` of a type in `package`. False: it is no field.
bool read_field(std::string_view line, std::string_view package, Field& field) {
  const std::size_t gap = line.find_first_of(" \t");
  if (gap == std::string_view::npos) return false;
  std::string_view type = line.substr(0, gap);
  std::string_view name = trimmed(line.substr(gap));
  name = name.substr(0, name.find_first_of(" \t"));  // a default value follows
  if (const std::size_t bracket = type.find('['); bracket != std::string_view::npos) {
    std::string_view size = type.substr(bracket + 1);
    if (size.empty() || size.back() != ']') return false;
    size.remove_suffix(1);
    field.many = size.empty()             ? Field::Many::sequence
                 : size.starts_with("<=") ? Field::Many::bounded_sequence
                                          : Field::Many::array;
    if (size.starts_with("<=")) size.remove_prefix(2);
    const char* const end = size.data() + size.size();
    if (!size.empty() && std::from_chars(size.data(), end, field.capacity).ptr != end) return false;
    type = type.substr(0, bracket);
  }
  field.name = name;
  const auto* known =
      std::find_if(kPrimitives.begin(), kPrimitives.end(), [&](const auto& p) { return p.first == type; });
  if (known != kPrimitives.end())
    field.primitive = known->second;
  else
    field.nested =
        full_type(type.find('/') == std::string_view::npos ? std::string(package) + "/" + std::string(type)
                                                           : std::string(type));
  return !field.name.empty() && !type.empty();
}

std::string_view text_of_more(std::string_view type) {
  for (const auto& [name, text] : kMore)
    if (name == type) return text;
  return {};
}

/// `sensor_msgs/msg/Image` → `sensor_msgs/Image`.
std::string short_type(std::string_view type) {
  std::string name = full_type(type);
  if (const std::size_t at = name.find("/msg/"); at != std::string::npos) name.erase(at, 4);
  return name;
}

void append(const std::string& type, std::string& all, std::set<std::string>& done) {
  const std::string_view text = text_of_more(type);
  if (text.empty()) return;
  const std::string_view package = std::string_view(type).substr(0, type.find('/'));
  for (std::string_view rest = text; !rest.empty();) {
    Field field;
    if (!read_field(next_line(rest), package, field) || field.nested.empty()) continue;
    const std::string part = short_type(field.nested);
    if (!done.insert(part).second) continue;
    const std::string_view more = text_of_more(part);
    const std::string recorded = more.empty() ? record::schema_text(field.nested) : std::string();
    all += std::string(80, '=') + "\nMSG: " + part + "\n" + (more.empty() ? recorded : std::string(more));
    if (!more.empty()) append(part, all, done);
  }
}

}  // namespace

Result<Definition> read_definition(std::string_view type, std::string_view text) {
  Definition all;
  all.type = full_type(type);
  std::string current = all.type;
  all.types[current];
  for (std::string_view rest = text; !rest.empty();) {
    std::string_view line = next_line(rest);
    if (line.starts_with("====")) continue;
    if (line.starts_with("MSG: ")) {
      current = full_type(trimmed(line.substr(5)));
      all.types[current].clear();
      continue;
    }
    line = trimmed(line.substr(0, line.find('#')));
    // `uint8 FIX=0` is a constant; `float64[<=3] x` is none.
    if (const std::size_t equals = line.find('='); equals != std::string_view::npos)
      if (equals == 0 || line[equals - 1] != '<') continue;
    if (line.empty()) continue;
    Field field;
    if (!read_field(line, std::string_view(current).substr(0, current.find('/')), field))
      return fail(ErrorCode::internal, std::string(type),
                  "expected a field in the definition of the type, got \"" + std::string(line) + "\"");
    all.types[current].push_back(std::move(field));
  }
  for (const auto& [name, fields] : all.types)
    for (const Field& field : fields)
      if (!field.nested.empty() && !all.types.contains(field.nested))
        return fail(ErrorCode::internal, std::string(type),
                    "expected the definition of " + field.nested + ", which it refers to, got none");
  return all;
}

std::string definition_text(std::string_view type) {
  const std::string full = full_type(type), name = short_type(type);
  const std::string_view more = text_of_more(name);
  if (more.empty()) return record::schema_text(full);
  std::string all(more);
  std::set<std::string> done{name};
  append(name, all, done);
  return all;
}

std::vector<std::string> command_types() {
  std::vector<std::string> all{"geometry_msgs/Twist", "sensor_msgs/JointState"};
  for (const auto& [name, text] : kMore)
    if (name.find("MultiArrayD") == std::string_view::npos &&
        name.find("MultiArrayL") == std::string_view::npos)
      all.emplace_back(name);
  return all;
}

}  // namespace rigor::ros2
