#include "sensor-hal/channel/typed_values.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "rt-core/numbers.h"
#include "sensor-hal/types/orientation.h"

namespace rigor {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180;

constexpr ValueName kPose[] = {{"x_m", "m"},        {"y_m", "m"},         {"z_m", "m"},
                               {"roll_deg", "deg"}, {"pitch_deg", "deg"}, {"yaw_deg", "deg"}};
constexpr ValueName kImu[] = {{"force_x_mps2", "m/s^2"}, {"force_y_mps2", "m/s^2"}, {"force_z_mps2", "m/s^2"},
                              {"rate_x_degps", "deg/s"}, {"rate_y_degps", "deg/s"}, {"rate_z_degps", "deg/s"},
                              {"temperature_c", "degC"}};
constexpr ValueName kFix[] = {{"latitude_deg", "deg"},  {"longitude_deg", "deg"}, {"height_m", "m"},
                              {"status", ""},           {"satellites", ""},       {"sigma_horizontal_m", "m"},
                              {"sigma_vertical_m", "m"}};
constexpr ValueName kOdometry[] = {{"x_m", "m"},
                                   {"y_m", "m"},
                                   {"yaw_deg", "deg"},
                                   {"velocity_mps", "m/s"},
                                   {"turn_rate_degps", "deg/s"},
                                   {"left_angle", "rad"},
                                   {"right_angle", "rad"},
                                   {"left_rate", "rad/s"},
                                   {"right_rate", "rad/s"}};

/// How many of the values have to be there, from the first on.
std::size_t needed(SampleKind kind) { return kind == SampleKind::pose ? 2 : kind == SampleKind::imu ? 6 : 3; }

}  // namespace

std::span<const ValueName> values_of_kind(SampleKind kind) {
  switch (kind) {
    case SampleKind::pose:
      return kPose;
    case SampleKind::imu:
      return kImu;
    case SampleKind::nav_fix:
      return kFix;
    case SampleKind::odometry:
      return kOdometry;
    default:
      return {};
  }
}

void values_of_sample(const Sample& sample, std::span<double> out) noexcept {
  std::fill(out.begin(), out.end(), kNaN);
  if (const auto* p = sample.as<Pose>(); p && out.size() == std::size(kPose)) {
    const auto rpy = roll_pitch_yaw_of(p->orientation_wxyz);
    for (std::size_t i = 0; i < 3; ++i) out[i] = p->position_m[i], out[3 + i] = rpy[i] / kRadPerDeg;
  } else if (const auto* m = sample.as<ImuSample>(); m && out.size() == std::size(kImu)) {
    for (std::size_t i = 0; i < 3; ++i)
      out[i] = m->specific_force_mps2[i], out[3 + i] = m->angular_rate_radps[i] / kRadPerDeg;
    out[6] = m->temperature_c;
  } else if (const auto* f = sample.as<NavFix>(); f && out.size() == std::size(kFix)) {
    if (f->status != FixStatus::none)
      out[0] = f->latitude_deg, out[1] = f->longitude_deg, out[2] = f->height_m;
    out[3] = static_cast<double>(f->status);
    out[4] = f->satellites;
    const auto& c = f->covariance_enu_m2;
    out[5] = std::sqrt(std::max(c[0], c[4]));
    out[6] = std::sqrt(c[8]);
  } else if (const auto* o = sample.as<Odometry>(); o && out.size() == std::size(kOdometry)) {
    const double values[] = {o->T_odom_base.position_m[0],
                             o->T_odom_base.position_m[1],
                             yaw_of(o->T_odom_base.orientation_wxyz) / kRadPerDeg,
                             o->velocity_mps[0],
                             o->turn_rate_radps[2] / kRadPerDeg,
                             o->wheel_angle_rad[0],
                             o->wheel_angle_rad[1],
                             o->wheel_rate_radps[0],
                             o->wheel_rate_radps[1]};
    std::copy(std::begin(values), std::end(values), out.begin());
  }
}

Result<TypedValues> TypedValues::make(SampleKind kind, const std::vector<std::string>& names,
                                      const WheelGeometry& wheels) {
  const auto all = values_of_kind(kind);
  TypedValues v;
  v.kind_ = kind;
  v.wheels_ = wheels;
  v.at_.fill(kNone);
  for (std::size_t i = 0; i < all.size(); ++i) {
    const auto it = std::find(names.begin(), names.end(), all[i].name);
    if (it != names.end()) v.at_[i] = static_cast<std::size_t>(it - names.begin());
  }
  std::string missing;
  for (std::size_t i = 0; i < std::min(needed(kind), all.size()); ++i)
    if (v.at_[i] == kNone) missing += std::string(missing.empty() ? "" : ", ") + all[i].name;
  if (missing.empty() && !all.empty()) return v;
  std::string told;
  for (const std::string& n : names) told += (told.empty() ? "" : ", ") + n;
  if (kind == SampleKind::odometry) {
    v.by_angles_ = v.at_[5] != kNone && v.at_[6] != kNone;
    if (v.by_angles_ && wheels.wheel_radius_m > 0 && wheels.track_m > 0) return v;
    return fail(ErrorCode::bad_input, "",
                v.by_angles_
                    ? "expected `wheel_radius_m` and `track_m` (the effective one) for odometry of wheel "
                      "angles, got none"
                    : "expected values x_m, y_m, yaw_deg or left_angle, right_angle for odometry, got " +
                          (told.empty() ? "none" : told));
  }
  return fail(ErrorCode::bad_input, "",
              "expected values with the names " +
                  (missing.empty() ? "of a pose, an imu, a nav_fix or odometry" : missing) + ", got " +
                  (told.empty() ? "none" : told) + "; `name` gives a value another one");
}

