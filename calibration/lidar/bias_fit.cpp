#include "calibration/lidar/bias_fit.h"

#include <map>
#include <numbers>

#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "calibration/lidar/bias_problem.h"
#include "rt-core/numbers.h"

namespace rigor::calibration {
namespace {

using namespace lidar;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

std::string name_of(const char* base, int i) { return std::string(base) + "[" + std::to_string(i) + "]"; }

class Fit : BiasProblem {
 public:
  using BiasProblem::BiasProblem;

  Result<BiasFit> run() {
    models_ = o_.models.empty() ? bias_models(beams_, flat_, o_.surveyed) : o_.models;
    if (Status s = reject_returns(); !s) return tl::unexpected<Error>(s.error());
    make_cells();
    if (cells_.size() < 3 * state_.q.size() + 3)
      return fail(ErrorCode::bad_input, "",
                  "expected returns of walls over more than " + std::to_string(cells_.size()) +
                      " cells of a degree: a longer piece of wall is needed");
    judge_again();
    compare();
    finish();
    return std::move(out_);
  }

 private:
  struct Tried {
    BiasModel model;
    State state;
  };

  void compare() {
    const BiasModel* rich = &models_.back();
    for (const BiasModel& m : models_)
      if (layout(m).wanted() > layout(*rich).wanted()) rich = &m;
    State s = reference_;
    s.restrict_to(*rich);
    const Layout l_rich = layout(*rich);
    for (int round = 0; round < 4; ++round) {
      s = solve(l_rich, s, in_use);
      spread_between_cells(s, static_cast<std::size_t>(l_rich.size()));
    }
    // Neighbouring cells of a beam that err alike are fewer independent ones. What all beams share is in
    // every model.
    const double alike = correlation(s).cells_along();
    std::vector<Tried> tried;
    std::vector<Candidate> candidates;
    for (std::size_t m = 0; m < models_.size(); ++m) {
      const Layout l = layout(models_[m]);
      State t = s;
      t.restrict_to(models_[m]);
      t = solve(l, t, in_use);
      Candidate c;
      c.name = models_[m].name;
      c.parameters = l.wanted();
      double weighted = 0, square = 0, shots = 0;
      std::size_t used = 0;
      for (const BiasCell& cell : cells_) {
        if (!cell.used) continue;
        PredictedRange p;
        const double e = residual(t, cell, p);
        weighted += e * e * weight(cell);
        square += cell.count * e * e + cell.square_m2;
        shots += cell.count;
        ++used;
      }
      c.rms = std::sqrt(square / std::max(1.0, shots));
      c.bic = bic(std::max(1e-300, weighted / alike), static_cast<double>(used) / alike,
                  static_cast<std::size_t>(l.size()));
      cross_validate(models_[m], t, c);
      candidates.push_back(c);
      tried.push_back({models_[m], t});
      if (o_.progress)
        o_.progress(0.3 + 0.6 * static_cast<double>(m + 1) / static_cast<double>(models_.size()), c.rms);
      if (o_.stop.stop_requested()) break;
    }
    // What nothing was corrected by, for comparison, even where it is no candidate.
    if (candidates.front().name == "none") {
      out_.held_out_uncorrected_m = candidates.front().cross_validation;
    } else {
      Candidate c;
      State t = s;
      t.restrict_to({.name = "none"});
      cross_validate({.name = "none"}, solve(layout({.name = "none"}), t, in_use), c);
      out_.held_out_uncorrected_m = c.cross_validation;
    }
    // A model that leaves some of its own numbers open is not what the data support, however it predicts.
    std::vector<std::size_t> open, fit_for_choice;
    for (std::size_t i = 0; i < tried.size(); ++i)
      (tried.size() == 1 || determined(tried[i].model, tried[i].state) ? fit_for_choice : open).push_back(i);
    std::vector<Candidate> choice;
    for (const std::size_t i : fit_for_choice) choice.push_back(candidates[i]);
    const std::size_t chosen = fit_for_choice[choose_model(choice)];
    for (std::size_t i = 0; i < choice.size(); ++i) candidates[fit_for_choice[i]] = choice[i];
    for (const std::size_t i : open) candidates[i].note = "these data do not determine all of its parameters";
    if (tried[chosen].model.name == "none" && !open.empty())
      out_.result.not_identifiable.emplace_back(
          "range_bias_m",
          "a bias of the ranges, its change with incidence or remission and the distances of the walls make "
          "up "
          "for each other in these data; survey the walls (--targets) or record more of them");
    out_.held_out_rms_m = candidates[chosen].cross_validation;
    out_.model = tried[chosen].model;
    state_ = tried[chosen].state;
    out_.result.candidates = candidates;
    out_.result.model = out_.model.name;
    out_.result.interrupted = o_.stop.stop_requested();
  }

