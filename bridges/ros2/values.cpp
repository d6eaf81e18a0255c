#include "bridges/ros2/values.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cstring>

#include "sensor-hal/config/did_you_mean.h"

namespace rigor::ros2 {
namespace {

constexpr std::string_view kJointState = "sensor_msgs/msg/JointState";

std::size_t size_of(Primitive p) {
  switch (p) {
    case Primitive::int8:
    case Primitive::uint8:
    case Primitive::boolean:
    case Primitive::byte:
      return 1;
    case Primitive::int16:
    case Primitive::uint16:
      return 2;
    case Primitive::int32:
    case Primitive::uint32:
    case Primitive::float32:
      return 4;
    case Primitive::int64:
    case Primitive::uint64:
    case Primitive::float64:
      return 8;
    case Primitive::none:
    case Primitive::string:
    case Primitive::wstring:
      break;
  }
  return 0;
}

bool is_index(std::string_view text) {
  return !text.empty() && text.size() <= 9 && text.find_first_not_of("0123456789") == std::string_view::npos;
}

void add_paths(const Definition& all, const std::vector<Field>& fields, const std::string& prefix,
               std::vector<std::string>& paths) {
  for (const Field& f : fields) {
    std::string path = prefix + f.name;
    if (f.many != Field::Many::one) {
      const bool by_joint = all.type == kJointState && f.primitive == Primitive::float64;
      path += by_joint ? ".NAME" : ".0";
    }
    if (!f.nested.empty())
      add_paths(all, all.types.at(f.nested), path + ".", paths);
    else if (size_of(f.primitive) > 0)
      paths.push_back(std::move(path));
  }
}

/// Whether a path leads to a number of these fields.
bool leads(const Definition& all, const std::vector<Field>& fields, std::string_view path) {
  const std::size_t dot = path.find('.');
  const std::string_view name = path.substr(0, dot);
  const auto field =
      std::find_if(fields.begin(), fields.end(), [&](const Field& f) { return f.name == name; });
  if (field == fields.end()) return false;
  std::string_view rest = dot == std::string_view::npos ? std::string_view{} : path.substr(dot + 1);
  if (field->many != Field::Many::one) {
    const bool by_joint = all.type == kJointState && field->primitive == Primitive::float64;
    if (by_joint) return !rest.empty();
    const std::size_t end = rest.find('.');
    const std::string_view index = rest.substr(0, end);
    std::uint64_t i = 0;
    if (!is_index(index)) return false;
    std::from_chars(index.data(), index.data() + index.size(), i);
    if (field->capacity > 0 && i >= field->capacity) return false;
    rest = end == std::string_view::npos ? std::string_view{} : rest.substr(end + 1);
  }
  if (!field->nested.empty()) return leads(all, all.types.at(field->nested), rest);
  return rest.empty() && size_of(field->primitive) > 0;
}

}  // namespace

/// Reads plain CDR (XCDR1) in either byte order. After a failure it gives zeros.
struct ValueReader::Cursor {
  record::Bytes data;
  std::span<double> values;
  std::size_t at = 4;
  bool swap = false;
  std::string error{};

