#include "sim/gis/frame.h"

#include <fmt/format.h>

#include <GeographicLib/Geocentric.hpp>
#include <GeographicLib/Math.hpp>
#include <cmath>
#include <numbers>

namespace rigor::gis {

using world::Vector3;

LocalFrame::LocalFrame(const Anchor& anchor)
    : anchor_(anchor), local_(anchor.latitude_deg, anchor.longitude_deg, anchor.height_m) {}

Vector3 LocalFrame::to_world(const GeoPoint& p) const {
  Vector3 v = Vector3::Zero();
  local_.Forward(p.latitude_deg, p.longitude_deg, p.height_m, v.x(), v.y(), v.z());
  return v;
}

GeoPoint LocalFrame::to_geo(const Vector3& p_world) const {
  GeoPoint p;
  local_.Reverse(p_world.x(), p_world.y(), p_world.z(), p.latitude_deg, p.longitude_deg, p.height_m);
  return p;
}

double LocalFrame::z_at_height(double x_m, double y_m, double height_m) const {
  constexpr double kRadius_m = 6'371'000;
  double z = height_m - anchor_.height_m - (x_m * x_m + y_m * y_m) / (2 * kRadius_m);
  for (int i = 0; i < 8; ++i) {
    const double error = height_m - to_geo({x_m, y_m, z}).height_m;
    z += error;
    if (std::abs(error) < 1e-6) break;
  }
  return z;
}

Result<Anchor> checked(Anchor anchor, std::string where) {
  if (!std::isfinite(anchor.latitude_deg) || std::abs(anchor.latitude_deg) > 90)
    return fail(
        ErrorCode::bad_input, std::move(where),
        fmt::format("anchor: expected a latitude from -90 to 90 degrees, got {}", anchor.latitude_deg));
  if (!std::isfinite(anchor.longitude_deg) || std::abs(anchor.longitude_deg) > 540)
    return fail(
        ErrorCode::bad_input, std::move(where),
        fmt::format("anchor: expected a longitude from -180 to 180 degrees, got {}", anchor.longitude_deg));
  if (std::isinf(anchor.height_m) || std::abs(anchor.height_m) > 1e5)
    return fail(
        ErrorCode::bad_input, std::move(where),
        fmt::format("anchor: expected a height within 100 km of the ellipsoid, got {}", anchor.height_m));
  anchor.longitude_deg = GeographicLib::Math::AngNormalize(anchor.longitude_deg);
  return anchor;
}

GeoPoint middle_of(std::span<const GeoPoint> points) {
  const auto& earth = GeographicLib::Geocentric::WGS84();
  Vector3 sum = Vector3::Zero();
  for (const GeoPoint& p : points) {
    Vector3 v = Vector3::Zero();
    earth.Forward(p.latitude_deg, p.longitude_deg, 0, v.x(), v.y(), v.z());
    sum += v / static_cast<double>(points.size());
  }
  GeoPoint middle;
  earth.Reverse(sum.x(), sum.y(), sum.z(), middle.latitude_deg, middle.longitude_deg, middle.height_m);
  middle.height_m = 0;
  return middle;
}

GeoPoint from_plot(const Plot& plot, double x_m, double y_m) {
  const double a = plot.y_axis_azimuth_deg * std::numbers::pi / 180;
  const LocalFrame frame({plot.latitude_deg, plot.longitude_deg, 0});
  GeoPoint p =
      frame.to_geo({x_m * std::cos(a) + y_m * std::sin(a), -x_m * std::sin(a) + y_m * std::cos(a), 0});
  p.height_m = 0;
  return p;
}

}  // namespace rigor::gis
