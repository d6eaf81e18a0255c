#include "sim/platform/trajectory.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <numbers>

#include "sim/platform/signal_registers.h"

namespace rigor {
namespace {

using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

Quaterniond quaternion(const Pose& pose) {
  const auto& q = pose.orientation_wxyz;
  return Quaterniond(q[0], q[1], q[2], q[3]).normalized();
}

Vector3d rotation_vector(Quaterniond q) {
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  const double sine = q.vec().norm();
  return q.vec() * (sine < 1e-9 ? 2 : 2 * std::atan2(sine, q.w()) / sine);
}
Quaterniond turned_by(const Vector3d& r) {
  const double angle = r.norm();
  const double k = angle < 1e-6 ? 0.5 - angle * angle / 48 : std::sin(angle / 2) / angle;
  return Quaterniond(std::cos(angle / 2), k * r.x(), k * r.y(), k * r.z()).normalized();
}
Matrix3d skew(const Vector3d& v) {
  Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}
/// Turn rate in the body's axes of q = exp(r) is J(r)·r': the right Jacobian of SO(3) (Solà, "A micro Lie
/// theory", eq. 143), by its series where the angle is small.
Matrix3d right_jacobian(const Vector3d& r) {
  const double a = r.norm();
  const Matrix3d s = skew(r);
  const double b = a < 1e-3 ? 0.5 - a * a / 24 : (1 - std::cos(a)) / (a * a);
  const double c = a < 1e-3 ? 1.0 / 6 - a * a / 120 : (a - std::sin(a)) / (a * a * a);
  return Matrix3d::Identity() - b * s + c * s * s;
}
Matrix3d inverse_right_jacobian(const Vector3d& r) {
  const double a = r.norm();
  const Matrix3d s = skew(r);
  const double c =
      a < 1e-3 ? 1.0 / 12 + a * a / 720 : 1 / (a * a) - (1 + std::cos(a)) / (2 * a * std::sin(a));
  return Matrix3d::Identity() + 0.5 * s + c * s * s;
}

/// Velocities at the knots of a natural cubic spline through values (tridiagonal system, one sweep).
std::vector<Vector3d> natural_velocities(const std::vector<double>& t, const std::vector<Vector3d>& p,
                                         bool at_rest) {
  const std::size_t n = t.size();
  std::vector<double> lower(n), diagonal(n), upper(n);
  std::vector<Vector3d> right(n);
  for (std::size_t i = 0; i < n; ++i) {
    if (i == 0 || i + 1 == n) {
      const std::size_t a = i == 0 ? 0 : n - 2;
      diagonal[i] = at_rest ? 1 : 2;
      (i == 0 ? upper : lower)[i] = at_rest ? 0 : 1;
      right[i] = at_rest ? Vector3d(Vector3d::Zero()) : Vector3d(3 * (p[a + 1] - p[a]) / (t[a + 1] - t[a]));
      continue;
    }
    const double h0 = t[i] - t[i - 1], h1 = t[i + 1] - t[i];
    lower[i] = 1 / h0;
    diagonal[i] = 2 * (1 / h0 + 1 / h1);
    upper[i] = 1 / h1;
    right[i] = 3 * ((p[i] - p[i - 1]) / (h0 * h0) + (p[i + 1] - p[i]) / (h1 * h1));
  }
  for (std::size_t i = 1; i < n; ++i) {
    const double f = lower[i] / diagonal[i - 1];
    diagonal[i] -= f * upper[i - 1];
    right[i] -= f * right[i - 1];
  }
  std::vector<Vector3d> v(n);
  for (std::size_t i = n; i-- > 0;)
    v[i] =
        (right[i] - (i + 1 < n ? Vector3d(upper[i] * v[i + 1]) : Vector3d(Vector3d::Zero()))) / diagonal[i];
  return v;
}

/// Value and two derivatives, with respect to u in [0, 1], of the polynomial with these ends.
struct Curve {
  Vector3d value, first, second;
};
Curve cubic(double u, const Vector3d& p0, const Vector3d& m0, const Vector3d& p1, const Vector3d& m1) {
  const Vector3d c2 = 3 * (p1 - p0) - 2 * m0 - m1, c3 = m0 + m1 - 2 * (p1 - p0);
  return {p0 + u * (m0 + u * (c2 + u * c3)), m0 + u * (2 * c2 + 3 * u * c3), 2 * c2 + 6 * u * c3};
}
Curve quintic(double u, const Vector3d& p0, const Vector3d& m0, const Vector3d& a0, const Vector3d& p1,
              const Vector3d& m1, const Vector3d& a1) {
  const Vector3d d = p1 - p0 - m0 - 0.5 * a0, e = m1 - m0 - a0, f = a1 - a0;
  const Vector3d c3 = 10 * d - 4 * e + 0.5 * f, c4 = -15 * d + 7 * e - f, c5 = 6 * d - 3 * e + 0.5 * f;
  return {p0 + u * (m0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5)))),
          m0 + u * (a0 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5))),
          a0 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))};
}

