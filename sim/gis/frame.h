// Between the WGS84 ellipsoid and the world frame (east, north, up at an anchor): exact everywhere, by
// GeographicLib.
#pragma once

#include <GeographicLib/LocalCartesian.hpp>
#include <span>

#include "sim/gis/import.h"
#include "sim/world/graph/value.h"

namespace rigor::gis {

/// On WGS84; the height is above the ellipsoid.
struct GeoPoint {
  double latitude_deg = 0, longitude_deg = 0, height_m = 0;
};

class LocalFrame {
 public:
  explicit LocalFrame(const Anchor& anchor);
  [[nodiscard]] const Anchor& anchor() const noexcept { return anchor_; }
  [[nodiscard]] world::Vector3 to_world(const GeoPoint& p) const;
  [[nodiscard]] GeoPoint to_geo(const world::Vector3& p_world) const;
  /// The z at (x, y) whose height above the ellipsoid is `height_m`.
  [[nodiscard]] double z_at_height(double x_m, double y_m, double height_m) const;

 private:
  Anchor anchor_;
  GeographicLib::LocalCartesian local_;
};

/// Longitude brought to [-180, 180]; bad_input where a number is not finite or the latitude beyond a pole.
/// The height may be NaN.
[[nodiscard]] Result<Anchor> checked(Anchor anchor, std::string where);

/// The place in the middle of points, also across the antimeridian and around a pole; height 0. Precondition:
/// not empty.
[[nodiscard]] GeoPoint middle_of(std::span<const GeoPoint> points);

/// From a plot's frame to the ellipsoid: x, y in the plane that touches the ellipsoid at the plot's origin.
[[nodiscard]] GeoPoint from_plot(const Plot& plot, double x_m, double y_m);

}  // namespace rigor::gis
