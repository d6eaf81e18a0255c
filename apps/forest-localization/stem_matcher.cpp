#include "apps/forest-localization/stem_matcher.h"

#include <Eigen/LU>
#include <algorithm>

namespace rigor::forest {
namespace {

constexpr double kGate = 16.266;  // chi-squared of 3 degrees of freedom at 0.999

struct Candidate {
  std::uint32_t stem;
  double distance;
};

}  // namespace

std::span<const StemMatch> StemMatcher::match(std::span<const StemObservation> stems,
                                              const PoseGaussian& prior, const StemMap& map) noexcept {
  map_ = &map;
  stems_ = stems.first(std::min(stems.size(), order_.size()));
  for (std::uint32_t i = 0; i < stems_.size(); ++i) order_[i] = i;
  const auto range2 = [&](std::uint32_t i) {
    return stems_[i].x_m * stems_[i].x_m + stems_[i].y_m * stems_[i].y_m;
  };
  std::sort(order_.begin(), order_.begin() + static_cast<std::ptrdiff_t>(stems_.size()),
            [&](std::uint32_t a, std::uint32_t b) {
              return range2(a) != range2(b) ? range2(a) < range2(b) : a < b;
            });
  count_ = static_cast<std::uint32_t>(std::min(stems_.size(), kMaxMatches));
  nodes_ = 0;
  now_.count = best_.count = 0;
  now_.sum = best_.sum = 0;
  descend(0, prior);
  return {best_.match.data(), best_.count};
}

void StemMatcher::descend(std::uint32_t depth, const PoseGaussian& pose) noexcept {
  if (depth == count_) {
    if (now_.count > best_.count || (now_.count == best_.count && now_.sum < best_.sum)) best_ = now_;
    return;
  }
  // What can still come is no better than what is known.
  const std::uint32_t possible = now_.count + count_ - depth;
  if (possible < best_.count || (possible == best_.count && now_.sum >= best_.sum)) return;
  if (++nodes_ > config_.max_nodes) {
    if (now_.count > best_.count) best_ = now_;
    return;
  }
  const std::uint32_t index = order_[depth];
  const StemObservation& o = stems_[index];
  const double c = std::cos(pose.mean.z()), s = std::sin(pose.mean.z());
  const double x = pose.mean.x() + c * o.x_m - s * o.y_m, y = pose.mean.y() + s * o.x_m + c * o.y_m;

  Eigen::Matrix3d R;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) R(i, j) = o.covariance[i][j];
  R.diagonal() +=
      Eigen::Vector3d(config_.map_sigma_m * config_.map_sigma_m, config_.map_sigma_m * config_.map_sigma_m,
                      config_.map_radius_sigma_m * config_.map_radius_sigma_m);
  // A circle around the gate's ellipse; the stem's own place hardly changes H.
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();
  H.topRows<2>() = seen_from(pose.mean, x, y).by_pose;
  const Eigen::Matrix3d S = H * pose.covariance * H.transpose() + R;
  const double reach_m = std::sqrt(kGate * (S(0, 0) + S(1, 1)));

  std::array<Candidate, 6> found{};
  std::size_t candidates = 0;
  map_->near(x, y, reach_m, [&](std::uint32_t stem) {
    for (std::uint32_t k = 0; k < now_.count; ++k)
      if (now_.match[k].stem == stem) return;
    const Stem& m = (*map_)[stem];
    const Eigen::Vector2d expected = seen_from(pose.mean, m.x_m, m.y_m).p_base;
    const Eigen::Vector3d innovation(o.x_m - expected.x(), o.y_m - expected.y(), o.radius_m - m.radius_m);
    const double distance = innovation.dot(S.inverse() * innovation);
    if (!(distance < kGate) ||
        now_.sum + distance > chi_squared_999(3.0 * static_cast<double>(now_.count + 1)))
      return;
    std::size_t at = candidates < found.size() ? candidates++ : found.size() - 1;
    if (at == found.size() - 1 && candidates == found.size() && found[at].distance != 0 &&
        found[at].distance < distance)
      return;
    while (at > 0 && found[at - 1].distance > distance) found[at] = found[at - 1], --at;
    found[at] = {stem, distance};
  });

  for (std::size_t k = 0; k < candidates; ++k) {
    const Stem& m = (*map_)[found[k].stem];
    const SeenPoint seen = seen_from(pose.mean, m.x_m, m.y_m);
    Eigen::Matrix3d J = Eigen::Matrix3d::Zero();
    J.topRows<2>() = seen.by_pose;
    const Eigen::Matrix3d K =
        pose.covariance * J.transpose() * (J * pose.covariance * J.transpose() + R).inverse();
    const Eigen::Vector3d innovation(o.x_m - seen.p_base.x(), o.y_m - seen.p_base.y(),
                                     o.radius_m - m.radius_m);
    PoseGaussian next;
    next.mean = pose.mean + K * innovation;
    const Eigen::Matrix3d P = (Eigen::Matrix3d::Identity() - K * J) * pose.covariance;
    next.covariance = 0.5 * (P + P.transpose());
    now_.match[now_.count++] = {index, found[k].stem};
    now_.sum += found[k].distance;
    descend(depth + 1, next);
    now_.sum -= found[k].distance;
    --now_.count;
  }
  descend(depth + 1, pose);
}

}  // namespace rigor::forest