void put(std::array<double, 3>& to, const Vector3d& v) { to = {v.x(), v.y(), v.z()}; }

}  // namespace

Result<Trajectory> Trajectory::make(std::span<const TimedPose> poses, PathSpline spline) {
  if (poses.size() < 2)
    return fail(ErrorCode::bad_input, "poses", fmt::format("expected at least two, got {}", poses.size()));
  Trajectory out;
  out.spline_ = spline;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const TimedPose& p = poses[i];
    double sum = p.t_s;
    for (const double x : p.T_world_body.position_m) sum += x;
    for (const double x : p.T_world_body.orientation_wxyz) sum += x;
    if (!std::isfinite(sum))
      return fail(ErrorCode::bad_input, fmt::format("pose {}", i + 1), "expected finite numbers");
    if (i > 0 && p.t_s <= poses[i - 1].t_s)
      return fail(ErrorCode::bad_input, fmt::format("pose {}", i + 1),
                  fmt::format("expected an instant after that of the pose before, {:g} s, got {:g} s",
                              poses[i - 1].t_s, p.t_s));
    out.t_s_.push_back(p.t_s);
    out.position_m_.emplace_back(p.T_world_body.position_m[0], p.T_world_body.position_m[1],
                                 p.T_world_body.position_m[2]);
    out.q_.push_back(quaternion(p.T_world_body));
  }
  const bool soft = spline == PathSpline::quintic;
  const std::size_t n = poses.size();
  out.velocity_mps_ = natural_velocities(out.t_s_, out.position_m_, soft);
  out.acceleration_mps2_.assign(n, Vector3d::Zero());
  // What the cubic spline has at inner knots; from the span after the knot, which is that before it.
  for (std::size_t i = 1; i + 1 < n; ++i) {
    const double h = out.t_s_[i + 1] - out.t_s_[i];
    out.acceleration_mps2_[i] = cubic(0, out.position_m_[i], h * out.velocity_mps_[i], out.position_m_[i + 1],
                                      h * out.velocity_mps_[i + 1])
                                    .second /
                                (h * h);
  }
  // Turn rates: the mean of those of the spans around, weighted as for a parabola through three.
  std::vector<Vector3d> span(n - 1);
  for (std::size_t i = 0; i + 1 < n; ++i)
    span[i] = rotation_vector(out.q_[i].conjugate() * out.q_[i + 1]) / (out.t_s_[i + 1] - out.t_s_[i]);
  out.turn_rate_radps_.assign(n, Vector3d::Zero());
  for (std::size_t i = 0; i < n; ++i) {
    if (i == 0 || i + 1 == n) {
      if (!soft) out.turn_rate_radps_[i] = span[i == 0 ? 0 : n - 2];
      continue;
    }
    const double h0 = out.t_s_[i] - out.t_s_[i - 1], h1 = out.t_s_[i + 1] - out.t_s_[i];
    out.turn_rate_radps_[i] = (h1 * span[i - 1] + h0 * span[i]) / (h0 + h1);
  }
  return out;
}

