#include "calibration/pair/plane_extrinsics.h"

#include <ceres/autodiff_cost_function.h>
#include <ceres/rotation.h>
#include <Eigen/Dense>

#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>

#include "calibration/core/least_squares.h"

namespace rigor::calibration {
namespace {

struct FlatPoints {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< towards the sensor
  double rms_m = 0;                                   ///< with the plane's three degrees taken off
};

FlatPoints flat(const std::vector<Eigen::Vector3d>& points) {
  FlatPoints f;
  for (const auto& p : points) f.centre += p;
  f.centre /= static_cast<double>(points.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const auto& p : points) scatter += (p - f.centre) * (p - f.centre).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
  f.normal = eigen.eigenvectors().col(0);
  if (f.normal.dot(f.centre) > 0) f.normal = -f.normal;
  const double freedom = std::max<double>(1, static_cast<double>(points.size()) - 3);
  f.rms_m = std::sqrt(std::max(0.0, eigen.eigenvalues()[0]) / freedom);
  return f;
}

std::vector<Eigen::Vector3d> picked(const std::vector<Eigen::Vector3d>& points,
                                    const std::vector<std::size_t>& which) {
  std::vector<Eigen::Vector3d> out;
  for (const std::size_t i : which) out.push_back(points[i]);
  return out;
}

/// Of points those on the plane that most of them make: least median of squares over triples that a fixed
/// rule picks, then what lies within 4 robust standard deviations of its own plane. Empty where no three span
/// a plane.
std::vector<std::size_t> most_flat(const std::vector<Eigen::Vector3d>& points) {
  if (points.size() < 3) return {};
  // A few hundred of them, evenly taken, say where the plane is to begin with.
  std::vector<Eigen::Vector3d> some;
  const std::size_t every = std::max<std::size_t>(1, points.size() / 250);
  for (std::size_t i = 0; i < points.size(); i += every) some.push_back(points[i]);
  const auto median_distance = [](const std::vector<Eigen::Vector3d>& of, const Eigen::Vector3d& n,
                                  double d) {
    std::vector<double> r;
    r.reserve(of.size());
    for (const auto& p : of) r.push_back(std::abs(n.dot(p) - d));
    const auto middle = r.begin() + static_cast<std::ptrdiff_t>(r.size() / 2);
    std::nth_element(r.begin(), middle, r.end());
    return *middle;
  };
  double median = INFINITY, d = 0;
  Eigen::Vector3d n = Eigen::Vector3d::UnitZ();
  std::uint64_t state = 0x9E3779B97F4A7C15ULL;
  const auto pick = [&] {
    state = state * 6364136223846793005ULL + 1442695040888963407ULL;
    return points[static_cast<std::size_t>((state >> 33) % points.size())];
  };
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d a = pick(), b = pick(), c = pick();
    const Eigen::Vector3d across = (b - a).cross(c - a);
    if (across.norm() < 1e-4) continue;
    const Eigen::Vector3d unit = across.normalized();
    const double m = median_distance(some, unit, unit.dot(a));
    if (m < median) median = m, n = unit, d = unit.dot(a);
  }
  if (!std::isfinite(median)) return {};
  // Until the choice is that of its own plane: the plane of the triple is much noisier than the points, and a
  // choice by it would carry its tilt into the answer.
  std::vector<std::size_t> on, before;
  for (int round = 0; round < 30; ++round) {
    median = std::min(median, median_distance(points, n, d));
    const double limit = std::max(4 * 1.4826 * median, 1e-4);
    on.clear();
    for (std::size_t i = 0; i < points.size(); ++i)
      if (std::abs(n.dot(points[i]) - d) <= limit) on.push_back(i);
    if (on.size() < 3) return {};
    if (on == before) break;
    const FlatPoints f = flat(picked(points, on));
    n = f.normal, d = f.normal.dot(f.centre);
    before = on;
  }
  return on;
}

/// As `flat`, of the plane that most points make.
FlatPoints robustly_flat(const std::vector<Eigen::Vector3d>& points) {
  const auto on = most_flat(points);
  return flat(on.size() >= 3 ? picked(points, on) : points);
}

/// Normal of the board towards the camera.
Eigen::Vector3d board_normal(const Eigen::Isometry3d& T_camera_board) {
  const Eigen::Vector3d n = T_camera_board.linear().col(2);
  return n.dot(T_camera_board.translation()) > 0 ? Eigen::Vector3d(-n) : n;
}

/// A point of the sensor over the corrected plane.
struct PointOnPlane {
  Eigen::Isometry3d T_board_first;
  Eigen::Vector3d point;
  double per_sigma;