  void cross_validate(const BiasModel& model, const State& full, Candidate& c) const {
    c.cross_validation = kNaN;
    const Layout l = layout(model);
    std::map<std::int32_t, std::array<double, 2>> sectors;
    for (int fold = 0; fold < o_.folds; ++fold) {
      // A wall or a beam that only the withheld sectors saw cannot be predicted.
      std::vector<std::size_t> of_plane(state_.q.size(), 0), of_beam(beams_, 0);
      for (const BiasCell& cell : cells_)
        if (cell.used && cell.fold != fold) ++of_plane[cell.plane], ++of_beam[cell.beam];
      const State s = solve(l, full, [&](const BiasCell& cell) { return cell.used && cell.fold != fold; });
      for (const BiasCell& cell : cells_) {
        if (!cell.used || cell.fold != fold || of_plane[cell.plane] < 8 || of_beam[cell.beam] < 3) continue;
        PredictedRange p;
        const double e = residual(s, cell, p);
        auto& sector = sectors[cell.sector];
        sector[0] += cell.count * e * e + cell.square_m2, sector[1] += cell.count;
      }
    }
    if (sectors.size() < 3) return;
    std::vector<double> squares, counts;
    for (const auto& [k, v] : sectors) squares.push_back(v[0] / v[1]), counts.push_back(v[1]);
    set_cross_validation(c, std::move(squares), std::move(counts));
  }

  /// The information that is left when the walls are solved for.
  [[nodiscard]] static MatrixXd without_walls(const Layout& l, const MatrixXd& information) {
    const Index w = l.wanted();
    MatrixXd reduced = information.topLeftCorner(w, w);
    if (l.size() == w) return reduced;
    const Index n = l.size() - w;
    VectorXd s(n);
    for (Index i = 0; i < n; ++i)
      s[i] = information(w + i, w + i) > 0 ? 1 / std::sqrt(information(w + i, w + i)) : 0;
    const MatrixXd unit = s.asDiagonal() * information.bottomRightCorner(n, n) * s.asDiagonal();
    const MatrixXd inverse =
        s.asDiagonal() * MatrixXd(unit.completeOrthogonalDecomposition().pseudoInverse()) * s.asDiagonal();
    const MatrixXd cross = information.topRightCorner(w, n);
    return reduced - cross * inverse * cross.transpose();
  }

  /// Names, values and resolutions; which of them are biases of beams that met a wall; noise of a shot.
  [[nodiscard]] std::vector<Parameter> parameters_of(const BiasModel& model, const State& s,
                                                     std::vector<int>& bias_at, double& shot) const {
    // What a parameter must be known to, to be of use: one shot's noise.
    std::vector<double> ranges;
    double cells = 0;
    shot = 0;
    std::vector<bool> seen(beams_, false);
    for (const BiasCell& c : cells_) {
      if (!c.used) continue;
      seen[c.beam] = true;
      shot += c.shot_variance_m2 * c.count, ++cells;
      ranges.push_back(predict(s, c.beam, c.plane, c.azimuth_rad, c.remission).d_scale_m);
    }
    shot = std::sqrt(shot / std::max(1.0, cells));
    const double range = median(ranges);
    std::vector<Parameter> out;
    const auto add = [&](const std::string& name, double value, double resolution) {
      out.push_back({name, value, 0, resolution, false, false});
    };
    if (model.offset) add("range_bias_m", s.errors.front().bias_m, shot);
    if (model.beams)
      for (int b = 0; b < static_cast<int>(beams_); ++b) {
        if (seen[static_cast<std::size_t>(b)]) bias_at.push_back(static_cast<int>(out.size()));
        add(name_of("beam_bias_m", b), s.errors[static_cast<std::size_t>(b)].bias_m, shot);
      }
    if (model.angles) {
      for (int b = 0; b < static_cast<int>(beams_); ++b)
        add(name_of("beam_elevation_rad", b),
            sensor_model_.scan.beams[static_cast<std::size_t>(b)].elevation_rad +
                s.errors[static_cast<std::size_t>(b)].elevation_rad,
            shot / range);
      for (int b = 1; b < static_cast<int>(beams_); ++b)
        add(name_of("beam_azimuth_rad", b),
            sensor_model_.scan.beams[static_cast<std::size_t>(b)].azimuth_rad +
                s.errors[static_cast<std::size_t>(b)].azimuth_rad,
            shot / range);
    }
    const BeamErrors& first = s.errors.front();
    if (model.walk) add("remission_bias_m", first.remission_bias_m, shot);
    if (model.oblique) add("incidence_bias_m", first.incidence_bias_m, shot);
    if (model.scale) add("range_scale", first.scale, shot / range);
    return out;
  }