BodyState Trajectory::at(double t_s, BenchTime t) const noexcept {
  BodyState b;
  b.t_ref = t;
  const std::size_t last = t_s_.size() - 1;
  const bool stands = t_s < t_s_.front() || t_s >= t_s_[last];
  const auto next = std::upper_bound(t_s_.begin(), t_s_.end(), t_s);
  const std::size_t i = std::min<std::size_t>(
      static_cast<std::size_t>(std::max<std::ptrdiff_t>(1, next - t_s_.begin())) - 1, last - 1);
  const double h = t_s_[i + 1] - t_s_[i], u = std::clamp((t_s - t_s_[i]) / h, 0.0, 1.0);
  const Curve p =
      spline_ == PathSpline::quintic
          ? quintic(u, position_m_[i], h * velocity_mps_[i], h * h * acceleration_mps2_[i],
                    position_m_[i + 1], h * velocity_mps_[i + 1], h * h * acceleration_mps2_[i + 1])
          : cubic(u, position_m_[i], h * velocity_mps_[i], position_m_[i + 1], h * velocity_mps_[i + 1]);
  put(b.T_world_body.position_m, p.value);
  // The rotation vector from the pose before goes as a polynomial from 0 to that of the pose after, with the
  // turn rates of both at its ends.
  const Vector3d end = rotation_vector(q_[i].conjugate() * q_[i + 1]);
  const Vector3d slope0 = h * turn_rate_radps_[i];
  const Vector3d slope1 = h * (inverse_right_jacobian(end) * turn_rate_radps_[i + 1]);
  const Curve r = cubic(u, Vector3d::Zero(), slope0, end, slope1);
  const Quaterniond q = (q_[i] * turned_by(r.value)).normalized();
  b.T_world_body.orientation_wxyz = {q.w(), q.x(), q.y(), q.z()};
  if (stands) return b;
  put(b.velocity_mps, p.first / h);
  put(b.acceleration_mps2, p.second / (h * h));
  const auto rate = [&](const Curve& c) { return Vector3d(right_jacobian(c.value) * c.first / h); };
  put(b.turn_rate_radps, rate(r));
  constexpr double kStep = 1e-5;  // the derivative of the Jacobian, by difference
  const Curve before = cubic(u - kStep, Vector3d::Zero(), slope0, end, slope1);
  const Curve after = cubic(u + kStep, Vector3d::Zero(), slope0, end, slope1);
  put(b.turn_acceleration_radps2, (rate(after) - rate(before)) / (2 * kStep * h));
  return b;
}

