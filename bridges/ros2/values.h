// Numbers of a message by their paths, whatever its type:
//
//   linear.x            a field of a field
//   data.3              the fourth element of an array
//   position.elbow      of sensor_msgs/JointState: the element whose place is that of `elbow` in `name`
//
// Nothing in a message is trusted: counts and lengths are checked against the bytes that are there.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "bridges/ros2/definition.h"
#include "sensor-hal/record/byte_io.h"

namespace rigor::ros2 {

class ValueReader {
 public:
  /// bad_input, with the paths that there are, where one does not lead to a number. Setup context.
  [[nodiscard]] static Result<ValueReader> make(Definition definition, std::vector<std::string> paths);

  /// One number for each path. protocol: the bytes are no message of the type, or lack an element or a joint
  /// that a path names. One thread at a time; allocates until its memory has grown.
  [[nodiscard]] Status read(record::Bytes message, std::span<double> values);
  [[nodiscard]] const std::vector<std::string>& paths() const { return paths_; }

 private:
  struct Cursor;
  ValueReader(Definition definition, std::vector<std::string> paths)
      : definition_(std::move(definition)), paths_(std::move(paths)), found_(paths_.size()) {}
  void walk(Cursor& cursor, const std::vector<Field>& fields, const std::string& prefix);
  void walk_primitives(Cursor& cursor, const Field& field, const std::string& path, std::size_t count);
  void give(Cursor& cursor, const std::string& path, double value);
  [[nodiscard]] bool wants(const std::string& prefix) const;

  Definition definition_;
  std::vector<std::string> paths_;
  std::vector<bool> found_;
  std::vector<std::string> joints_;  ///< of the message that is being read
};

/// Paths of the numbers of a type; of arrays one stands for all: `data.0`, `position.NAME`.
[[nodiscard]] std::vector<std::string> value_paths(const Definition& definition);

}  // namespace rigor::ros2
