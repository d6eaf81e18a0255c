// What fit_biases() works on: the unknowns of a model, the walls' returns without outliers, and cells of
// them whose mean residuals are solved by least squares. Not for use beside bias_fit.cpp.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "calibration/lidar/bias_fit.h"

namespace rigor::calibration::lidar {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

/// Where each number of a model lies in the vector of unknowns; −1: it is not fitted.
class Layout {
 public:
  Layout(const BiasModel& m, std::size_t beams, std::size_t planes, bool flat, bool hold_planes)
      : model_(m), beams_(static_cast<int>(beams)), flat_(flat) {
    const auto take = [&](int count) {
      const int at = size_;
      size_ += count;
      return at;
    };
    if (m.offset) bias_ = take(1);
    if (m.beams) bias_ = take(beams_);
    if (m.angles) elevation_ = take(beams_), azimuth_ = take(beams_ - 1);
    if (m.walk) walk_ = take(1);
    if (m.oblique) oblique_ = take(1);
    if (m.scale) scale_ = take(1);
    wanted_ = size_;
    if (!hold_planes) plane_ = take(static_cast<int>(planes) * per_plane());
  }
  [[nodiscard]] int size() const { return size_; }
  [[nodiscard]] int wanted() const { return wanted_; }
  [[nodiscard]] int bias(int beam) const { return bias_ < 0 ? -1 : model_.beams ? bias_ + beam : bias_; }
  [[nodiscard]] int elevation(int beam) const { return elevation_ < 0 ? -1 : elevation_ + beam; }
  /// Turning all beams and the walls together changes nothing: beam 0 is what the others are against.
  [[nodiscard]] int azimuth(int beam) const { return azimuth_ < 0 || beam == 0 ? -1 : azimuth_ + beam - 1; }
  [[nodiscard]] int walk() const { return walk_; }
  [[nodiscard]] int oblique() const { return oblique_; }
  [[nodiscard]] int scale() const { return scale_; }
  [[nodiscard]] int per_plane() const { return flat_ ? 2 : 3; }
  [[nodiscard]] int plane(int k) const { return plane_ < 0 ? -1 : plane_ + k * per_plane(); }
  [[nodiscard]] const BiasModel& model() const { return model_; }
  [[nodiscard]] int beams() const { return beams_; }

 private:
  BiasModel model_;
  int beams_, size_ = 0, wanted_ = 0;
  bool flat_;
  int bias_ = -1, elevation_ = -1, azimuth_ = -1, walk_ = -1, oblique_ = -1, scale_ = -1, plane_ = -1;
};

struct State {
  std::vector<BeamErrors> errors;
  std::vector<Eigen::Vector3d> q;

