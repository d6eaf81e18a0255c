#include "bench/sensing/sample_json.h"

#include <nlohmann/json.hpp>

namespace rigor {
namespace {

const char* name_of(FixStatus status) {
  switch (status) {
    case FixStatus::fix:
      return "fix";
    case FixStatus::sbas:
      return "sbas";
    case FixStatus::rtk_float:
      return "rtk_float";
    case FixStatus::rtk_fixed:
      return "rtk_fixed";
    case FixStatus::none:
      break;
  }
  return "none";
}

}  // namespace

nlohmann::json sample_json(const Sample& sample) {
  if (const auto* imu = sample.as<ImuSample>())
    return {{"specific_force_mps2", imu->specific_force_mps2},
            {"angular_rate_radps", imu->angular_rate_radps},
            {"temperature_c", imu->temperature_c}};
  if (const auto* fix = sample.as<NavFix>())
    return {{"status", name_of(fix->status)},    {"satellites", fix->satellites},
            {"latitude_deg", fix->latitude_deg}, {"longitude_deg", fix->longitude_deg},
            {"height_m", fix->height_m},         {"covariance_enu_m2", fix->covariance_enu_m2}};
  if (const auto* o = sample.as<Odometry>())
    return {
        {"T_odom_base",
         {{"position_m", o->T_odom_base.position_m}, {"orientation_wxyz", o->T_odom_base.orientation_wxyz}}},
        {"velocity_mps", o->velocity_mps},
        {"turn_rate_radps", o->turn_rate_radps},
        {"pose_variance", o->pose_variance},
        {"twist_variance", o->twist_variance},
        {"wheel_angle_rad", o->wheel_angle_rad},
        {"wheel_rate_radps", o->wheel_rate_radps}};
  return nullptr;
}

}  // namespace rigor
