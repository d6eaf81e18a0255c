#include "apps/forest-localization/estimate_output.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <string>

#include "apps/forest-localization/rig_ports.h"

namespace rigor::forest {
namespace {
constexpr std::array<const char*, 16> kNames{
    "x",     "y",           "yaw",      "sigma_x",     "sigma_y",      "sigma_yaw",      "state",
    "stems", "matched",     "progress", "cross_track", "target_range", "target_bearing", "done",
    "cut",   "out_of_reach"};
}

EstimateOutput::EstimateOutput(const ConfigNode& n, const ApplicationPorts& ports, Period loop_period) {
  port_ = &find_output(n, ports);
  every_ = read_every(n, loop_period);
  const auto at = n.numbers_or("at_m", {0, 0});
  at_m_ = {at[0], at[1]};
  const auto& names = port_->describe().names;
  if (names.size() > index_.size()) throw n.error("sink", "expected a sink of at most 16 values");
  count_ = names.size();
  for (std::size_t i = 0; i < names.size(); ++i) {
    const auto it = std::find(kNames.begin(), kNames.end(), names[i]);
    if (it == kNames.end()) {
      std::string known;
      for (const char* k : kNames) known += std::string(known.empty() ? "" : ", ") + k;
      throw n.error("sink", "expected a sink whose values are among " + known + "; got \"" + names[i] + "\"");
    }
    index_[i] = static_cast<std::size_t>(it - kNames.begin());
  }
  n.finish();
}

void EstimateOutput::send(const Estimate& e, BenchTime now) noexcept {
  // Of the point of the base that is asked for: it swings with the heading.
  const Eigen::Vector3d& mean = e.pose.mean;
  const double c = std::cos(mean.z()), s = std::sin(mean.z());
  const Eigen::Vector2d arm(c * at_m_.x() - s * at_m_.y(), s * at_m_.x() + c * at_m_.y());
  Eigen::Matrix3d J = Eigen::Matrix3d::Identity();
  J(0, 2) = -arm.y(), J(1, 2) = arm.x();
  const Eigen::Matrix3d covariance = J * e.pose.covariance * J.transpose();
  const double lean = e.lean_sigma_m * e.lean_sigma_m;
  const std::array<double, kNames.size()> all{mean.x() + arm.x(),
                                              mean.y() + arm.y(),
                                              mean.z(),
                                              std::sqrt(covariance(0, 0) + lean),
                                              std::sqrt(covariance(1, 1) + lean),
                                              std::sqrt(covariance(2, 2)),
                                              e.state,
                                              e.stems,
                                              e.matched,
                                              e.progress_m,
                                              e.cross_track_m,
                                              e.target_range_m,
                                              e.target_bearing_rad,
                                              e.done ? 1.0 : 0.0,
                                              e.cut,
                                              e.out_of_reach};
  std::array<double, 16> values{};
  for (std::size_t i = 0; i < count_; ++i) values[i] = all[index_[i]];
  (void)port_->send(now, std::span(values).first(count_));
}

}  // namespace rigor::forest