  template <class T>
  bool operator()(const T* translation, const T* rotation, const T* plane, T* residual) const {
    const T p[3] = {T(point.x()), T(point.y()), T(point.z())};
    T q[3];
    ceres::AngleAxisRotatePoint(rotation, p, q);
    Eigen::Matrix<T, 3, 1> x(q[0] + translation[0], q[1] + translation[1], q[2] + translation[2]);
    const Eigen::Matrix<T, 3, 1> on =
        T_board_first.linear().cast<T>() * x + T_board_first.translation().cast<T>();
    // The board's plane turned by small angles about its x and y, and shifted along its z.
    const T z = on.z() + plane[0] * (-on.y()) + plane[1] * on.x() - plane[2];
    residual[0] = z / sqrt(T(1) + plane[0] * plane[0] + plane[1] * plane[1]) * per_sigma;
    return true;
  }
};

struct PlanePrior {
  Eigen::Matrix3d root_information;
  template <class T>
  bool operator()(const T* plane, T* residual) const {
    const Eigen::Matrix<T, 3, 1> p(plane[0], plane[1], plane[2]);
    Eigen::Map<Eigen::Matrix<T, 3, 1>>(residual, 3, 1) = root_information.cast<T>() * p;
    return true;
  }
};

/// L with LᵀL the inverse of a covariance; directions that it does not know are held to 1e-6.
Eigen::Matrix3d root_information(const Eigen::Matrix3d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(covariance);
  const Eigen::Vector3d sigma = eigen.eigenvalues().cwiseMax(1e-12).cwiseSqrt();
  return sigma.cwiseInverse().asDiagonal() * eigen.eigenvectors().transpose();
}

Eigen::Isometry3d pose_of(const std::array<double, 3>& t, const std::array<double, 3>& r) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = Eigen::Vector3d(t[0], t[1], t[2]);
  const Eigen::Vector3d turned(r[0], r[1], r[2]);
  if (turned.norm() > 0)
    T.linear() = Eigen::AngleAxisd(turned.norm(), turned.normalized()).toRotationMatrix();
  return T;
}

/// Of the plane at the instant of the points: the picture's, and what the rate adds up to until then.
Eigen::Matrix3d plane_covariance_of(const PlaneObservation& s) {
  double t = 0;
  for (const double x : s.t_s) t += x / static_cast<double>(s.t_s.size());
  return s.plane_covariance + t * t * s.plane_rate_covariance;
}

