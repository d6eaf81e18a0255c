#include "apps/forest-localization/crane.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor::forest {

CranePlace place_of_head(const CraneGeometry& c, const CraneAngles& a) noexcept {
  const double stick_m = c.stick_m + a.telescope_m, stick_rad = a.boom_rad + a.stick_rad;
  const double r = c.boom_m * std::cos(a.boom_rad) + stick_m * std::cos(stick_rad);
  const double up = c.boom_m * std::sin(a.boom_rad) + stick_m * std::sin(stick_rad);
  return {c.foot_x_m + r * std::cos(a.slew_rad), c.foot_y_m + r * std::sin(a.slew_rad),
          c.foot_z_m + up - c.head_m};
}

std::optional<CraneAngles> angles_for(const CraneGeometry& c, const CranePlace& head) noexcept {
  constexpr double kStep_m = 0.05;
  const auto within = [](double x, double least, double greatest) { return x >= least && x <= greatest; };
  CraneAngles a;
  a.slew_rad = std::atan2(head.y_m - c.foot_y_m, head.x_m - c.foot_x_m);
  if (!within(a.slew_rad, c.least.slew_rad, c.greatest.slew_rad)) return std::nullopt;
  const double r = std::hypot(head.x_m - c.foot_x_m, head.y_m - c.foot_y_m);
  const double up = head.z_m + c.head_m - c.foot_z_m;
  const double d = std::hypot(r, up), b = c.boom_m;
  for (double telescope_m = c.least.telescope_m; telescope_m <= c.greatest.telescope_m + 1e-9;
       telescope_m += kStep_m) {
    const double s = c.stick_m + telescope_m;
    const double cos_elbow = (b * b + s * s - d * d) / (2 * b * s);
    const double cos_foot = (b * b + d * d - s * s) / (2 * b * d);
    if (!(std::abs(cos_elbow) <= 1 && std::abs(cos_foot) <= 1)) continue;
    a.telescope_m = telescope_m;
    a.boom_rad = std::atan2(up, r) + std::acos(cos_foot);
    a.stick_rad = std::acos(cos_elbow) - std::numbers::pi;
    if (within(a.boom_rad, c.least.boom_rad, c.greatest.boom_rad) &&
        within(a.stick_rad, c.least.stick_rad, c.greatest.stick_rad))
      return a;
  }
  return std::nullopt;
}

CraneWork::CraneWork(const CraneWorkConfig& config) : config_(config) {}

std::optional<std::array<CraneAngles, 2>> CraneWork::way_to(double x_m, double y_m) const noexcept {
  const CraneGeometry& c = config_.crane;
  const double dx = x_m - c.foot_x_m, dy = y_m - c.foot_y_m, r = std::hypot(dx, dy);
  if (!(r > config_.short_of_m)) return std::nullopt;
  const double keep = (r - config_.short_of_m) / r;
  const auto before = angles_for(c, {c.foot_x_m + keep * dx, c.foot_y_m + keep * dy, config_.cut_height_m});
  const auto at = angles_for(c, {x_m, y_m, config_.cut_height_m});
  if (!before || !at) return std::nullopt;
  return std::array{*before, *at};
}

bool CraneWork::reaches(double x_m, double y_m) const noexcept { return way_to(x_m, y_m).has_value(); }

bool CraneWork::begin(double x_m, double y_m, const CraneTold& told, BenchTime now) noexcept {
  if (busy()) return false;
  const auto way = way_to(x_m, y_m);
  if (!way) return false;
  before_ = (*way)[0];
  at_ = (*way)[1];
  felled_before_ = told.felled;
  success_ = false;
  enter(State::swing, now);
  return true;
}

bool CraneWork::is_at(const CraneAngles& to, const CraneTold& told) const noexcept {
  const double rad = config_.angle_tolerance_rad;
  return std::abs(told.angles.slew_rad - to.slew_rad) < rad &&
         std::abs(told.angles.boom_rad - to.boom_rad) < rad &&
         std::abs(told.angles.stick_rad - to.stick_rad) < rad &&
         std::abs(told.angles.telescope_m - to.telescope_m) < config_.length_tolerance_m;
}

void CraneWork::enter(State state, BenchTime now) noexcept {
  state_ = state;
  since_ = now;
}

CraneCommand CraneWork::step(const CraneTold& told, BenchTime now) noexcept {
  const Duration passed = now - since_;
  const bool late = passed > config_.patience;
  switch (state_) {
    case State::rest:
      break;
    case State::swing:
      if (is_at(before_, told))
        enter(State::reach, now);
      else if (late)
        enter(State::fold, now);
      break;
    case State::reach:
      if (is_at(at_, told))
        enter(State::grip, now);
      else if (late)
        enter(State::fold, now);
      break;
    case State::grip:
      if (passed > config_.grip_time) enter(State::cut, now);
      break;
    case State::cut:
      success_ = told.felled > felled_before_;
      if (success_ || passed > config_.grip_time) enter(State::release, now);
      break;
    case State::release:
      if (passed > config_.grip_time) enter(State::fold, now);
      break;
    case State::fold:
      if (is_at(config_.rest, told) || late) {
        ++(success_ ? cut_ : failed_);
        enter(State::rest, now);
      }
      break;
  }
  CraneCommand c;
  switch (state_) {
    case State::rest:
    case State::fold:
      c.to = config_.rest;
      break;
    case State::swing:
      c.to = before_;
      break;
    default:
      c.to = at_;
  }
  c.grip = state_ == State::grip || state_ == State::cut ? 1 : 0;
  c.fell = state_ == State::cut ? 1 : 0;
  return c;
}

}  // namespace rigor::forest
