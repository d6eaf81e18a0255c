#include "calibration/camera/camera_start.h"

#include <cmath>
#include <opencv2/calib3d.hpp>

namespace rigor::calibration {

double focal_length_from_views(const std::vector<BoardView>& views) {
  // ω = diag(1/f², 1/f², 1): h1ᵀ ω h2 = 0 and h1ᵀ ω h1 = h2ᵀ ω h2 are linear in 1/f².
  double ab = 0, aa = 0;
  for (const BoardView& view : views) {
    if (view.points.size() < 4) continue;
    std::vector<cv::Point2d> board, picture;
    const double cx = (view.width_px - 1) / 2.0, cy = (view.height_px - 1) / 2.0;
    for (const BoardPoint& p : view.points) {
      board.emplace_back(p.x_m, p.y_m);
      // In units of the width, so that the equations weigh alike.
      picture.emplace_back((p.u_px - cx) / view.width_px, (p.v_px - cy) / view.width_px);
    }
    const cv::Mat h = cv::findHomography(board, picture, cv::LMEDS);
    if (h.empty()) continue;
    const auto at = [&](int r, int c) { return h.at<double>(r, c); };
    const double n1 = std::sqrt(at(0, 0) * at(0, 0) + at(1, 0) * at(1, 0) + at(2, 0) * at(2, 0));
    const double n2 = std::sqrt(at(0, 1) * at(0, 1) + at(1, 1) * at(1, 1) + at(2, 1) * at(2, 1));
    const double n = n1 * n2;
    if (!(n > 0)) continue;
    const double a1 = (at(0, 0) * at(0, 1) + at(1, 0) * at(1, 1)) / n, b1 = -at(2, 0) * at(2, 1) / n;
    const double a2 =
        (at(0, 0) * at(0, 0) + at(1, 0) * at(1, 0) - at(0, 1) * at(0, 1) - at(1, 1) * at(1, 1)) / n;
    const double b2 = (at(2, 1) * at(2, 1) - at(2, 0) * at(2, 0)) / n;
    ab += a1 * b1 + a2 * b2;
    aa += a1 * a1 + a2 * a2;
  }
  const double inverse_square = aa > 0 ? ab / aa : 0;
  if (!(inverse_square > 1e-4)) return 0;  // beyond 100 widths: the views are all fronto-parallel
  const double f = views.front().width_px / std::sqrt(inverse_square);
  return f < 0.1 * views.front().width_px ? 0 : f;
}

bool pose_from_view(const BoardView& view, double fx_px, double fy_px, double cx_px, double cy_px,
                    bool fisheye, std::array<double, 6>& pose) {
  std::vector<cv::Point3d> board;
  std::vector<cv::Point2d> rays;
  for (const BoardPoint& p : view.points) {
    double x = (p.u_px - cx_px) / fx_px, y = (p.v_px - cy_px) / fy_px;
    if (fisheye) {
      const double theta = std::hypot(x, y);
      if (theta > 1.35) continue;  // tan grows beyond use
      const double k = theta > 1e-9 ? std::tan(theta) / theta : 1;
      x *= k, y *= k;
    }
    board.emplace_back(p.x_m, p.y_m, 0);
    rays.emplace_back(x, y);
  }
  if (board.size() < 4) return false;
  cv::Mat r, t;
  try {
    if (!cv::solvePnP(board, rays, cv::Mat::eye(3, 3, CV_64F), cv::Mat(), r, t, false, cv::SOLVEPNP_IPPE))
      return false;
  } catch (const cv::Exception&) {
    return false;  // points on a line
  }
  for (int i = 0; i < 3; ++i) {
    pose[static_cast<std::size_t>(i)] = r.at<double>(i);
    pose[static_cast<std::size_t>(i) + 3] = t.at<double>(i);
  }
  for (const double v : pose)
    if (!std::isfinite(v)) return false;
  return pose[5] > 0;
}

std::vector<std::array<double, 6>> poses_from_view(const BoardView& view, const CameraModel& camera,
                                                   bool robust) {
  std::vector<cv::Point3d> board;
  std::vector<cv::Point2d> rays;
  for (const BoardPoint& p : view.points) {
    const auto ray = unproject_ray(camera, {p.u_px, p.v_px});
    if (!ray || ray->z < 0.2) continue;  // tan grows beyond use
    board.emplace_back(p.x_m, p.y_m, 0);
    rays.emplace_back(ray->x / ray->z, ray->y / ray->z);
  }
  std::vector<std::array<double, 6>> poses;
  if (board.size() < 4) return poses;
  if (robust) {
    std::vector<cv::Point2d> flat;
    for (const auto& p : board) flat.emplace_back(p.x, p.y);
    std::vector<unsigned char> fits;
    if (!cv::findHomography(flat, rays, cv::LMEDS, 3, fits).empty()) {
      std::size_t kept = 0;
      for (std::size_t i = 0; i < fits.size(); ++i)
        if (fits[i]) board[kept] = board[i], rays[kept] = rays[i], ++kept;
      board.resize(kept), rays.resize(kept);
      if (kept < 4) return poses;
    }
  }
  std::vector<cv::Mat> r, t;
  try {
    cv::solvePnPGeneric(board, rays, cv::Mat::eye(3, 3, CV_64F), cv::Mat(), r, t, false, cv::SOLVEPNP_IPPE);
  } catch (const cv::Exception&) {
    return poses;  // points on a line
  }
  for (std::size_t k = 0; k < r.size(); ++k) {
    std::array<double, 6> pose{};
    bool good = true;
    for (int i = 0; i < 3; ++i) {
      pose[static_cast<std::size_t>(i)] = r[k].at<double>(i);
      pose[static_cast<std::size_t>(i) + 3] = t[k].at<double>(i);
    }
    for (const double x : pose) good = good && std::isfinite(x);
    if (good && pose[5] > 0) poses.push_back(pose);
  }
  return poses;
}

}  // namespace rigor::calibration