  /// Whether the data determine what a model has beside a bias that all beams share.
  [[nodiscard]] bool determined(const BiasModel& model, const State& s) const {
    const Layout l = layout(model);
    if (l.wanted() == 0) return true;
    MatrixXd information;
    (void)solve(l, s, in_use, &information);
    std::vector<int> bias_at;
    double shot = 0;
    std::vector<Parameter> p = parameters_of(model, s, bias_at, shot);
    for (std::size_t i = 0; i < p.size(); ++i)
      p[i].held = !(information(static_cast<Index>(i), static_cast<Index>(i)) > 0);
    for (const WeakDirection& d :
         weak_directions(p, without_walls(l, information) / correlation(s).cells_along()))
      if (!is_common_bias(d, bias_at.size())) return false;
    return true;
  }

  [[nodiscard]] static bool is_common_bias(const WeakDirection& d, std::size_t biases) {
    bool same = biases > 1 && 2 * d.parts.size() > biases;
    for (const auto& part : d.parts) same = same && part.name.starts_with("beam_bias") && part.weight > 0;
    return same;
  }

  void finish() {
    FitResult& f = out_.result;
    const Layout l = layout(out_.model);
    MatrixXd information;
    for (int round = 0; round < 3; ++round) {
      state_ = solve(l, state_, in_use, &information);
      spread_between_cells(state_, static_cast<std::size_t>(l.size()));
    }
    state_ = solve(l, state_, in_use, &information);
    const Correlation alike = correlation(state_);
    out_.neighbour_correlation = alike.along, out_.column_correlation = alike.across;
    const MatrixXd independent = without_walls(l, information / alike.cells_along());
    information = information_of(l, state_, information, alike);

    const Index w = l.wanted();
    const MatrixXd reduced = without_walls(l, information);
    std::vector<int> bias_at;
    double shot = 0;
    f.parameters = parameters_of(out_.model, state_, bias_at, shot);
    for (Index i = 0; i < w; ++i)
      if (!(information(i, i) > 0)) f.parameters[static_cast<std::size_t>(i)].held = true;

    f.weak = weak_directions(f.parameters, reduced);
    explain(bias_at);
    f.covariance = covariance_from(f.parameters, reduced);
    if (bias_at.size() > 1) free_common_bias(bias_at, reduced, independent, shot);
    for (std::size_t i = 0; i < f.parameters.size(); ++i)
      if (f.parameters[i].held) {
        f.parameters[i].held = false;
        f.parameters[i].sigma = kInfinity;
        f.covariance(static_cast<Index>(i), static_cast<Index>(i)) = kInfinity;
        f.not_identifiable.emplace_back(f.parameters[i].name, "the beam met no wall");
      }

    for (std::size_t k = 0; k < state_.q.size(); ++k) {
      LidarPlane p = found_.planes[k];
      p.q_per_m = state_.q[k];
      out_.planes.push_back(p);
      out_.plane_sigma_m.push_back(std::sqrt(tau2_[k]));
    }
    out_.errors = state_.errors;
    residuals_of(state_, residual_);
    name_rejected();
    std::vector<double> good;
    double from = 1e300, to = 0;
    for (std::size_t i = 0; i < returns_.size(); ++i) {
      if (!used_[i]) continue;
      good.push_back(static_cast<double>(residual_[i]));
      from = std::min(from, static_cast<double>(returns_[i].range_m));
      to = std::max(to, static_cast<double>(returns_[i].range_m));
    }
    f.residuals = statistics_of(good, "m");
    std::size_t on_planes = 0;
    for (const auto label : label_) on_planes += label >= 0;
    f.residuals.rejected = on_planes - f.residuals.count;
    f.scale = shot;
    f.validity.push_back({"range_m", from, to});
    out_.residual_m = residual_;
    out_.used = used_;
    out_.cells = cells_;
  }