Result<std::vector<TimedPose>> read_poses_csv(const std::filesystem::path& file) {
  std::ifstream in(file);
  if (!in) return fail(ErrorCode::not_found, file.string(), "expected a table of poses, found no such file");
  std::vector<TimedPose> poses;
  std::vector<std::string> columns;
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (line.empty() || line[0] == '#') continue;
    const std::string where = fmt::format("{}:{}", file.string(), number);
    std::vector<std::string> words(1);
    for (const char c : line)
      if (c == ',')
        words.emplace_back();
      else if (c != ' ' && c != '\t')
        words.back() += c;
    if (columns.empty()) {
      columns = words;
      const auto has = [&](const char* name) {
        return std::find(columns.begin(), columns.end(), name) != columns.end();
      };
      if (!has("t_s") || !has("x_m") || !has("y_m") || !has("z_m") || has("qw") == has("yaw_deg"))
        return fail(
            ErrorCode::bad_input, where,
            "expected columns t_s,x_m,y_m,z_m and either qw,qx,qy,qz or roll_deg,pitch_deg,yaw_deg, got " +
                line);
      continue;
    }
    std::map<std::string, double, std::less<>> value;
    for (std::size_t i = 0; i < words.size() && i < columns.size(); ++i) {
      double x = 0;
      const auto [end, ec] = std::from_chars(words[i].data(), words[i].data() + words[i].size(), x);
      if (ec != std::errc{} || end != words[i].data() + words[i].size())
        return fail(ErrorCode::bad_input, where,
                    fmt::format("expected a number for {}, got \"{}\"", columns[i], words[i]));
      value[columns[i]] = x;
    }
    if (words.size() != columns.size())
      return fail(ErrorCode::bad_input, where,
                  fmt::format("expected {} values, got {}", columns.size(), words.size()));
    TimedPose p;
    p.t_s = value["t_s"];
    p.T_world_body.position_m = {value["x_m"], value["y_m"], value["z_m"]};
    Quaterniond q(value["qw"], value["qx"], value["qy"], value["qz"]);
    if (!value.contains("yaw_deg")) {
      if (std::abs(q.norm() - 1) > 1e-3)
        return fail(ErrorCode::bad_input, where,
                    fmt::format("expected a quaternion of length 1, got length {:.6g}", q.norm()));
      q.normalize();
    } else {
      constexpr double kRadPerDeg = std::numbers::pi / 180;
      q = Eigen::AngleAxisd(value["yaw_deg"] * kRadPerDeg, Vector3d::UnitZ()) *
          Eigen::AngleAxisd(value["pitch_deg"] * kRadPerDeg, Vector3d::UnitY()) *
          Eigen::AngleAxisd(value["roll_deg"] * kRadPerDeg, Vector3d::UnitX());
    }
    p.T_world_body.orientation_wxyz = {q.w(), q.x(), q.y(), q.z()};
    poses.push_back(p);
  }
  return poses;
}

TrajectoryPlatform::TrajectoryPlatform(Trajectory trajectory)
    : trajectory_(std::move(trajectory)), t0_(std::numeric_limits<std::int64_t>::max() / 4) {}

void TrajectoryPlatform::start(BenchTime t0) { t0_.store(t0.ns(), std::memory_order_release); }

PlatformMotion TrajectoryPlatform::motion_at(BenchTime t) const noexcept {
  PlatformMotion m;
  m.body = trajectory_.at(static_cast<double>(t.ns() - t0_.load(std::memory_order_acquire)) * 1e-9, t);
  return m;
}

const std::vector<std::string>& TrajectoryPlatform::joint_names() const {
  static const std::vector<std::string> none;
  return none;
}

const std::vector<SignalModel::Signal>& TrajectoryPlatform::signals() const {
  static const std::vector<Signal> all{{"x_m", "m", false},         {"y_m", "m", false},
                                       {"z_m", "m", false},         {"roll_deg", "deg", false},
                                       {"pitch_deg", "deg", false}, {"yaw_deg", "deg", false}};
  return all;
}

double TrajectoryPlatform::read(std::size_t signal, BenchTime t) {
  const Pose pose = motion_at(t).body.T_world_body;
  if (signal < 3) return pose.position_m[signal];
  const Matrix3d R = quaternion(pose).toRotationMatrix();
  constexpr double kDegPerRad = 180 / std::numbers::pi;
  if (signal == 3) return std::atan2(R(2, 1), R(2, 2)) * kDegPerRad;
  if (signal == 4) return -std::asin(std::clamp(R(2, 0), -1.0, 1.0)) * kDegPerRad;
  if (signal == 5) return std::atan2(R(1, 0), R(0, 0)) * kDegPerRad;
  return std::numeric_limits<double>::quiet_NaN();
}

bool TrajectoryPlatform::read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                              BenchTime t) {
  static const std::vector<double> steps(6, 1e-4);
  return SignalRegisters(*this, signals(), steps).read(table, address, out, t);
}

}  // namespace rigor
