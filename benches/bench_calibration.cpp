// Calibration: time against error.
//
// Cameras: the same corners through Rigor's fit (robust, with outliers named, with the covariance and the
// map of projection uncertainty) and through cv::calibrateCamera with its standard deviations, both with k1
// k2 p1 p2 k3, in one run; and the error of both against the camera that the corners came from.
//
// Time of flight: bench_calibration_tof.h.
//
//   bench_calibration [--json FILE] [--rounds N] [--only camera|tof|lidar]
#include <Eigen/SVD>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <opencv2/calib3d.hpp>
#include <string>
#include <vector>

#include "benches/bench_calibration_lidar.h"
#include "benches/bench_calibration_tof.h"
#include "calibration/camera/camera_fit.h"
#include "tests/calibration/camera/board_scene.h"

namespace {

using namespace rigor;
using namespace rigor::calibration;

[[noreturn]] void give_up(const std::string& what) {
  std::fprintf(stderr, "bench: %s\n", what.c_str());
  std::exit(1);
}
template <class T>
T need(Result<T> r) {
  if (!r) give_up(r.error().text());
  return std::move(*r);
}
/// Of `rounds` calls after one to warm up, or of those that fit into 5 s.
template <class F>
double median_ms(int rounds, F&& work) {
  std::vector<double> ms;
  double all = 0;
  for (int i = 0; i <= rounds && all < 5000; ++i) {
    const auto begun = std::chrono::steady_clock::now();
    work();
    const double t =
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begun).count();
    all += t;
    if (i > 0 || all >= 5000) ms.push_back(t);
  }
  std::sort(ms.begin(), ms.end());
  return ms.empty() ? 0 : ms[ms.size() / 2];
}

struct Row {
  std::size_t views = 0, corners = 0;
  double rigor_ms = 0, opencv_ms = 0;
  double rigor_error_px = 0, opencv_error_px = 0, rigor_sigma_px = 0;
};

/// RMS over the picture of how far a ray falls from where it falls in truth, after the best rotation.
double error_px(const CameraModel& fitted, const CameraModel& truth) {
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  double rms = 0;
  for (int round = 0; round < 4; ++round) {
    Eigen::Matrix3d h = Eigen::Matrix3d::Zero();
    double sum = 0;
    int n = 0;
    for (double v = 0; v < truth.height_px; v += 20)
      for (double u = 0; u < truth.width_px; u += 20) {
        const auto ray = unproject_ray(truth, {u, v});
        if (!ray) continue;
        const Eigen::Vector3d a(ray->x, ray->y, ray->z), b = turn * a;
        const auto q = project_ray(fitted, {b.x(), b.y(), b.z()});
        const auto back = unproject_ray(fitted, {u, v});
        if (!q || !back) continue;
        sum += (q->u_px - u) * (q->u_px - u) + (q->v_px - v) * (q->v_px - v);
        h += Eigen::Vector3d(back->x, back->y, back->z) * a.transpose();
        ++n;
      }
    rms = n > 0 ? std::sqrt(sum / n) : 0;
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(h, Eigen::ComputeFullU | Eigen::ComputeFullV);
    turn = svd.matrixU() * svd.matrixV().transpose();
  }
  return rms;
}