/// What the camera says of its planes comes from the scatter of corners. Where the planes are farther
/// off than that (corners that are pulled aside alike, a lens that is not the sensor model's) the views show
/// by how much: the factor of their covariance with which the median view's difference from the points' own
/// plane is what chi-squared with three degrees has in its middle, 2.366. Never below 1, and 1 where it may
/// be chance.
double plane_variance_scale(const std::vector<PlaneObservation>& observations,
                            const Eigen::Isometry3d& T_camera_sensor, double sigma_point_m) {
  if (observations.size() < 5) return 1;
  struct Difference {
    Eigen::Vector3d d;
    Eigen::Matrix3d points;
    Eigen::Matrix3d plane;
  };
  std::vector<Difference> views;
  for (const PlaneObservation& s : observations) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (const std::size_t i : most_flat(s.points_m)) {
      const Eigen::Vector3d q = T_board_camera_at(s, i) * (T_camera_sensor * s.points_m[i]);
      const Eigen::Vector3d row(q.y(), -q.x(), 1);  // z = a y - b x + c
      normal += row * row.transpose();
      right += row * q.z();
    }
    const Eigen::Matrix3d inverse = normal.inverse();
    if (inverse.allFinite())
      views.push_back({inverse * right, inverse * sigma_point_m * sigma_point_m, plane_covariance_of(s)});
  }
  if (views.size() < 5) return 1;
  const auto median_at = [&](double scale) {
    std::vector<double> chi2;
    for (const Difference& v : views)
      chi2.push_back(v.d.dot(Eigen::Matrix3d(scale * v.plane + v.points).ldlt().solve(v.d)));
    const auto middle = chi2.begin() + static_cast<std::ptrdiff_t>(chi2.size() / 2);
    std::nth_element(chi2.begin(), middle, chi2.end());
    return *middle / 2.366;
  };
  // The median of n views scatters by some 1.2/sqrt(n): three of that may be chance.
  if (!(median_at(1) > 1 + 3.5 / std::sqrt(static_cast<double>(views.size())))) return 1;
  double low = 1, high = 1e6;
  for (int i = 0; i < 60; ++i) {
    const double middle = std::sqrt(low * high);
    (median_at(middle) > 1 ? low : high) = middle;
  }
  return std::sqrt(low * high);
}

Status check(const std::vector<PlaneObservation>& observations) {
  if (observations.empty())
    return fail(ErrorCode::bad_input, "pair", "expected views of a board by both sensors, got none");
  for (const auto& s : observations) {
    if (s.points_m.size() < 3)
      return fail(ErrorCode::bad_input, s.name,
                  "expected at least 3 points on the board, got " + std::to_string(s.points_m.size()));
    if (!s.t_s.empty() && s.t_s.size() != s.points_m.size())
      return fail(ErrorCode::bad_input, s.name,
                  "expected an instant for each of " + std::to_string(s.points_m.size()) + " points, got " +
                      std::to_string(s.t_s.size()));
    bool finite = s.T_camera_board.matrix().allFinite() && s.plane_covariance.allFinite() &&
                  s.rate.allFinite() && s.plane_rate_covariance.allFinite();
    for (const double t : s.t_s) finite = finite && std::isfinite(t);
    for (const auto& p : s.points_m) finite = finite && p.allFinite();
    if (!finite) return fail(ErrorCode::bad_input, s.name, "has numbers that are not finite");
  }
  return {};
}

Eigen::Isometry3d moved(const Eigen::Matrix<double, 6, 1>& by) {
  const Eigen::Vector3d r = by.head<3>();
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = by.tail<3>();
  if (r.norm() > 0) T.linear() = Eigen::AngleAxisd(r.norm(), r.normalized()).toRotationMatrix();
  return T;
}

}  // namespace

Eigen::Isometry3d T_board_camera_at(const PlaneObservation& s, std::size_t i) {
  const Eigen::Isometry3d T = s.T_camera_board.inverse();
  return s.t_s.empty() ? T : moved(s.t_s[i] * s.rate).inverse() * T;
}

