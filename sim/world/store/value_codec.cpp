#include "sim/world/store/value_codec.h"

#include <algorithm>
#include <array>
#include <cstring>

namespace rigor::world::store {
namespace {

constexpr std::array<Column, 1> kInteger = {{{"", "INTEGER"}}};
constexpr std::array<Column, 1> kReal = {{{"", "REAL"}}};
constexpr std::array<Column, 1> kText = {{{"", "TEXT"}}};
constexpr std::array<Column, 1> kBlob = {{{"", "BLOB"}}};
constexpr std::array<Column, 3> kVector = {{{".x", "REAL"}, {".y", "REAL"}, {".z", "REAL"}}};
constexpr std::array<Column, 19> kMotion = {{{".t_ref_ns", "INTEGER"},
                                             {".r11", "REAL"},
                                             {".r12", "REAL"},
                                             {".r13", "REAL"},
                                             {".x", "REAL"},
                                             {".r21", "REAL"},
                                             {".r22", "REAL"},
                                             {".r23", "REAL"},
                                             {".y", "REAL"},
                                             {".r31", "REAL"},
                                             {".r32", "REAL"},
                                             {".r33", "REAL"},
                                             {".z", "REAL"},
                                             {".vx", "REAL"},
                                             {".vy", "REAL"},
                                             {".vz", "REAL"},
                                             {".wx", "REAL"},
                                             {".wy", "REAL"},
                                             {".wz", "REAL"}}};
constexpr std::size_t kPoseReals = 12, kMotionReals = 18;

void append(std::vector<double>& out, const Vector3& v) { out.insert(out.end(), {v.x(), v.y(), v.z()}); }
void append(std::vector<double>& out, const Pose& T) {
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 4; ++column) out.push_back(T.matrix()(row, column));
}

std::optional<double> read_number(const Statement& s, int at) {
  switch (s.kind(at)) {
    case Statement::Kind::null:
      return std::numeric_limits<double>::quiet_NaN();
    case Statement::Kind::integer:
    case Statement::Kind::real:
      return s.real(at);
    case Statement::Kind::blob: {
      double x = 0;
      if (s.blob(at).size() != sizeof x) return std::nullopt;
      std::memcpy(&x, s.blob(at).data(), sizeof x);
      return x;
    }
    default:
      return std::nullopt;
  }
}

std::optional<std::vector<double>> read_reals(const Statement& s, int at, std::size_t count) {
  std::vector<double> out(count);
  for (std::size_t i = 0; i < count; ++i) {
    const auto x = read_number(s, at + static_cast<int>(i));
    if (!x) return std::nullopt;
    out[i] = *x;
  }
  return out;
}

std::optional<std::vector<double>> doubles(std::span<const std::byte> bytes) {
  if (bytes.size() % sizeof(double) != 0) return std::nullopt;
  std::vector<double> out(bytes.size() / sizeof(double));
  if (!out.empty()) std::memcpy(out.data(), bytes.data(), bytes.size());
  return out;
}

}  // namespace

std::span<const Column> columns_of(ValueKind kind) {
  switch (kind) {
    case ValueKind::flag:
    case ValueKind::integer:
      return kInteger;
    case ValueKind::number:
      return kReal;
    case ValueKind::text:
      return kText;
    case ValueKind::vector3:
      return kVector;
    case ValueKind::pose:
      return std::span(kMotion).subspan(1, kPoseReals);
    case ValueKind::motion:
      return kMotion;
    case ValueKind::numbers:
    case ValueKind::blob:
      return kBlob;
  }
  return {};
}

void bind_columns(Statement& s, int at, const Value& value) {
  switch (kind_of(value)) {
    case ValueKind::flag:
      s.bind(at, std::int64_t{std::get<bool>(value) ? 1 : 0});
      break;
    case ValueKind::integer:
      s.bind(at, std::get<std::int64_t>(value));
      break;
    case ValueKind::number:
      s.bind_number(at, std::get<double>(value));
      break;
    case ValueKind::text:
      s.bind(at, std::string_view(std::get<std::string>(value)));
      break;
    case ValueKind::motion:
      s.bind(at++, std::get<Motion>(value).t_ref.ns());
      [[fallthrough]];
    case ValueKind::vector3:
    case ValueKind::pose:
      for (const double x : reals_of(value)) s.bind_number(at++, x);
      break;
    case ValueKind::numbers:
      s.bind_blob(at, std::as_bytes(std::get<Numbers>(value).span()));
      break;
    case ValueKind::blob:
      s.bind_blob(at, std::get<Blob>(value).span());
      break;
  }
}

std::optional<Value> read_columns(const Statement& s, int at, ValueKind kind) {
  using Kind = Statement::Kind;
  switch (kind) {
    case ValueKind::flag:
      if (s.kind(at) != Kind::integer || (s.integer(at) & ~std::int64_t{1}) != 0) return std::nullopt;
      return Value(s.integer(at) == 1);
    case ValueKind::integer:
      if (s.kind(at) != Kind::integer) return std::nullopt;
      return Value(s.integer(at));
    case ValueKind::number: {
      const auto x = read_number(s, at);
      if (!x) return std::nullopt;
      return Value(*x);
    }
    case ValueKind::text:
      if (s.kind(at) != Kind::text) return std::nullopt;
      return Value(s.text(at));
    case ValueKind::vector3: {
      const auto r = read_reals(s, at, 3);
      if (!r) return std::nullopt;
      return Value(vector3_of(*r));
    }
    case ValueKind::pose: {
      const auto r = read_reals(s, at, kPoseReals);
      if (!r) return std::nullopt;
      return Value(pose_of(*r));
    }
    case ValueKind::motion: {
      const auto r = read_reals(s, at + 1, kMotionReals);
      if (!r || s.kind(at) != Kind::integer) return std::nullopt;
      return Value(motion_of(BenchTime(s.integer(at)), *r));
    }
    case ValueKind::numbers: {
      if (s.kind(at) != Kind::blob) return std::nullopt;
      auto r = doubles(s.blob(at));
      if (!r) return std::nullopt;
      return Value(Numbers(std::move(*r)));
    }
    case ValueKind::blob: {
      if (s.kind(at) != Kind::blob) return std::nullopt;
      const auto b = s.blob(at);
      return Value(Blob(std::vector<std::byte>(b.begin(), b.end())));
    }
  }
  return std::nullopt;
}