  /// Names in words what is behind a weak direction.
  void explain(const std::vector<int>& bias_at) {
    for (WeakDirection& d : out_.result.weak) {
      std::size_t angles = 0;
      for (const auto& part : d.parts)
        angles += part.name.starts_with("beam_el") || part.name.starts_with("beam_az");
      if (is_common_bias(d, bias_at.size()) || (d.parts.size() == 1 && d.parts[0].name == "range_bias_m")) {
        d.words =
            "the data cannot tell a bias that all beams share from the distance of the wall: both change "
            "every "
            "range alike";
        d.cure =
            "record a wall at more oblique angles or walls on several sides, or survey the walls (--targets)";
      } else if (angles > 0) {
        d.cure = "record walls at different ranges, and a floor or a ceiling for the elevations";
      } else {
        d.cure = "record walls of several reflectances, square on and oblique, at different ranges";
      }
    }
  }

  /// What information on the parameters says with and without the bias that all beams share.
  struct WithoutCommonBias {
    double common_sigma_m = kInfinity;
    MatrixXd covariance;       ///< of the parameters that are free, the common bias left out
    bool others_free = false;  ///< something else is open, too
  };
  [[nodiscard]] static WithoutCommonBias without_common_bias(const MatrixXd& info, const VectorXd& common) {
    WithoutCommonBias out;
    const Index n = common.size();
    // A basis whose first vector is the shared bias.
    const Eigen::HouseholderQR<MatrixXd> qr(common);
    const MatrixXd q = qr.householderQ() * MatrixXd::Identity(n, n);
    const MatrixXd rest = q.rightCols(n - 1);
    const MatrixXd inner = rest.transpose() * info * rest;
    VectorXd scale(n - 1);
    for (Index i = 0; i < n - 1; ++i) scale[i] = inner(i, i) > 0 ? 1 / std::sqrt(inner(i, i)) : 0;
    const MatrixXd unit = scale.asDiagonal() * inner * scale.asDiagonal();
    const Eigen::SelfAdjointEigenSolver<MatrixXd> e(unit);
    VectorXd inverse(n - 1);
    for (Index i = 0; i < n - 1; ++i) {
      const bool known = e.eigenvalues()[i] > 1e-11;
      inverse[i] = known ? 1 / e.eigenvalues()[i] : 0;
      out.others_free = out.others_free || !known;
    }
    const MatrixXd cov = scale.asDiagonal() *
                         (e.eigenvectors() * inverse.asDiagonal() * e.eigenvectors().transpose()) *
                         scale.asDiagonal();
    const VectorXd cross = rest.transpose() * info * common;
    const double about = common.dot(info * common) - cross.dot(cov * cross);
    if (about > 0) out.common_sigma_m = 1 / std::sqrt(about);
    out.covariance = rest * cov * rest.transpose();
    return out;
  }

  /// Where walls make up for the bias that all beams share, so that even independent cells would not tell it
  /// to better than a shot's noise, it is left out: the biases are told against their mean, which the data do
  /// determine. `independent`: the information, were cells independent.
  void free_common_bias(const std::vector<int>& at, const MatrixXd& s, const MatrixXd& independent,
                        double shot) {
    FitResult& f = out_.result;
    std::vector<int> free;
    for (std::size_t i = 0; i < f.parameters.size(); ++i)
      if (!f.parameters[i].held) free.push_back(static_cast<int>(i));
    const auto n = static_cast<Index>(free.size());
    VectorXd common = VectorXd::Zero(n);
    for (Index i = 0; i < n; ++i)
      if (std::find(at.begin(), at.end(), free[static_cast<std::size_t>(i)]) != at.end()) common[i] = 1;
    const WithoutCommonBias as_they_are = without_common_bias(s(free, free), common),
                            if_independent = without_common_bias(independent(free, free), common);
    double square = 0;
    for (Index i = 0; i < n; ++i)
      if (common[i] > 0) square += as_they_are.covariance(i, i) / static_cast<double>(at.size());
    out_.beams_differ_sigma_m = std::sqrt(square);
    const double sigma = as_they_are.common_sigma_m;
    if (if_independent.common_sigma_m <= shot || if_independent.others_free) return;
    out_.common_bias_free = true;
    const MatrixXd& c = as_they_are.covariance;
    double mean = 0;
    for (const int i : at)
      mean += f.parameters[static_cast<std::size_t>(i)].value / static_cast<double>(at.size());
    for (const int i : at) f.parameters[static_cast<std::size_t>(i)].value -= mean;
    for (BeamErrors& b : state_.errors) b.bias_m -= mean;
    // The walls follow.
    const Layout walls({.name = "walls"}, beams_, state_.q.size(), flat_, o_.surveyed);
    state_ = solve(walls, state_, in_use);
    for (Index i = 0; i < n; ++i) {
      const auto pi = static_cast<Index>(free[static_cast<std::size_t>(i)]);
      for (Index j = 0; j < n; ++j) f.covariance(pi, free[static_cast<std::size_t>(j)]) = c(i, j);
      f.parameters[static_cast<std::size_t>(pi)].sigma = std::sqrt(std::max(0.0, c(i, i)));
    }
    char text[160];
    std::snprintf(text, sizeof text,
                  "a bias that all beams share is only known to %.3g m: the walls' distances make up for it; "
                  "the biases are against their mean",
                  sigma);
    f.not_identifiable.emplace_back(
        "common_bias_m", std::isfinite(sigma)
                             ? text
                             : "a bias that all beams share cannot be told from the walls' distances; the "
                               "biases are against their mean");
  }