  void bad(std::string what) {
    if (error.empty()) error = "byte " + std::to_string(at) + " of the message: " + std::move(what);
  }
  [[nodiscard]] bool ok() const { return error.empty(); }
  [[nodiscard]] std::size_t left() const { return data.size() - at; }
  bool align(std::size_t n) {
    const std::size_t past = (at - 4) % n;
    if (past == 0) return true;
    if (left() < n - past) return bad("the message ends within a field"), false;
    at += n - past;
    return true;
  }
  template <class T>
  T get() {
    T value{};
    if (!ok() || !align(sizeof(T))) return value;
    if (left() < sizeof(T)) return bad("the message ends within a field"), value;
    std::array<std::byte, sizeof(T)> raw;
    std::memcpy(raw.data(), data.data() + at, sizeof(T));
    if (swap) std::reverse(raw.begin(), raw.end());
    std::memcpy(&value, raw.data(), sizeof(T));
    at += sizeof(T);
    return value;
  }
  double number(Primitive p) {
    switch (p) {
      case Primitive::int8:
        return get<std::int8_t>();
      case Primitive::uint8:
      case Primitive::byte:
        return get<std::uint8_t>();
      case Primitive::boolean:
        return get<std::uint8_t>() != 0 ? 1 : 0;
      case Primitive::int16:
        return get<std::int16_t>();
      case Primitive::uint16:
        return get<std::uint16_t>();
      case Primitive::int32:
        return get<std::int32_t>();
      case Primitive::uint32:
        return get<std::uint32_t>();
      case Primitive::int64:
        return static_cast<double>(get<std::int64_t>());
      case Primitive::uint64:
        return static_cast<double>(get<std::uint64_t>());
      case Primitive::float32:
        return get<float>();
      case Primitive::float64:
        return get<double>();
      default:
        return 0;
    }
  }
  std::string_view text() {
    const auto n = get<std::uint32_t>();
    if (!ok()) return {};
    if (n > left()) return bad("a text is longer than what is left of the message"), std::string_view{};
    std::string_view all(reinterpret_cast<const char*>(data.data()) + at, n);
    at += n;
    if (!all.empty() && all.back() == '\0') all.remove_suffix(1);
    return all;
  }
};

Result<ValueReader> ValueReader::make(Definition definition, std::vector<std::string> paths) {
  for (const std::string& path : paths) {
    if (leads(definition, definition.fields(), path)) continue;
    const std::vector<std::string> there = value_paths(definition);
    return fail(ErrorCode::bad_input, "",
                "expected a number of " + definition.type + ", one of " + joined_or_none(there) + ", got \"" +
                    path + "\"" + did_you_mean(path, there));
  }
  return ValueReader(std::move(definition), std::move(paths));
}

bool ValueReader::wants(const std::string& prefix) const {
  return std::any_of(paths_.begin(), paths_.end(),
                     [&](const std::string& p) { return p.starts_with(prefix); });
}

void ValueReader::give(Cursor& cursor, const std::string& path, double value) {
  for (std::size_t i = 0; i < paths_.size(); ++i)
    if (paths_[i] == path) cursor.values[i] = value, found_[i] = true;
}

void ValueReader::walk_primitives(Cursor& cursor, const Field& field, const std::string& path,
                                  std::size_t count) {
  const bool texts = field.primitive == Primitive::string;
  if (field.primitive == Primitive::wstring) return cursor.bad("texts of wide characters are not read");
  const std::size_t least = texts ? 4 : size_of(field.primitive);
  if (count > cursor.left() / least + 1)
    return cursor.bad("a count is larger than what is left of the message");
  if (texts) {
    const bool joints = definition_.type == kJointState && path == "name";
    for (std::size_t i = 0; i < count && cursor.ok(); ++i) {
      const std::string_view text = cursor.text();
      if (joints) joints_.emplace_back(text);
    }
    return;
  }
  if (field.many == Field::Many::one) return give(cursor, path, cursor.number(field.primitive));
  const bool by_joint = definition_.type == kJointState && field.primitive == Primitive::float64;
  const bool wanted = wants(path + ".");
  for (std::size_t i = 0; i < count && cursor.ok(); ++i) {
    const double value = cursor.number(field.primitive);
    if (!wanted) continue;
    if (!by_joint)
      give(cursor, path + "." + std::to_string(i), value);
    else if (i < joints_.size())
      give(cursor, path + "." + joints_[i], value);
  }
}

void ValueReader::walk(Cursor& cursor, const std::vector<Field>& fields, const std::string& prefix) {
  for (const Field& field : fields) {
    if (!cursor.ok()) return;
    const std::string path = prefix + field.name;
    std::size_t count = 1;
    if (field.many == Field::Many::array) count = field.capacity;
    if (field.many == Field::Many::sequence || field.many == Field::Many::bounded_sequence)
      count = cursor.get<std::uint32_t>();
    if (!cursor.ok()) return;
    if (field.nested.empty()) {
      walk_primitives(cursor, field, path, count);
      continue;
    }
    if (count > cursor.left() + 1) return cursor.bad("a count is larger than what is left of the message");
    const std::vector<Field>& inner = definition_.types.at(field.nested);
    for (std::size_t i = 0; i < count && cursor.ok(); ++i)
      walk(cursor, inner, field.many == Field::Many::one ? path + "." : path + "." + std::to_string(i) + ".");
  }
}

Status ValueReader::read(record::Bytes message, std::span<double> values) {
  if (message.size() < 4 || message[0] != std::byte{0} || message[1] > std::byte{1})
    return fail(ErrorCode::protocol, "", "expected the header of a plain CDR message (00 00 or 00 01)");
  Cursor cursor{message, values, 4,
                (message[1] == std::byte{1}) != (std::endian::native == std::endian::little)};
  joints_.clear();
  std::fill(found_.begin(), found_.end(), false);
  walk(cursor, definition_.fields(), "");
  if (!cursor.ok()) return fail(ErrorCode::protocol, "", cursor.error);
  // What follows the last field is padding, or the message is of another type.
  if (cursor.left() > 7)
    return fail(ErrorCode::protocol, "", "the message goes on after its last field: it is of another type");
  for (std::size_t i = 0; i < paths_.size(); ++i)
    if (!found_[i])
      return fail(ErrorCode::protocol, "", "expected " + paths_[i] + " in the message, found none");
  return {};
}

std::vector<std::string> value_paths(const Definition& definition) {
  std::vector<std::string> paths;
  add_paths(definition, definition.fields(), "", paths);
  return paths;
}

}  // namespace rigor::ros2
