#include "calibration/lidar/bias_problem.h"

#include <map>

#include "calibration/lidar/column_correlation.h"

namespace rigor::calibration::lidar {
namespace {

constexpr double kMedianOfChiSquare = 0.454936423119572;  // of one degree of freedom

}  // namespace

Row row_of(const Layout& l, int beam, int plane, const PredictedRange& p) {
  Row r;
  r.add(l.bias(beam), 1);
  r.add(l.elevation(beam), p.d_elevation_m);
  r.add(l.azimuth(beam), p.d_azimuth_m);
  r.add(l.walk(), p.d_walk);
  r.add(l.oblique(), p.d_oblique);
  r.add(l.scale(), p.d_scale_m);
  if (const int i = l.plane(plane); i >= 0)
    for (int c = 0; c < l.per_plane(); ++c) r.add(i + c, p.d_q_m2[c]);
  return r;
}

VectorXd Normal::solve(double damping) const {
  const Index n = h.rows();
  VectorXd s(n);
  for (Index i = 0; i < n; ++i) s[i] = h(i, i) > 0 ? 1 / std::sqrt(h(i, i)) : 0;
  MatrixXd unit = s.asDiagonal() * h * s.asDiagonal();
  unit.diagonal().array() += damping;
  const VectorXd right = s.asDiagonal() * g;
  const Eigen::LLT<MatrixXd> quick(unit);
  if (quick.info() == Eigen::Success && quick.rcond() > 1e-10) return s.asDiagonal() * quick.solve(right);
  const Eigen::SelfAdjointEigenSolver<MatrixXd> e(unit);
  VectorXd along = e.eigenvectors().transpose() * right;
  for (Index i = 0; i < n; ++i) along[i] = e.eigenvalues()[i] > 1e-11 ? along[i] / e.eigenvalues()[i] : 0;
  return s.asDiagonal() * (e.eigenvectors() * along);
}

double median(std::vector<double>& v) {
  if (v.empty()) return 0;
  const auto at = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
  std::nth_element(v.begin(), at, v.end());
  return *at;
}

BiasProblem::BiasProblem(const LidarReturns& returns, const models::LidarModel& sensor_model,
                         const PlaneSearch& planes, const BiasFitOptions& options)
    : returns_(returns.all),
      sensor_model_(sensor_model),
      found_(planes),
      label_(planes.label),
      o_(options),
      flat_(scans_one_plane(sensor_model.scan)),
      beams_(sensor_model.scan.beams.size()) {
  state_.errors.resize(beams_);
  for (const LidarPlane& p : planes.planes) state_.q.push_back(p.q_per_m);
  remission_.reserve(returns_.size());
  for (const LidarReturn& r : returns_) {
    const double e = remission_from_units(sensor_model.remission, r.remission, r.range_m);
    remission_.push_back(static_cast<float>(std::isfinite(e) ? e : 1));
  }
}

void BiasProblem::residuals_of(const State& s, std::vector<float>& out) const {
  out.assign(returns_.size(), std::numeric_limits<float>::quiet_NaN());
  for (std::size_t i = 0; i < returns_.size(); ++i) {
    if (label_[i] < 0) continue;
    const LidarReturn& r = returns_[i];
    out[i] = static_cast<float>(static_cast<double>(r.range_m) -
                                predict(s, r.beam, label_[i], r.azimuth_rad, remission_[i]).range_m);
  }
}

VectorXd BiasProblem::prior_of(const Layout& l) const {
  VectorXd prior = VectorXd::Zero(l.size());
  const double t = std::max(1e-300, found_.tolerance_m);
  for (int b = 0; b < static_cast<int>(beams_); ++b) {
    if (l.bias(b) >= 0) prior[l.bias(b)] = 1 / (t * t);
    for (const int i : {l.elevation(b), l.azimuth(b)})
      if (i >= 0) prior[i] = 1 / (0.01 * 0.01);
  }
  for (const int i : {l.walk(), l.oblique()})
    if (i >= 0) prior[i] = 1 / (t * t);
  if (l.scale() >= 0) prior[l.scale()] = 1 / (0.05 * 0.05);
  return prior;
}

VectorXd BiasProblem::values_of(const Layout& l, const State& s) const {
  VectorXd value = VectorXd::Zero(l.size());
  for (int b = 0; b < static_cast<int>(beams_); ++b) {
    const BeamErrors& be = s.errors[static_cast<std::size_t>(b)];
    if (l.bias(b) >= 0) value[l.bias(b)] = be.bias_m;
    if (l.elevation(b) >= 0) value[l.elevation(b)] = be.elevation_rad;
    if (l.azimuth(b) >= 0) value[l.azimuth(b)] = be.azimuth_rad;
  }
  const BeamErrors& first = s.errors.front();
  if (l.walk() >= 0) value[l.walk()] = first.remission_bias_m;
  if (l.oblique() >= 0) value[l.oblique()] = first.incidence_bias_m;
  if (l.scale() >= 0) value[l.scale()] = first.scale - 1;
  return value;
}

Status BiasProblem::reject_returns() {
  BiasModel rich = models_.front();
  for (const BiasModel& m : models_) {
    rich.beams = rich.beams || m.beams;
    rich.offset = (rich.offset || m.offset) && !rich.beams;
    rich.angles = rich.angles || m.angles;
    rich.walk = rich.walk || m.walk, rich.oblique = rich.oblique || m.oblique;
    rich.scale = rich.scale || m.scale;
  }
  const Layout l = layout(rich);
  std::size_t on_planes = 0;
  for (const auto label : label_) on_planes += label >= 0;
  if (on_planes < static_cast<std::size_t>(l.size()) + 10)
    return fail(ErrorCode::bad_input, "",
                "expected more returns on walls than unknowns, got " + std::to_string(on_planes) + " for " +
                    std::to_string(l.size()) + ": a recording nearer to walls is needed");
  prior_ = prior_of(l);
  // A share of a long recording is enough to tell what an outlier is; drawn, so that no beam is preferred.
  std::vector<std::uint32_t> drawn;
  std::uint32_t word = 1;
  const double share = 100'000.0 / static_cast<double>(on_planes);
  for (std::size_t i = 0; i < returns_.size(); ++i) {
    if (label_[i] < 0) continue;
    word = word * 1664525u + 1013904223u;
    if (static_cast<double>(word >> 8) < share * 16777216.0) drawn.push_back(static_cast<std::uint32_t>(i));
  }
  std::vector<double> e(drawn.size()), absolute(drawn.size());
  double spread = 0;
  State start = state_;
  for (int round = 0; round < 25 && !o_.stop.stop_requested(); ++round) {
    Normal normal(l.size());
    std::vector<PredictedRange> p(drawn.size());
    for (std::size_t k = 0; k < drawn.size(); ++k) {
      const LidarReturn& r = returns_[drawn[k]];
      p[k] = predict(state_, r.beam, label_[drawn[k]], r.azimuth_rad, remission_[drawn[k]]);
      e[k] = static_cast<double>(r.range_m) - p[k].range_m;
      absolute[k] = std::abs(e[k]);
    }
    const double now = std::max(1e-12 * found_.tolerance_m, 1.4826 * median(absolute));
    for (std::size_t k = 0; k < drawn.size(); ++k) {
      const double z = e[k] / (2.385 * now);
      normal.add(row_of(l, returns_[drawn[k]].beam, label_[drawn[k]], p[k]), e[k],
                 1 / ((1 + z * z) * now * now));
    }
    normal.symmetric();
    normal.hold(prior_, values_of(l, state_));
    const VectorXd d = normal.solve();
    if (!d.allFinite()) break;
    state_.step(l, d);
    if (o_.progress) o_.progress(0.3 * (round + 1) / 25, now);
    const bool settled = std::abs(now - spread) < 1e-4 * now;
    spread = now;
    if (settled && round > 2) break;
  }
  if (!std::isfinite(spread)) state_ = start;
  spread_ = spread;
  rich_ = rich;
  reference_ = state_;
  judge_returns();
  return {};
}

void BiasProblem::judge_returns() {
  residuals_of(state_, residual_);
  // Limits by the noise at each remission, not below what the robust fit leaves.
  used_.assign(returns_.size(), 0);
  for (std::size_t i = 0; i < returns_.size(); ++i) {
    if (label_[i] < 0) continue;
    const double shot = o_.sigma_m ? o_.sigma_m(static_cast<double>(remission_[i])) : spread_;
    used_[i] = std::abs(static_cast<double>(residual_[i])) <= o_.reject_sigmas * std::max(spread_, shot);
  }
}

void BiasProblem::leave_edges_out() {
  std::vector<double> scale;
  for (const auto& q : state_.q) scale.push_back(1 / q.norm());
  for (std::size_t i = 0; i < returns_.size(); ++i) {
    if (label_[i] < 0) continue;
    const LidarReturn& r = returns_[i];
    const BeamErrors& e = state_.errors[r.beam];
    models::LidarBeam beam = sensor_model_.scan.beams[r.beam];
    beam.elevation_rad += e.elevation_rad, beam.azimuth_rad += e.azimuth_rad;
    Eigen::Vector3d u, o;
    beam_of(beam, static_cast<double>(r.azimuth_rad), u, o);
    const Eigen::Vector3d& q = state_.q[static_cast<std::size_t>(label_[i])];
    const Eigen::Vector3d met = o + (1 - q.dot(o)) / q.dot(u) * u;
    for (std::size_t k = 0; k < state_.q.size(); ++k)
      if (static_cast<std::int8_t>(k) != label_[i] &&
          std::abs(state_.q[k].dot(met) - 1) * scale[k] < found_.tolerance_m) {
        label_[i] = -1;
        break;
      }
  }
}

void BiasProblem::judge_again() {
  for (int round = 0; round < 3; ++round) {
    const std::vector<std::uint8_t> before = used_;
    state_ = solve(layout(rich_), state_, in_use, nullptr, &prior_);
    leave_edges_out();
    judge_returns();
    if (used_ == before) break;
    make_cells();
  }
}

void BiasProblem::make_cells() {
  cells_.clear();
  struct Sum {
    double n = 0, azimuth = 0, remission = 0, mean = 0, square = 0, shot = 0, blur = 0;
  };
  std::map<std::tuple<int, int, std::int32_t>, Sum> sums;
  for (std::size_t i = 0; i < returns_.size(); ++i) {
    if (!used_[i]) continue;
    const LidarReturn& r = returns_[i];
    const auto cell = static_cast<std::int32_t>(std::floor(static_cast<double>(r.azimuth_rad) / o_.cell_rad));
    Sum& s = sums[{label_[i], r.beam, cell}];
    ++s.n;
    const double x = residual_[i], d = x - s.mean;
    s.mean += d / s.n;
    s.square += d * (x - s.mean);
    s.azimuth += (static_cast<double>(r.azimuth_rad) - s.azimuth) / s.n;
    s.remission += (static_cast<double>(remission_[i]) - s.remission) / s.n;
    const double shot = o_.sigma_m ? o_.sigma_m(static_cast<double>(remission_[i])) : 0;
    s.shot += shot * shot;
    if (o_.remission_sigma) {
      const double blur = o_.remission_sigma(static_cast<double>(remission_[i]));
      s.blur += blur * blur;
    }
  }
  // Without a noise model each wall has a noise of its own: dark ones more than bright ones.
  std::vector<double> pooled(state_.q.size(), 0), dof(state_.q.size(), 0);
  for (const auto& [key, s] : sums) {
    const auto k = static_cast<std::size_t>(std::get<0>(key));
    pooled[k] += s.square, dof[k] += s.n - 1;
  }
  for (std::size_t k = 0; k < pooled.size(); ++k)
    pooled[k] = dof[k] > 0 ? pooled[k] / dof[k] : spread_ * spread_;
  for (const auto& [key, s] : sums) {
    BiasCell c;
    c.plane = static_cast<std::uint8_t>(std::get<0>(key));
    c.beam = static_cast<std::uint16_t>(std::get<1>(key));
    c.azimuth_rad = s.azimuth;
    c.remission = s.remission;
    c.sector = static_cast<std::int32_t>(std::floor(s.azimuth / o_.sector_rad));
    c.fold = static_cast<std::uint8_t>(((c.sector % o_.folds) + o_.folds) % o_.folds);
    c.remission_variance = s.blur / (s.n * s.n);
    c.count = s.n;
    c.square_m2 = s.square;
    c.shot_variance_m2 = (o_.sigma_m ? s.shot / s.n : pooled[c.plane]) / s.n;
    c.range_m = s.mean + predict(state_, c.beam, c.plane, c.azimuth_rad, c.remission).range_m;
    cells_.push_back(c);
  }
  tau2_.assign(state_.q.size(), 0);
}

void BiasProblem::spread_between_cells(const State& s, std::size_t unknowns) {
  std::vector<double> e(cells_.size());
  for (std::size_t i = 0; i < cells_.size(); ++i) {
    PredictedRange p;
    e[i] = residual(s, cells_[i], p);
  }
  double all = 0;
  for (const BiasCell& c : cells_) all += c.used;
  for (std::size_t k = 0; k < tau2_.size(); ++k) {
    std::vector<std::size_t> mine;
    for (std::size_t i = 0; i < cells_.size(); ++i)
      if (cells_[i].plane == k && cells_[i].used) mine.push_back(i);
    if (mine.size() < 8) continue;
    const auto ratio = [&](double tau2, bool robust) {
      std::vector<double> z;
      double sum = 0;
      for (const std::size_t i : mine) {
        const double x = e[i] * e[i] / (cells_[i].shot_variance_m2 + tau2);
        sum += x;
        if (robust) z.push_back(x);
      }
      const double dof =
          static_cast<double>(mine.size()) * std::max(0.1, 1 - static_cast<double>(unknowns) / all);
      return robust ? median(z) / kMedianOfChiSquare : sum / dof;
    };
    const auto root = [&](bool robust) {
      double high = 0;
      for (const std::size_t i : mine) high = std::max(high, e[i] * e[i]);
      if (!(high > 0) || ratio(0, robust) <= 1) return 0.0;
      double low = 0;
      high *= 4;
      for (int n = 0; n < 60; ++n) {
        const double mid = 0.5 * (low + high);
        (ratio(mid, robust) > 1 ? low : high) = mid;
      }
      return 0.5 * (low + high);
    };
    const double first = root(true);
    for (const std::size_t i : mine) {
      const double limit = o_.reject_sigmas * std::sqrt(cells_[i].shot_variance_m2 + first);
      // A limit of 4 for thousands of cells would take good ones with it.
      if (std::abs(e[i]) > 1.25 * limit) cells_[i].used = false;
    }
    std::erase_if(mine, [&](std::size_t i) { return !cells_[i].used; });
    tau2_[k] = root(false);
  }
}

Correlation BiasProblem::correlation(const State& s) const {
  double product = 0, pairs = 0, square = 0, n = 0;
  const BiasCell* last = nullptr;
  double last_z = 0;
  struct Column {
    double sum = 0, squares = 0, count = 0;
  };
  std::map<std::pair<int, std::int32_t>, Column> columns;
  for (const BiasCell& c : cells_) {
    if (!c.used) continue;
    PredictedRange p;
    const double z = residual(s, c, p) * std::sqrt(weight(c));
    square += z * z, ++n;
    if (last && last->plane == c.plane && last->beam == c.beam &&
        c.azimuth_rad - last->azimuth_rad < 1.6 * o_.cell_rad)
      product += z * last_z, ++pairs;
    last = &c, last_z = z;
    Column& column = columns[{c.plane, static_cast<std::int32_t>(std::floor(c.azimuth_rad / o_.cell_rad))}];
    column.sum += z, column.squares += z * z, ++column.count;
  }
  Correlation out;
  if (!(square > 0)) return out;
  if (pairs >= 10) {
    const double rho = (product / pairs) / (square / n);
    if (rho > 3 / std::sqrt(pairs)) out.along = std::min(rho, 0.98);
  }
  double across = 0, across_pairs = 0;
  for (const auto& [at, c] : columns)
    across += (c.sum * c.sum - c.squares) / 2, across_pairs += c.count * (c.count - 1) / 2;
  if (across_pairs >= 10) {
    const double rho = (across / across_pairs) / (square / n), a2 = out.along * out.along;
    // Columns that are neighbours are no independent witnesses of it either.
    if (rho > 3 * std::sqrt((1 + a2) / (1 - a2) / across_pairs)) out.across = std::min(rho, 0.98);
  }
  return out;
}

MatrixXd BiasProblem::information_of(const Layout& l, const State& s, const MatrixXd& h,
                                     const Correlation& alike) const {
  if (!(alike.across > 0) || l.size() == 0) return h / alike.cells_along();
  struct Column {
    double count = 0, z = 0, d_bias = 0;
    Eigen::Vector3d d_plane = Eigen::Vector3d::Zero();
    VectorXd d;  ///< with the unknowns
  };
  std::map<std::pair<int, std::int32_t>, Column> columns;
  for (const BiasCell& c : cells_) {
    if (!c.used) continue;
    Column& sum = columns[{c.plane, static_cast<std::int32_t>(std::floor(c.azimuth_rad / o_.cell_rad))}];
    if (sum.d.size() == 0) sum.d = VectorXd::Zero(l.size());
    PredictedRange p;
    const double root = std::sqrt(weight(c));
    ++sum.count, sum.z += root * residual(s, c, p);
    sum.d_bias += root, sum.d_plane += root * p.d_q_m2;
    const Row r = row_of(l, c.beam, c.plane, p);
    for (int i = 0; i < r.n; ++i)
      sum.d[r.at[static_cast<std::size_t>(i)]] += root * r.d[static_cast<std::size_t>(i)];
  }
  std::vector<ColumnResidual> all;
  for (const auto& [at, c] : columns) {
    const double share = 1 / std::sqrt(c.count);
    const Eigen::Vector3d d = share * c.d_plane;
    all.push_back({at.first, at.second, share * c.z, {d.x(), d.y(), d.z()}, share * c.d_bias});
  }
  const ColumnProcess process = column_process(all, o_.surveyed ? 0 : flat_ ? 2 : 3);
  // What a beam's cells share beyond their columns.
  const double own = 1 - alike.across,
               along = std::clamp((alike.along - alike.across * process.neighbours) / own, 0.0, 0.98);
  MatrixXd m = own * (1 + along) / (1 - along) * h;
  for (auto first = columns.begin(); first != columns.end();) {
    auto end = first;
    while (end != columns.end() && end->first.first == first->first.first) ++end;
    const auto n = static_cast<Index>(std::distance(first, end));
    MatrixXd g(l.size(), n), r(n, n);
    std::vector<std::int32_t> cell;
    for (; first != end; ++first) {
      g.col(static_cast<Index>(cell.size())) = first->second.d;
      cell.push_back(first->first.second);
    }
    for (Index i = 0; i < n; ++i)
      for (Index j = 0; j < n; ++j)
        r(i, j) = process.at(std::abs(cell[static_cast<std::size_t>(i)] - cell[static_cast<std::size_t>(j)]));
    m += alike.across / process.kept * (g * r * g.transpose());
  }
  VectorXd scale(l.size());
  for (Index i = 0; i < scale.size(); ++i) scale[i] = m(i, i) > 0 ? 1 / std::sqrt(m(i, i)) : 0;
  const MatrixXd unit = scale.asDiagonal() * m * scale.asDiagonal(), of_h = scale.asDiagonal() * h;
  return of_h.transpose() * unit.completeOrthogonalDecomposition().solve(of_h);
}

}  // namespace rigor::calibration::lidar