  /// Returns that were left out, and those of cells that were: by wall, beam and sector.
  void name_rejected() {
    std::map<std::tuple<int, int, std::int32_t>, bool> left_out;
    const auto cell_key = [&](std::size_t i) {
      const LidarReturn& r = returns_[i];
      return std::tuple<int, int, std::int32_t>(
          label_[i], r.beam,
          static_cast<std::int32_t>(std::floor(static_cast<double>(r.azimuth_rad) / o_.cell_rad)));
    };
    for (const BiasCell& c : cells_)
      if (!c.used)
        left_out[{c.plane, c.beam, static_cast<std::int32_t>(std::floor(c.azimuth_rad / o_.cell_rad))}] =
            true;
    struct Group {
      std::size_t count = 0;
      double largest = 0;
    };
    std::map<std::tuple<int, int, int>, Group> groups;
    for (std::size_t i = 0; i < returns_.size(); ++i) {
      if (label_[i] < 0) continue;
      if (used_[i] && !left_out.count(cell_key(i))) continue;
      used_[i] = 0;
      const LidarReturn& r = returns_[i];
      const int sector = static_cast<int>(std::floor(static_cast<double>(r.azimuth_rad) / o_.sector_rad)) *
                         static_cast<int>(std::lround(o_.sector_rad * 180 / std::numbers::pi));
      Group& g = groups[{label_[i], r.beam, sector}];
      ++g.count;
      if (std::abs(static_cast<double>(residual_[i])) > std::abs(g.largest)) g.largest = residual_[i];
    }
    std::vector<Rejected>& list = out_.result.rejected;
    for (const auto& [key, g] : groups)
      list.push_back(
          {found_.planes[static_cast<std::size_t>(std::get<0>(key))].name + ", beam " +
               std::to_string(std::get<1>(key)) + ", azimuth " + std::to_string(std::get<2>(key)) + " to " +
               std::to_string(std::get<2>(key) +
                              static_cast<int>(std::lround(o_.sector_rad * 180 / std::numbers::pi))) +
               " deg: " + std::to_string(g.count) + " returns",
           std::abs(g.largest), std::abs(g.largest) / std::max(1e-300, spread_)});
    std::stable_sort(list.begin(), list.end(),
                     [](const Rejected& a, const Rejected& b) { return a.residual > b.residual; });
  }

  BiasFit out_;
};

}  // namespace

std::vector<BiasModel> bias_models(std::size_t beams, bool flat, bool surveyed) {
  std::vector<BiasModel> m{{.name = "none"}, {.name = "offset", .offset = true}};
  BiasModel base{.name = "offset", .offset = true};
  if (beams > 1) m.push_back(base = {.name = "beams", .beams = true});
  const auto with = [&](const char* name, bool angles, bool walk, bool oblique) {
    BiasModel x = base;
    x.name += name;
    x.angles = angles, x.walk = walk, x.oblique = oblique;
    m.push_back(x);
  };
  with("+walk", false, true, false);
  with("+oblique", false, false, true);
  if (beams > 1 && !flat) with("+angles", true, false, false);
  if (beams > 1 && !flat) with("+angles+walk", true, true, false);
  if (surveyed) {
    const std::size_t n = m.size();
    for (std::size_t i = 1; i < n; ++i) {
      BiasModel x = m[i];
      x.name += "+scale";
      x.scale = true;
      m.push_back(x);
    }
  }
  return m;
}

Result<BiasFit> fit_biases(const LidarReturns& returns, const models::LidarModel& sensor_model,
                           const PlaneSearch& planes, const BiasFitOptions& options) {
  if (planes.planes.empty())
    return fail(ErrorCode::bad_input, "",
                "expected at least one wall among " + std::to_string(returns.all.size()) +
                    " returns, found none: a plane that holds 10 % of them to within " +
                    std::to_string(planes.tolerance_m) + " m was looked for");
  return Fit(returns, sensor_model, planes, options).run();
}

}  // namespace rigor::calibration
