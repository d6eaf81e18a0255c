// What an attribute of a node can hold.
//
// Text, numbers and blobs are immutable and shared: a copy costs a reference count, so a snapshot of the
// world never copies a raster.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "rt-core/time.h"

namespace rigor::world {

/// A node's name for life: counts up from 1, is never used again, and survives persistence. 0 is no node.
struct NodeId {
  std::uint64_t value = 0;
  auto operator<=>(const NodeId&) const = default;
  [[nodiscard]] explicit operator bool() const noexcept { return value != 0; }
};

/// An immutable, shared list of numbers: outlines (x0 y0 x1 y1 …), spectra, tables. Empty by default.
class Numbers {
 public:
  Numbers() = default;
  Numbers(std::initializer_list<double> v) : Numbers(std::vector<double>(v)) {}
  explicit Numbers(std::vector<double> v)
      : data_(v.empty() ? nullptr : std::make_shared<const std::vector<double>>(std::move(v))) {}
  [[nodiscard]] std::span<const double> span() const noexcept {
    return data_ ? std::span<const double>(*data_) : std::span<const double>();
  }
  [[nodiscard]] std::size_t size() const noexcept { return data_ ? data_->size() : 0; }
  [[nodiscard]] bool empty() const noexcept { return size() == 0; }
  [[nodiscard]] double operator[](std::size_t i) const noexcept { return (*data_)[i]; }
  bool operator==(const Numbers& o) const noexcept {
    return data_ == o.data_ || std::equal(span().begin(), span().end(), o.span().begin(), o.span().end());
  }

 private:
  std::shared_ptr<const std::vector<double>> data_;
};

/// Immutable, shared bytes: rasters, pictures.
class Blob {
 public:
  Blob() = default;
  explicit Blob(std::vector<std::byte> v)
      : data_(v.empty() ? nullptr : std::make_shared<const std::vector<std::byte>>(std::move(v))) {}
  /// Copies `v`, which is trivially copyable, as it lies in memory (little-endian).
  template <class T>
  static Blob of(std::span<const T> v) {
    const auto b = std::as_bytes(v);
    return Blob(std::vector<std::byte>(b.begin(), b.end()));
  }
  [[nodiscard]] std::span<const std::byte> span() const noexcept {
    return data_ ? std::span<const std::byte>(*data_) : std::span<const std::byte>();
  }
  /// The bytes as values of T; shorter by what does not fill one. Blobs are aligned for every T.
  template <class T>
  [[nodiscard]] std::span<const T> as() const noexcept {
    const auto s = span();
    return {reinterpret_cast<const T*>(s.data()), s.size() / sizeof(T)};
  }
  [[nodiscard]] std::size_t size() const noexcept { return data_ ? data_->size() : 0; }
  /// The object itself: equal for copies of one blob. For caches.
  [[nodiscard]] const void* identity() const noexcept { return data_.get(); }
  bool operator==(const Blob& o) const noexcept {
    return data_ == o.data_ || std::equal(span().begin(), span().end(), o.span().begin(), o.span().end());
  }

 private:
  std::shared_ptr<const std::vector<std::byte>> data_;
};

using Vector3 = Eigen::Vector3d;
using Pose = Eigen::Isometry3d;  ///< T_parent_node

/// A pose as a function of time over the interval of a snapshot: at t_ref the pose is T_parent_node, and from
/// there it moves and turns with constant accelerations, all in the parent's frame. Turning is by the
/// rotation vector ω·dt + α·dt²/2, which is exact for a fixed axis. World files keep no accelerations.
struct Motion {
  BenchTime t_ref{};
  Pose T_parent_node = Pose::Identity();
  Vector3 velocity_m_per_s = Vector3::Zero();
  Vector3 angular_velocity_rad_per_s = Vector3::Zero();
  Vector3 acceleration_m_per_s2 = Vector3::Zero();
  Vector3 angular_acceleration_rad_per_s2 = Vector3::Zero();
  [[nodiscard]] Pose at(BenchTime t) const;
  bool operator==(const Motion& o) const;
};

enum class ValueKind : std::uint8_t {
  flag,     ///< bool
  integer,  ///< std::int64_t
  number,   ///< double
  text,     ///< std::string
  vector3,  ///< Vector3
  pose,     ///< Pose
  motion,   ///< Motion
  numbers,  ///< Numbers
  blob      ///< Blob
};

/// The alternatives stand in the order of ValueKind.
using Value = std::variant<bool, std::int64_t, double, std::string, Vector3, Pose, Motion, Numbers, Blob>;

[[nodiscard]] inline ValueKind kind_of(const Value& v) noexcept { return static_cast<ValueKind>(v.index()); }
[[nodiscard]] std::string_view name_of(ValueKind kind) noexcept;
/// Equal in every bit that counts: NaN equals NaN, so that a round trip can be checked.
[[nodiscard]] bool same_value(const Value& a, const Value& b);

}  // namespace rigor::world

template <>
struct std::hash<rigor::world::NodeId> {
  std::size_t operator()(rigor::world::NodeId id) const noexcept {
    return static_cast<std::size_t>(id.value * 0x9E3779B97F4A7C15ULL);
  }
};