  void step(const Layout& l, const VectorXd& d) {
    for (int b = 0; b < l.beams(); ++b) {
      BeamErrors& e = errors[static_cast<std::size_t>(b)];
      if (const int i = l.bias(b); i >= 0) e.bias_m += d[i];
      if (const int i = l.elevation(b); i >= 0) e.elevation_rad += d[i];
      if (const int i = l.azimuth(b); i >= 0) e.azimuth_rad += d[i];
      if (l.walk() >= 0) e.remission_bias_m += d[l.walk()];
      if (l.oblique() >= 0) e.incidence_bias_m += d[l.oblique()];
      if (l.scale() >= 0) e.scale += d[l.scale()];
    }
    for (std::size_t k = 0; k < q.size(); ++k)
      if (const int i = l.plane(static_cast<int>(k)); i >= 0)
        for (int c = 0; c < l.per_plane(); ++c) q[k][c] += d[i + c];
  }
  /// What the model has not goes back to none.
  void restrict_to(const BiasModel& m) {
    double mean = 0;
    for (const BeamErrors& e : errors) mean += e.bias_m / static_cast<double>(errors.size());
    for (BeamErrors& e : errors) {
      if (!m.beams) e.bias_m = m.offset ? mean : 0;
      if (!m.angles) e.elevation_rad = e.azimuth_rad = 0;
      if (!m.walk) e.remission_bias_m = 0;
      if (!m.oblique) e.incidence_bias_m = 0;
      if (!m.scale) e.scale = 1;
    }
  }
};

/// The few columns that a residual touches.
struct Row {
  std::array<int, 9> at;
  std::array<double, 9> d;
  int n = 0;
  void add(int i, double v) {
    if (i >= 0) at[static_cast<std::size_t>(n)] = i, d[static_cast<std::size_t>(n++)] = v;
  }
};
[[nodiscard]] Row row_of(const Layout& l, int beam, int plane, const PredictedRange& p);

struct Normal {
  MatrixXd h;
  VectorXd g;
  double cost = 0;
  explicit Normal(int n) : h(MatrixXd::Zero(n, n)), g(VectorXd::Zero(n)) {}
  void add(const Row& r, double e, double w) {
    for (int i = 0; i < r.n; ++i) {
      const auto a = static_cast<std::size_t>(i);
      const double wd = w * r.d[a];
      g[r.at[a]] += wd * e;
      for (int j = 0; j <= i; ++j) {
        const auto b = static_cast<std::size_t>(j);
        const int x = std::max(r.at[a], r.at[b]), y = std::min(r.at[a], r.at[b]);
        h(x, y) += wd * r.d[b];
      }
    }
  }
  void symmetric() { h = MatrixXd(h.selfadjointView<Eigen::Lower>()); }
  /// Holds the unknowns near none, by weights.
  void hold(const VectorXd& prior, const VectorXd& value) {
    h.diagonal() += prior;
    g -= prior.cwiseProduct(value);
    cost += prior.dot(value.cwiseAbs2());
  }
  /// The step along what the data determine; `damping` as a share of the squares of each column.
  [[nodiscard]] VectorXd solve(double damping = 0) const;
};

[[nodiscard]] double median(std::vector<double>& v);

/// Of cells that err alike.
struct Correlation {
  double along = 0;   ///< of neighbouring cells of a beam
  double across = 0;  ///< of all beams' cells at one azimuth of a wall
  /// How many cells of a beam say as much as an independent one: a first-order autoregression.
  [[nodiscard]] double cells_along() const { return (1 + along) / (1 - along); }
};

class BiasProblem {
 public:
  BiasProblem(const LidarReturns& returns, const models::LidarModel& sensor_model, const PlaneSearch& planes,
              const BiasFitOptions& options);

 protected:
  [[nodiscard]] PredictedRange predict(const State& s, std::uint16_t beam, int plane, double azimuth,
                                       double remission) const {
    return predict_range(sensor_model_.scan.beams[beam], s.errors[beam], azimuth, remission,
                         s.q[static_cast<std::size_t>(plane)]);
  }
  [[nodiscard]] Layout layout(const BiasModel& m) const {
    return {m, beams_, state_.q.size(), flat_, o_.surveyed};
  }

  /// Residuals of all returns of walls; NaN of the others.
  void residuals_of(const State& s, std::vector<float>& out) const;
  /// Weights that hold the unknowns of a model near none, by as much as the search of planes allows; values
  /// that they hold.
  [[nodiscard]] VectorXd prior_of(const Layout& l) const;
  [[nodiscard]] VectorXd values_of(const Layout& l, const State& s) const;
  /// First step: the richest model by all returns, robustly. Its weak directions are held near none here
  /// (by as much as the search of planes allows): it serves to tell outliers and to make cells.
  [[nodiscard]] Status reject_returns();
  /// Returns that, as the state has it, come from near an edge with another wall are of neither. By where the
  /// beam should meet the walls, not by what was measured: else noise would decide.
  void leave_edges_out();
  /// Which returns are used, by the residuals against the state.
  void judge_returns();
  void make_cells();
  /// With the cells' fit in place of the robust one, which may have taken a beam's stretch of a wall for
  /// outliers: judges and makes cells again until nothing changes.
  void judge_again();

  [[nodiscard]] double weight(const BiasCell& c) const {
    return 1 / std::max(1e-300, c.shot_variance_m2 + tau2_[c.plane]);
  }
  /// Mean residual of a cell under another state than that which it was made with. The difference of two
  /// predictions hardly changes over a cell, which the predictions themselves do.
  [[nodiscard]] double residual(const State& s, const BiasCell& c, PredictedRange& p) const {
    p = predict(s, c.beam, c.plane, c.azimuth_rad, c.remission);
    return c.range_m - p.range_m;
  }