void bind_cell(Statement& s, int at, const Value& value, std::vector<double>& scratch) {
  const auto kind = kind_of(value);
  if (kind != ValueKind::vector3 && kind != ValueKind::pose && kind != ValueKind::motion)
    return bind_columns(s, at, value);
  scratch = reals_of(value);
  if (kind == ValueKind::motion) {
    const std::int64_t t = std::get<Motion>(value).t_ref.ns();
    double bits = 0;
    std::memcpy(&bits, &t, sizeof t);
    scratch.insert(scratch.begin(), bits);
  }
  s.bind_blob(at, std::as_bytes(std::span(scratch)));
}

std::optional<Value> read_cell(const Statement& s, int at, ValueKind kind) {
  if (kind != ValueKind::vector3 && kind != ValueKind::pose && kind != ValueKind::motion)
    return read_columns(s, at, kind);
  if (s.kind(at) != Statement::Kind::blob) return std::nullopt;
  const auto r = doubles(s.blob(at));
  const std::size_t expected = kind == ValueKind::vector3 ? 3
                               : kind == ValueKind::pose  ? kPoseReals
                                                          : kMotionReals + 1;
  if (!r || r->size() != expected) return std::nullopt;
  if (kind == ValueKind::vector3) return Value(vector3_of(*r));
  if (kind == ValueKind::pose) return Value(pose_of(*r));
  std::int64_t t = 0;
  std::memcpy(&t, s.blob(at).data(), sizeof t);
  return Value(motion_of(BenchTime(t), std::span(*r).subspan(1)));
}

std::optional<ValueKind> kind_named(std::string_view name) {
  for (std::size_t k = 0; k < std::variant_size_v<Value>; ++k)
    if (name_of(static_cast<ValueKind>(k)) == name) return static_cast<ValueKind>(k);
  return std::nullopt;
}

std::vector<double> reals_of(const Value& value) {
  std::vector<double> out;
  if (const auto* v = std::get_if<Vector3>(&value)) append(out, *v);
  if (const auto* p = std::get_if<Pose>(&value)) append(out, *p);
  if (const auto* m = std::get_if<Motion>(&value)) {
    append(out, m->T_parent_node);
    append(out, m->velocity_m_per_s);
    append(out, m->angular_velocity_rad_per_s);
  }
  return out;
}
Vector3 vector3_of(std::span<const double> v) { return {v[0], v[1], v[2]}; }
Pose pose_of(std::span<const double> v) {
  Pose T = Pose::Identity();
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 4; ++column)
      T.matrix()(row, column) = v[static_cast<std::size_t>(row * 4 + column)];
  return T;
}
Motion motion_of(BenchTime t_ref, std::span<const double> v) {
  return {.t_ref = t_ref,
          .T_parent_node = pose_of(v),
          .velocity_m_per_s = vector3_of(v.subspan(12)),
          .angular_velocity_rad_per_s = vector3_of(v.subspan(15))};
}

// ---------------------------------------------------------------- base64

namespace {
constexpr std::string_view kDigits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
}

std::string base64(std::span<const std::byte> bytes) {
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const auto n = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t word = 0;
    for (std::size_t k = 0; k < 3; ++k)
      word = word << 8 | (k < n ? static_cast<std::uint32_t>(bytes[i + k]) : 0U);
    for (std::size_t k = 0; k < 4; ++k) out += k <= n ? kDigits[word >> (18 - 6 * k) & 63U] : '=';
  }
  return out;
}

std::optional<std::vector<std::byte>> from_base64(std::string_view text) {
  if (text.size() % 4 != 0) return std::nullopt;
  std::vector<std::byte> out;
  out.reserve(text.size() / 4 * 3);
  for (std::size_t i = 0; i < text.size(); i += 4) {
    const bool last = i + 4 == text.size();
    const std::size_t pads = last ? (text[i + 3] == '=') + (text[i + 3] == '=' && text[i + 2] == '=') : 0;
    std::uint32_t word = 0;
    for (std::size_t k = 0; k < 4; ++k) {
      const auto digit = k >= 4 - pads ? 0 : kDigits.find(text[i + k]);
      if (digit == std::string_view::npos) return std::nullopt;
      word = word << 6 | static_cast<std::uint32_t>(digit);
    }
    for (std::size_t k = 0; k < 3 - pads; ++k)
      out.push_back(static_cast<std::byte>(word >> (16 - 8 * k) & 255U));
    if (pads > 0 && (word & ((1U << (8 * pads)) - 1)) != 0)
      return std::nullopt;  // bits that nobody would write
  }
  return out;
}

}  // namespace rigor::world::store
