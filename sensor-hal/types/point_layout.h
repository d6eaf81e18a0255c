// How the points of a cloud lie in a message of ROS 2. Samples have one layout, LidarPoint; what others read
// is chosen for each channel by its key `points` (docs/recording.md). sensor-hal/record/point_layout.h packs
// them.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>
#include <utility>

namespace rigor {

enum class PointLayout : std::uint8_t { rigor, velodyne, ouster, livox };

inline constexpr std::array<std::pair<std::string_view, PointLayout>, 4> kPointLayouts{
    {{"rigor", PointLayout::rigor},
     {"velodyne", PointLayout::velodyne},
     {"ouster", PointLayout::ouster},
     {"livox", PointLayout::livox}}};

[[nodiscard]] constexpr std::optional<PointLayout> point_layout_named(std::string_view name) noexcept {
  for (const auto& [word, layout] : kPointLayouts)
    if (word == name) return layout;
  return std::nullopt;
}
[[nodiscard]] constexpr std::string_view name_of(PointLayout layout) noexcept {
  for (const auto& [word, l] : kPointLayouts)
    if (l == layout) return word;
  return "";
}

}  // namespace rigor