Row camera_row(int count, int rounds) {
  const CameraModel truth = test::true_camera(LensModel::opencv5);
  test::Scene scene;
  scene.views = count;
  scene.noise_px = 0.15;
  const auto views = test::random_views(truth, scene, 1);
  Row row;
  row.views = views.size();
  std::vector<std::vector<cv::Point3f>> objects;
  std::vector<std::vector<cv::Point2f>> pictures;
  for (const BoardView& v : views) {
    objects.emplace_back();
    pictures.emplace_back();
    for (const BoardPoint& p : v.points) {
      objects.back().emplace_back(static_cast<float>(p.x_m), static_cast<float>(p.y_m), 0.F);
      pictures.back().emplace_back(static_cast<float>(p.u_px), static_cast<float>(p.v_px));
      ++row.corners;
    }
  }
  CameraModel ours, theirs = truth;
  row.rigor_ms = median_ms(rounds, [&] {
    const auto fit = need(fit_camera(views, {.models = {LensModel::opencv5}}));
    ours = fit.camera;
    double sum = 0;
    int n = 0;
    for (const double s : fit.uncertainty.sigma_px)
      if (std::isfinite(s)) sum += s * s, ++n;
    row.rigor_sigma_px = std::sqrt(sum / std::max(1, n));
  });
  row.rigor_error_px = error_px(ours, truth);
  // OpenCV takes 24 s at 100 views: beyond this it is no longer a comparison but a wait.
  if (count > 200) return row;
  row.opencv_ms = median_ms(count > 50 ? 1 : rounds, [&] {
    cv::Mat k, d, deviations, extrinsic_deviations, errors;
    std::vector<cv::Mat> r, t;
    cv::calibrateCamera(objects, pictures, {truth.width_px, truth.height_px}, k, d, r, t, deviations,
                        extrinsic_deviations, errors);
    theirs.fx_px = k.at<double>(0, 0), theirs.fy_px = k.at<double>(1, 1);
    theirs.cx_px = k.at<double>(0, 2), theirs.cy_px = k.at<double>(1, 2);
    const auto* c = d.ptr<double>();
    theirs.lens = {c[0], c[1], c[2], c[3], c[4]};
  });
  row.opencv_error_px = error_px(theirs, truth);
  return row;
}

nlohmann::json camera_rows(int rounds) {
  nlohmann::json rows = nlohmann::json::array();
  std::printf("camera, k1 k2 p1 p2 k3, corners with 0.15 px of noise; error: RMS over the picture\n");
  std::printf("%6s %8s  %10s %9s %10s  %9s %9s %9s\n", "views", "corners", "rigor ms", "a view", "OpenCV ms",
              "rigor px", "its sigma", "OpenCV px");
  for (const int count : {10, 13, 30, 100, 300, 1000}) {
    const Row row = camera_row(count, rounds);
    const double a_view_ms = row.rigor_ms / static_cast<double>(std::max<std::size_t>(1, row.views));
    std::printf("%6zu %8zu  %10.1f %9.2f %10s  %9.4f %9.4f %9s\n", row.views, row.corners, row.rigor_ms,
                a_view_ms, row.opencv_ms > 0 ? std::to_string(row.opencv_ms).substr(0, 8).c_str() : "-",
                row.rigor_error_px, row.rigor_sigma_px,
                row.opencv_ms > 0 ? std::to_string(row.opencv_error_px).substr(0, 6).c_str() : "-");
    std::fflush(stdout);
    nlohmann::json j = {{"views", row.views},
                        {"corners", row.corners},
                        {"rigor_ms", row.rigor_ms},
                        {"rigor_ms_per_view", a_view_ms},
                        {"rigor_error_px", row.rigor_error_px},
                        {"rigor_sigma_px", row.rigor_sigma_px}};
    if (row.opencv_ms > 0) j["opencv_ms"] = row.opencv_ms, j["opencv_error_px"] = row.opencv_error_px;
    rows.push_back(j);
  }
  return rows;
}

}  // namespace

int main(int argc, char** argv) {
  std::string json;
  std::string only;
  int rounds = 15;
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string key = argv[i];
    if (key == "--json")
      json = argv[i + 1];
    else if (key == "--rounds" && std::atoi(argv[i + 1]) > 0)
      rounds = std::atoi(argv[i + 1]);
    else if (key == "--only")
      only = argv[i + 1];
    else
      give_up(key + ": expected --json FILE, --rounds N or --only camera|tof|lidar");
  }
  nlohmann::json out = {{"bench", "calibration"}};
  if (only.empty() || only == "camera") out["camera"] = camera_rows(rounds);
  if (only.empty() || only == "tof") out["tof"] = bench::tof_rows();
  if (only.empty() || only == "lidar") out["lidar"] = bench::lidar_rows();
  if (!json.empty()) {
    std::ofstream file(json);
    file << out.dump(2) << '\n';
    if (!file) give_up(json + ": cannot be written");
  }
  return 0;
}