void set_rate(PlaneObservation& s, double t_s, const std::vector<BoardAt>& poses,
              const Eigen::Vector3d& middle_m) {
  const Eigen::Isometry3d T = s.T_camera_board.inverse();
  const Eigen::Isometry3d half = Eigen::Translation3d(middle_m) *
                                 Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ()) *
                                 Eigen::Translation3d(-middle_m);
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  std::vector<Vector6> change;
  std::vector<double> t;
  Vector6 mean = Vector6::Zero();
  double t_mean = 0;
  for (const BoardAt& p : poses) {
    Vector6 best = Vector6::Constant(INFINITY);
    for (const auto& from : {p.T_camera_board, Eigen::Isometry3d(p.T_camera_board * half)}) {
      const Eigen::Isometry3d d = T * from;
      const Eigen::AngleAxisd turn(d.linear());
      Vector6 v;
      v << turn.axis() * turn.angle(), d.translation();
      if (v.norm() < best.norm()) best = v;
    }
    change.push_back(best), t.push_back(p.t_s - t_s);
  }
  const double n = static_cast<double>(poses.size());
  for (std::size_t i = 0; i < t.size(); ++i) mean += change[i] / n, t_mean += t[i] / n;
  double stt = 0;
  Vector6 slope = Vector6::Zero();
  for (std::size_t i = 0; i < t.size(); ++i) {
    stt += (t[i] - t_mean) * (t[i] - t_mean);
    slope += (t[i] - t_mean) * (change[i] - mean);
  }
  s.rate.setZero(), s.plane_rate_covariance.setZero();
  if (!(stt > 0)) return;
  s.rate = slope / stt;
  // What the lines leave over, against what the poses claim; chi-squared of rotations about x, y, shift along
  // z.
  double chi2 = 0;
  for (std::size_t i = 0; i < t.size(); ++i) {
    const Vector6 left = change[i] - mean - (t[i] - t_mean) * s.rate;
    const Eigen::Vector3d plane(left[0], left[1], left[5]);
    const Eigen::Vector3d scaled = poses[i].plane_covariance.ldlt().solve(plane);
    if (scaled.allFinite()) chi2 += plane.dot(scaled);
    s.plane_rate_covariance += poses[i].plane_covariance / n / stt;
  }
  if (poses.size() > 2) s.plane_rate_covariance *= std::max(1.0, chi2 / (3 * (n - 2)));
}