double TypedValues::value(const RegisterBlock& block, std::size_t i, double otherwise) const noexcept {
  return at_[i] < block.count ? block.value[at_[i]] : otherwise;
}

Odometry TypedValues::odometry(const RegisterBlock& block, BenchTime t, bool& known) noexcept {
  Odometry o;
  const std::array<double, 2> angle{value(block, 5, 0), value(block, 6, 0)};
  const double dt_s = (t - t_).seconds();
  o.wheel_angle_rad = angle;
  for (std::size_t side = 0; side < 2; ++side) {
    const double by_difference = seen_ && dt_s > 0 ? (angle[side] - angle_rad_[side]) / dt_s : 0;
    o.wheel_rate_radps[side] = value(block, 7 + side, by_difference);
  }
  if (!by_angles_) {
    const double x = value(block, 0, kNaN), y = value(block, 1, kNaN),
                 yaw = value(block, 2, kNaN) * kRadPerDeg;
    known = std::isfinite(x) && std::isfinite(y) && std::isfinite(yaw);
    if (known) x_m_ = x, y_m_ = y, yaw_rad_ = yaw;
    o.velocity_mps[0] = value(block, 3, 0);
    o.turn_rate_radps[2] = value(block, 4, 0) * kRadPerDeg;
  } else {
    known = std::isfinite(angle[0]) && std::isfinite(angle[1]);
    const double r = wheels_.wheel_radius_m;
    if (known && seen_) {
      const double left_m = r * (angle[0] - angle_rad_[0]), right_m = r * (angle[1] - angle_rad_[1]);
      // The chord of a circle, along the heading in its middle.
      const double way_m = (left_m + right_m) / 2, turn_rad = (right_m - left_m) / wheels_.track_m;
      const double half = turn_rad / 2;
      const double chord_m = way_m * (std::abs(half) < 1e-6 ? 1 : std::sin(half) / half);
      x_m_ += chord_m * std::cos(yaw_rad_ + half);
      y_m_ += chord_m * std::sin(yaw_rad_ + half);
      yaw_rad_ = std::remainder(yaw_rad_ + turn_rad, 2 * std::numbers::pi);
    } else if (known) {
      x_m_ = y_m_ = yaw_rad_ = 0;
    }
    o.velocity_mps[0] = r * (o.wheel_rate_radps[0] + o.wheel_rate_radps[1]) / 2;
    o.turn_rate_radps[2] = r * (o.wheel_rate_radps[1] - o.wheel_rate_radps[0]) / wheels_.track_m;
  }
  if (known) angle_rad_ = angle, t_ = t, seen_ = true;
  o.T_odom_base.position_m = {x_m_, y_m_, 0};
  o.T_odom_base.orientation_wxyz = {std::cos(yaw_rad_ / 2), 0, 0, std::sin(yaw_rad_ / 2)};
  return o;
}

bool TypedValues::convert(const RegisterBlock& block, BenchTime t, Sample& out) noexcept {
  bool known = true;
  if (kind_ == SampleKind::odometry) {
    out.info = odometry(block, t, known);
    return known;
  }
  for (std::size_t i = 0; i < needed(kind_); ++i) known = known && std::isfinite(value(block, i, kNaN));
  if (kind_ == SampleKind::pose) {
    Pose p;
    std::array<double, 3> rpy{};
    for (std::size_t i = 0; i < 3; ++i) {
      p.position_m[i] = value(block, i, 0);
      rpy[i] = value(block, 3 + i, 0) * kRadPerDeg;
      known = known && std::isfinite(p.position_m[i]) && std::isfinite(rpy[i]);
    }
    p.orientation_wxyz = from_roll_pitch_yaw(rpy[0], rpy[1], rpy[2]);
    out.info = p;
  } else if (kind_ == SampleKind::imu) {
    ImuSample m;
    for (std::size_t i = 0; i < 3; ++i) {
      m.specific_force_mps2[i] = value(block, i, kNaN);
      m.angular_rate_radps[i] = value(block, 3 + i, kNaN) * kRadPerDeg;
    }
    m.temperature_c = value(block, 6, kNaN);
    out.info = m;
  } else {
    NavFix f;
    const double status = known ? value(block, 3, 1) : 0, satellites = value(block, 4, 0);
    f.status = status >= 0 && status <= 4 ? static_cast<FixStatus>(std::lround(status)) : FixStatus::none;
    f.satellites =
        satellites >= 0 && satellites < 65536 ? static_cast<std::uint16_t>(satellites) : std::uint16_t{0};
    f.latitude_deg = value(block, 0, kNaN);
    f.longitude_deg = value(block, 1, kNaN);
    f.height_m = value(block, 2, kNaN);
    const double across = value(block, 5, 0), up = value(block, 6, 0);
    f.covariance_enu_m2[0] = f.covariance_enu_m2[4] = across * across;
    f.covariance_enu_m2[8] = up * up;
    known = true;  // that there is no fix is a thing that a receiver tells
    out.info = f;
  }
  return known;
}

}  // namespace rigor
