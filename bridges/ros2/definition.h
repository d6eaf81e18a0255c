// Message types by their definitions: what a .msg file of ROS 2 says, with the files that it refers to.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"

namespace rigor::ros2 {

/// Numbers of type_description_interfaces/msg/FieldType.
enum class Primitive : std::uint8_t {
  none = 0,
  int8 = 2,
  uint8 = 3,
  int16 = 4,
  uint16 = 5,
  int32 = 6,
  uint32 = 7,
  int64 = 8,
  uint64 = 9,
  float32 = 10,
  float64 = 11,
  boolean = 15,
  byte = 16,
  string = 17,
  wstring = 18
};

struct Field {
  enum class Many : std::uint8_t { one, array, bounded_sequence, sequence };
  std::string name;
  Primitive primitive = Primitive::none;  ///< none: `nested`
  std::string nested;                     ///< `geometry_msgs/msg/Vector3`
  Many many = Many::one;
  std::uint64_t capacity = 0;  ///< of an array or a bounded sequence
};

/// The fields of a type and of all types that it refers to, by their names (`sensor_msgs/msg/Image`).
struct Definition {
  std::string type;
  std::map<std::string, std::vector<Field>> types;
  [[nodiscard]] const std::vector<Field>& fields() const { return types.at(type); }
};

/// Reads a definition as `ros2msg`: the type's own lines, then for each other type a line of `=`, `MSG:
/// pkg/Name` and its lines. Constants and default values are passed over. Errors: internal, with the line
/// that is no field, or the type that is referred to and not defined.
[[nodiscard]] Result<Definition> read_definition(std::string_view type, std::string_view text);

/// The text for a type that this library knows: those of recordings, and those that commands come in. Empty:
/// it is not known. `type` with or without `msg/`.
[[nodiscard]] std::string definition_text(std::string_view type);
/// Types of messages with numbers that definition_text knows beside those of recordings.
[[nodiscard]] std::vector<std::string> command_types();

}  // namespace rigor::ros2