  /// Least squares over the cells that `take` accepts: Gauss–Newton, damped where a step makes things worse.
  template <class Take>
  State solve(const Layout& l, State s, const Take& take, MatrixXd* information = nullptr,
              const VectorXd* prior = nullptr) const {
    Normal at = normal_at(l, s, take, prior);
    double damping = 0;
    for (int round = 0; round < 40 && l.size() > 0; ++round) {
      const VectorXd d = at.solve(damping);
      if (!d.allFinite()) break;
      State next = s;
      next.step(l, d);
      Normal then = normal_at(l, next, take, prior);
      // Not a number counts as worse.
      if (!(then.cost <= at.cost * (1 + 1e-12))) {
        damping = std::max(10 * damping, 1e-8);
        if (damping > 1e3) break;
        continue;
      }
      // In units of what each number is uncertain by.
      double largest = 0;
      for (Index i = 0; i < d.size(); ++i)
        largest = std::max(largest, std::abs(d[i]) * std::sqrt(std::max(0.0, at.h(i, i))));
      s = std::move(next);
      at = std::move(then);
      damping = damping > 1e-8 ? damping / 10 : 0;
      if (largest < 1e-4) break;
    }
    if (information) *information = at.h;
    return s;
  }
  template <class Take>
  Normal normal_at(const Layout& l, const State& s, const Take& take, const VectorXd* prior) const {
    Normal normal(l.size());
    double blur = 0;
    for (const BiasCell& c : cells_) {
      if (!take(c)) continue;
      PredictedRange p;
      const double e = residual(s, c, p), w = weight(c);
      normal.cost += w * e * e;
      normal.add(row_of(l, c.beam, c.plane, p), e, w);
      if (l.walk() >= 0 && c.remission < 1) blur += w * c.remission_variance;
    }
    // Noise of the remission makes its column longer and the answer smaller by as much (errors in variables):
    // what it adds to the squares is known and is taken away.
    if (l.walk() >= 0) {
      const double walk = s.errors.front().remission_bias_m;
      blur = std::min(blur, 0.5 * normal.h(l.walk(), l.walk()));
      normal.h(l.walk(), l.walk()) -= blur;
      normal.g[l.walk()] += blur * walk;
      normal.cost = std::max(0.0, normal.cost - blur * walk * walk);
    }
    normal.symmetric();
    if (prior) normal.hold(*prior, values_of(l, s));
    return normal;
  }

  static bool in_use(const BiasCell& c) { return c.used; }

  /// τ of each wall: that at which squared residuals are what they should be (Paule & Mandel 1982); first by
  /// the median, and cells beyond the limit are left out.
  void spread_between_cells(const State& s, std::size_t unknowns);
  /// By standardised residuals; 0 where it could be chance.
  [[nodiscard]] Correlation correlation(const State& s) const;
  /// Information on the unknowns where cells err alike: h m⁺ h, the inverse of the covariance h⁻¹ m h⁻¹ of
  /// least squares that took them for independent. `h`: the information then; m: what the errors as they are
  /// make of h, their own part and that of columns apart, so that differences of beams are known as well as
  /// they are.
  [[nodiscard]] MatrixXd information_of(const Layout& l, const State& s, const MatrixXd& h,
                                        const Correlation& alike) const;

  const std::vector<LidarReturn>& returns_;
  const models::LidarModel& sensor_model_;
  const PlaneSearch& found_;
  std::vector<std::int8_t> label_;  ///< of each return: wall, or −1
  const BiasFitOptions& o_;
  bool flat_;
  std::size_t beams_;
  std::vector<BiasModel> models_;
  std::vector<float> remission_;
  State state_;
  State reference_;  ///< of the robust fit: where every fit begins
  BiasModel rich_;
  VectorXd prior_;  ///< of the rich model
  std::vector<float> residual_;
  std::vector<std::uint8_t> used_;
  double spread_ = 0;
  std::vector<BiasCell> cells_;
  std::vector<double> tau2_;
};

}  // namespace rigor::calibration::lidar