Eigen::Isometry3d extrinsics_from_normals(const std::vector<PlaneObservation>& observations) {
  Eigen::Matrix3d correlation = Eigen::Matrix3d::Zero();
  std::vector<FlatPoints> planes;
  for (const auto& s : observations) {
    planes.push_back(robustly_flat(s.points_m));
    correlation += board_normal(s.T_camera_board) * planes.back().normal.transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(correlation, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d fix = Eigen::Matrix3d::Identity();
  fix(2, 2) = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1;
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = svd.matrixU() * fix * svd.matrixV().transpose();
  // n · (R c + t) = d for each board.
  Eigen::MatrixXd a(static_cast<Eigen::Index>(observations.size()), 3);
  Eigen::VectorXd b(a.rows());
  for (std::size_t i = 0; i < observations.size(); ++i) {
    const Eigen::Vector3d n = board_normal(observations[i].T_camera_board);
    a.row(static_cast<Eigen::Index>(i)) = n.transpose();
    b[static_cast<Eigen::Index>(i)] =
        n.dot(observations[i].T_camera_board.translation()) - n.dot(T.linear() * planes[i].centre);
  }
  Eigen::JacobiSVD<Eigen::MatrixXd> linear(a, Eigen::ComputeThinU | Eigen::ComputeThinV);
  linear.setThreshold(1e-3);
  T.translation() = linear.solve(b);
  return T;
}

std::vector<std::size_t> points_on_board(const std::vector<Eigen::Vector3d>& cloud_m,
                                         const Eigen::Isometry3d& T_camera_board,
                                         const Eigen::Isometry3d& T_camera_sensor,
                                         const Eigen::Vector2d& size_m, double margin_m,
                                         double outline_margin_m, std::size_t least) {
  const Eigen::Isometry3d T_board_sensor = T_camera_board.inverse() * T_camera_sensor;
  std::vector<Eigen::Vector3d> near;
  std::vector<std::size_t> index;
  for (std::size_t i = 0; i < cloud_m.size(); ++i) {
    const Eigen::Vector3d& p = cloud_m[i];
    if (!p.allFinite()) continue;
    const Eigen::Vector3d q = T_board_sensor * p;
    const double o = outline_margin_m;
    if (std::abs(q.z()) <= margin_m && q.x() >= -o && q.y() >= -o && q.x() <= size_m.x() + o &&
        q.y() <= size_m.y() + o)
      near.push_back(p), index.push_back(i);
  }
  // What lies behind or beside the board came along with the margin.
  auto on = most_flat(near);
  if (on.size() < std::max<std::size_t>(least, 3)) on.clear();
  for (std::size_t& i : on) i = index[i];
  return on;
}

Result<PlaneExtrinsics> fit_plane_extrinsics(const std::vector<PlaneObservation>& observations,
                                             const PlaneExtrinsicsOptions& options) {
  if (auto s = check(observations); !s) return tl::unexpected<Error>(s.error());
  PlaneExtrinsics out;
  out.sigma_point_m = options.sigma_point_m;
  if (!(out.sigma_point_m > 0)) {
    // Pooled over views: how far points lie from the plane that is theirs alone.
    double sum = 0, freedom = 0;
    for (const auto& s : observations) {
      if (s.points_m.size() < 4) continue;
      const double n = static_cast<double>(s.points_m.size()) - 3;
      sum += std::pow(robustly_flat(s.points_m).rms_m, 2) * n;
      freedom += n;
    }
    if (!(freedom > 0))
      return fail(ErrorCode::bad_input, "pair",
                  "three points a view say nothing of the noise; give its standard deviation (--sigma)");
    out.sigma_point_m = std::max(std::sqrt(sum / freedom), 1e-6);
  }
  const Eigen::Isometry3d start = options.start ? *options.start : extrinsics_from_normals(observations);
  const Eigen::AngleAxisd turn(start.linear());
  std::array<double, 3> t{start.translation().x(), start.translation().y(), start.translation().z()};
  std::array<double, 3> r{turn.axis().x() * turn.angle(), turn.axis().y() * turn.angle(),
                          turn.axis().z() * turn.angle()};
  std::vector<std::array<double, 3>> planes(observations.size(), {0, 0, 0});

  std::vector<std::pair<std::size_t, std::size_t>> where;  // of an observation: view, point (or none: prior)
  constexpr std::size_t kPrior = ~std::size_t{0};
  // `left_out`: by id, in place of looking for outliers.
  const auto solve = [&](double plane_scale, double camera_scale,
                         const std::vector<bool>* left_out = nullptr) {
    LeastSquares fit;
    // Beyond 10 cm or 5 degrees an extrinsic is of no use.
    fit.add_block(t.data(), {{"x_m", 0.1}, {"y_m", 0.1}, {"z_m", 0.1}});
    fit.add_block(r.data(), {{"rx_rad", 0.087}, {"ry_rad", 0.087}, {"rz_rad", 0.087}});
    std::uint32_t id = 0;
    where.clear();
    for (std::size_t v = 0; v < observations.size(); ++v) {
      fit.add_nuisance(planes[v].data(), 3);
      if (!left_out || !(*left_out)[id])
        fit.add(new ceres::AutoDiffCostFunction<PlanePrior, 3, 3>(
                    new PlanePrior{root_information(plane_covariance_of(observations[v]) * plane_scale)}),
                {planes[v].data()}, id);
      ++id;
      where.emplace_back(v, kPrior);
      for (std::size_t p = 0; p < observations[v].points_m.size(); ++p) {
        Eigen::Isometry3d T_board_camera = T_board_camera_at(observations[v], p);
        T_board_camera.translation() *= camera_scale;
        if (!left_out || !(*left_out)[id])
          fit.add(new ceres::AutoDiffCostFunction<PointOnPlane, 1, 3, 3, 3>(
                      new PointOnPlane{T_board_camera, observations[v].points_m[p], 1 / out.sigma_point_m}),
                  {t.data(), r.data(), planes[v].data()}, id);
        ++id;
        where.emplace_back(v, p);
      }
    }
    FitOptions fit_options;
    fit_options.reject_sigmas = options.reject_sigmas;
    fit_options.robust = !left_out;
    fit_options.whitened = true;
    fit_options.unit = "sigma";
    fit_options.stop = options.stop;
    return fit.solve(fit_options);
  };
  double plane_scale = 1;
  auto solved = solve(plane_scale, 1);
  for (int round = 0; round < 3 && solved && !options.stop.stop_requested(); ++round) {
    const double next = plane_variance_scale(observations, pose_of(t, r), out.sigma_point_m);
    if (std::abs(next - plane_scale) <= 0.1 * plane_scale) break;
    plane_scale = next;
    solved = solve(plane_scale, 1);
  }
  if (!solved) return tl::unexpected<Error>(solved.error());
  out.plane_scale = std::sqrt(plane_scale);
  out.result = std::move(solved->fit);
  out.result.model = "planes";
  for (std::size_t i = 0; i < out.result.rejected.size() && i < solved->rejected_ids.size(); ++i) {
    const auto [v, p] = where[solved->rejected_ids[i]];
    out.result.rejected[i].what =
        observations[v].name + (p == kPrior ? std::string(" board") : " point " + std::to_string(p));
  }
  out.T_camera_sensor = pose_of(t, r);
  if (options.camera_scale_sigma > 0 && out.result.weak.empty() && !options.stop.stop_requested()) {
    // How the answer follows the factor, by a second fit to the same points; one parameter in common with all
    // views.
    constexpr double kStep = 1e-4;
    std::vector<bool> left_out(where.size());
    for (const auto id : solved->rejected_ids) left_out[id] = true;
    const auto scaled = solve(plane_scale, 1 + kStep, &left_out);
    if (scaled && !scaled->fit.interrupted) {
      FitResult& f = out.result;
      Eigen::VectorXd slope(f.covariance.rows());
      for (Eigen::Index i = 0; i < slope.size(); ++i)
        slope[i] = (scaled->fit.parameters[static_cast<std::size_t>(i)].value -
                    f.parameters[static_cast<std::size_t>(i)].value) /
                   kStep * options.camera_scale_sigma;
      f.covariance += slope * slope.transpose();
      for (Eigen::Index i = 0; i < slope.size(); ++i)
        f.parameters[static_cast<std::size_t>(i)].sigma = std::sqrt(f.covariance(i, i));
    }
  }
  double nearest = INFINITY, farthest = 0;
  for (const auto& s : observations) {
    double sum = 0, square = 0;
    for (std::size_t i = 0; i < s.points_m.size(); ++i) {
      const Eigen::Vector3d& p = s.points_m[i];
      const double z = (T_board_camera_at(s, i) * (out.T_camera_sensor * p)).z();
      sum += z, square += z * z;
      nearest = std::min(nearest, p.norm()), farthest = std::max(farthest, p.norm());
    }
    const double n = static_cast<double>(s.points_m.size());
    out.view_mean_m.push_back(sum / n);
    out.view_rms_m.push_back(std::sqrt(square / n));
  }
  out.result.validity.push_back({"board_range_m", nearest, farthest});
  for (auto& weak : out.result.weak)
    if (weak.cure.empty())
      weak.cure =
          "turn the board: its normals in the views must point in three directions that do not lie in one "
          "plane, as tilted left, right and up, each by 20 degrees and more";
  if (out.plane_scale > 1.5)
    out.result.warnings.push_back("the camera's planes are " + std::to_string(out.plane_scale).substr(0, 4) +
                                  " times as uncertain as its corners say, and were taken so: its lens is "
                                  "not quite the sensor model's, or the "
                                  "board is not flat");
  if (solved->enlarged > 1)
    out.result.warnings.push_back(
        "the points lie " + std::to_string(solved->enlarged).substr(0, 4) +
        " times as far from the planes as their noise explains, and the uncertainties were enlarged by as "
        "much: the noise is larger than stated (--sigma), or the LiDAR or time-of-flight camera has a bias, "
        "a "
        "lens, or moved");
  return out;
}

}  // namespace rigor::calibration
