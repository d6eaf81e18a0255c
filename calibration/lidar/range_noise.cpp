#include "calibration/lidar/range_noise.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "calibration/lidar/noise_cells.h"
#include "calibration/lidar/noise_likelihood.h"
#include "calibration/lidar/rounded_values.h"
#include "rt-core/numbers.h"
#include "sensor-hal/models/lidar/lidar_math.h"

namespace rigor::calibration {
namespace {

using namespace lidar;

using Eigen::Index;
using Eigen::MatrixXd;

class RangeNoiseFit {
 public:
  RangeNoiseFit(const LidarReturns& returns, const models::LidarModel& sensor_model,
                const NoiseFitOptions& options)
      : r_(returns),
        sensor_model_(sensor_model),
        o_(options),
        step_m_(sensor_model.range.step_m),
        cells_(returns, sensor_model) {}

  Result<NoiseFit> run() {
    if (cells_.groups.size() < 5)
      return fail(ErrorCode::bad_input, "",
                  "expected shots of one beam at one spot to compare, found " +
                      std::to_string(cells_.groups.size()) +
                      " such spots: several scans from a stand that does not move are needed");
    cells_.choose();
    for (const NoiseCells::Group& g : cells_.groups) out_.cells.push_back(g.cell);
    out_.shot_residual_m = std::move(cells_.shot_residual_m);
    make_bins();
    if (bins_.empty())
      return fail(ErrorCode::bad_input, "",
                  "expected spots where the range holds still, found none among " +
                      std::to_string(cells_.groups.size()));
    if (Status s = compare(); !s) return tl::unexpected<Error>(s.error());
    summarise();
    return std::move(out_);
  }

 private:
  void make_bins() {
    std::vector<const NoiseCell*> by;
    double square = 0, dof = 0, retro_square = 0, retro_dof = 0;
    std::size_t retro = 0;
    for (const NoiseCell& c : out_.cells) {
      if (!c.used || !(c.dof > 0)) continue;
      if (c.remission > 1) {
        retro_square += c.variance_m2 * c.dof, retro_dof += c.dof, ++retro;
        continue;
      }
      by.push_back(&c);
      square += c.variance_m2 * c.dof, dof += c.dof;
    }
    if (retro >= 30) {
      retro_sigma_ = std::sqrt(without_rounding(retro_square / retro_dof, step_m_));
      retro_uncertainty_ = retro_sigma_ / std::sqrt(2 * retro_dof);
    }
    // Where a good part lies above white, the sensor model's scale is not this device's: no retro-reflectors
    // then.
    if (by.empty() || retro_dof > 0.2 * (dof + retro_dof)) {
      by.clear();
      square = dof = 0;
      for (const NoiseCell& c : out_.cells)
        if (c.used && c.dof > 0) by.push_back(&c), square += c.variance_m2 * c.dof, dof += c.dof;
      retro_sigma_ = 0;
      all_are_plain_ = true;
    }
    if (by.empty()) return;
    out_.sigma_m = std::sqrt(without_rounding(square / dof, step_m_));
    std::stable_sort(by.begin(), by.end(),
                     [](const NoiseCell* a, const NoiseCell* b) { return a->remission < b->remission; });
    const std::size_t count = std::clamp<std::size_t>(by.size() / 8, 1, 120);
    std::vector<double> edges;
    double done = 0;
    const std::size_t bands = std::min<std::size_t>(static_cast<std::size_t>(o_.bands), count);
    for (std::size_t k = 0; k < count; ++k) {
      Bin b;
      for (std::size_t i = k * by.size() / count; i < (k + 1) * by.size() / count; ++i) {
        b.remission += by[i]->remission * by[i]->dof;
        b.variance += by[i]->variance_m2 * by[i]->dof;
        b.dof += by[i]->dof;
      }
      if (!(b.dof > 0)) continue;
      b.remission /= b.dof, b.variance /= b.dof;
      b.band = static_cast<int>(
          std::min<double>(static_cast<double>(bands) - 1,
                           std::floor((done + 0.5 * b.dof) / dof * static_cast<double>(bands))));
      done += b.dof;
      bins_.push_back(b);
    }
    dof_ = dof;
    bands_ = static_cast<int>(bands);
    // Half a unit of what the device tells is the least that can be told from none.
    const double unit = sensor_model_.remission.step > 0 ? sensor_model_.remission.step : 0;
    least_ = std::max(1e-6, 0.5 * unit / sensor_model_.remission.scale);
  }

  Status compare() {
    const Likelihood l(bins_, step_m_, least_);
    std::vector<Candidate> candidates;
    std::vector<Guess> guesses;
    std::vector<const Shape*> shapes;
    std::string names;
    for (const Shape& s : kShapes) {
      names += (names.empty() ? "" : ", ") + std::string(s.name);
      if (o_.model != "auto" && o_.model != s.name) continue;
      if (o_.model == "auto" && s.scale && bands_ < 3) continue;  // one remission: nothing to learn
      shapes.push_back(&s);
    }
    if (shapes.empty())
      return fail(ErrorCode::bad_input, "--noise-model",
                  "expected auto or one of " + names + ", got " + o_.model);
    for (const Shape* shape : shapes) {
      const Shape& s = *shape;
      // From several starts: the likelihood of four numbers has more than one top.
      Guess best;
      double least = std::numeric_limits<double>::infinity();
      for (const double offset : {0.02, 0.2, 2.0}) {
        if (!s.offset && offset > 0.02) break;
        for (const double exponent : {0.3, 1.0}) {
          Guess g;
          g.t = {std::log(0.5 * out_.sigma_m + 1e-12),
                 std::log(out_.sigma_m + 1e-12) +
                     (s.exponent ? exponent : s.fixed_exponent) *
                         std::log(bins_[bins_.size() / 2].remission + (s.offset ? offset : 0) + least_),
                 std::log(offset), exponent};
          const double d = l.fit(s, g, -1);
          if (d < least) least = d, best = g;
          if (!s.exponent) break;
        }
      }
      guesses.push_back(best);
      Candidate c;
      c.name = s.name;
      c.parameters = s.parameters();
      c.bic = least + c.parameters * std::log(std::max(2.0, dof_));
      double square = 0;
      for (const Bin& b : bins_) square += b.dof * b.variance;
      c.rms = std::sqrt(square / dof_);
      c.cross_validation = kNaN;
      if (bands_ >= 3) {
        std::vector<double> squares;
        for (int band = 0; band < bands_; ++band) {
          Guess g = best;
          l.fit(s, g, band);
          double measured = 0, predicted = 0, d = 0;
          for (const Bin& b : bins_)
            if (b.band == band)
              measured += b.dof * b.variance, predicted += b.dof * l.variance(g.model(s), b.remission),
                  d += b.dof;
          if (!(d > 0)) continue;
          squares.push_back(std::pow(0.5 * std::log(measured / predicted), 2));
        }
        set_cross_validation(c, std::move(squares));
        // Two models that both predict to within what the data can judge are equally good.
        c.cross_validation_sigma = std::max(c.cross_validation_sigma, std::sqrt(bands_ / (2 * dof_)));
      }
      candidates.push_back(c);
    }
    const std::size_t chosen = choose_model(candidates);
    const Shape& s = *shapes[chosen];
    MatrixXd information;
    Guess g = guesses[chosen];
    l.fit(s, g, -1, &information);
    out_.model = g.model(s);
    FitResult& f = out_.result;
    f.candidates = candidates;
    f.model = s.name;
    if (std::isfinite(candidates[chosen].cross_validation))
      out_.withheld_error = candidates[chosen].cross_validation;

    // Cells vary by more than their degrees of freedom allow where a device's noise has other reasons, too:
    // the covariance grows with them (quasi-likelihood).
    double pearson = 0, cells = 0;
    for (const NoiseCell& c : out_.cells)
      if (c.used && c.dof > 0) {
        const double v = l.variance(out_.model, c.remission);
        if (c.remission > 1 && !all_are_plain_) continue;
        pearson += 0.5 * c.dof * (c.variance_m2 / v - 1) * (c.variance_m2 / v - 1);
        ++cells;
      }
    f.scale = std::sqrt(pearson / std::max(1.0, cells - s.parameters()));
    information /= std::max(1e-12, f.scale * f.scale);

    const char* names_of[4] = {"noise_floor_m", "noise_scale_m", "noise_offset", "noise_exponent"};
    const double values[4] = {out_.model.floor_m, out_.model.scale_m, out_.model.offset, out_.model.exponent};
    // What of each would change sigma by a half.
    const double resolution[4] = {0.5, 0.5, 1.0, 0.5};
    const auto free = free_of(s);
    std::vector<Parameter> logs;
    for (std::size_t i = 0; i < 4; ++i)
      if (free[i]) logs.push_back({names_of[i], values[i], 0, resolution[i], false, false});
    f.weak = weak_directions(logs, information);
    for (WeakDirection& w : f.weak)
      w.cure = "record surfaces of more different remission, from black to white, at the same range";
    const MatrixXd c = covariance_from(logs, information);
    f.covariance = MatrixXd::Zero(4, 4);
    std::vector<std::size_t> at;
    for (std::size_t i = 0; i < 4; ++i) {
      Parameter p{names_of[i], values[i], 0, i == 3 ? 0.5 : 0.5 * std::abs(values[i]), !free[i], false};
      if (free[i]) {
        const double unit = i == 3 ? 1 : values[i];
        p.sigma = logs[at.size()].sigma * unit;
        p.at_bound = i < 3 ? values[i] < 1e-3 * (i == 2 ? 0.1 : out_.sigma_m)
                           : values[i] <= 0.0201 || values[i] >= (s.offset ? 7.999 : 3.999);
        at.push_back(i);
      }
      f.parameters.push_back(p);
    }
    for (std::size_t i = 0; i < at.size(); ++i)
      for (std::size_t j = 0; j < at.size(); ++j)
        f.covariance(static_cast<Index>(at[i]), static_cast<Index>(at[j])) =
            c(static_cast<Index>(i), static_cast<Index>(j)) * (at[i] == 3 ? 1 : values[at[i]]) *
            (at[j] == 3 ? 1 : values[at[j]]);
    if (retro_sigma_ > 0) {
      f.parameters.push_back(
          {"retro_sigma_m", retro_sigma_, retro_uncertainty_ * f.scale, retro_sigma_, false, false});
      f.covariance.conservativeResizeLike(MatrixXd::Zero(5, 5));
      f.covariance(4, 4) = f.parameters.back().sigma * f.parameters.back().sigma;
    }
    // Bands for people.
    for (int band = 0; band < bands_; ++band) {
      NoiseBand b;
      double variance = 0, model = 0, withheld = 0, dof = 0;
      b.from = 1e300, b.to = 0;
      Guess w = g;
      if (bands_ >= 3) l.fit(s, w, band);
      for (const Bin& x : bins_) {
        if (x.band != band) continue;
        b.from = std::min(b.from, x.remission), b.to = std::max(b.to, x.remission);
        variance += x.dof * x.variance, dof += x.dof;
        model += x.dof * l.variance(out_.model, x.remission);
        withheld += x.dof * l.variance(w.model(s), x.remission);
      }
      if (!(dof > 0)) continue;
      b.measured_m = std::sqrt(without_rounding(variance / dof, step_m_));
      b.sigma_m = b.measured_m / std::sqrt(2 * dof) * f.scale;
      b.model_m = std::sqrt(without_rounding(model / dof, step_m_));
      b.withheld_m = std::sqrt(without_rounding(withheld / dof, step_m_));
      b.shots = dof;
      out_.bands.push_back(b);
    }
    warn_of_bands();
    if (!s.scale) explain_constant();
    return {};
  }

  /// What moves in white noise (leaves), or for as long as a band was seen, cannot be told from noise there:
  /// a band that does not follow the others is named.
  void warn_of_bands() {
    constexpr double kStandsOut = 0.15, kSigmas = 4;
    char text[300];
    for (const NoiseBand& b : out_.bands) {
      const double model = bands_ >= 3 ? b.withheld_m : b.model_m;
      if (!(b.measured_m > 0) || !(model > 0)) continue;
      const double away = std::log(b.measured_m / model);
      if (std::abs(away) <= std::max(kStandsOut, kSigmas * b.sigma_m / b.measured_m)) continue;
      std::snprintf(
          text, sizeof text,
          "the noise at remission %.3g to %.3g is %.3g mm, and %.3g mm by the other bands: something "
          "moved there, or the noise of this device does not follow the model",
          b.from, b.to, 1e3 * b.measured_m, 1e3 * model);
      out_.result.warnings.emplace_back(text);
    }
    if (out_.withheld_error <= kStandsOut) return;
    std::snprintf(text, sizeof text,
                  "the noise of a withheld band of remission is predicted to %.0f %% only: its sigmas do not "
                  "hold beyond the remissions that were recorded",
                  100 * out_.withheld_error);
    out_.result.warnings.emplace_back(text);
  }

  /// Why the noise is given as one number: what the remission in these data could have told.
  void explain_constant() {
    std::map<float, std::size_t> counts;
    std::size_t all = 0;
    for (const LidarReturn& r : r_.all)
      if (std::isfinite(r.remission)) ++counts[r.remission], ++all;
    if (all > 0) {
      out_.largest_units = counts.rbegin()->first;
      out_.largest_share = static_cast<double>(counts.rbegin()->second) / static_cast<double>(all);
    }
    char text[300];
    if (all == 0) {
      std::snprintf(text, sizeof text, "the device tells no remission");
    } else if (bands_ < 3 || out_.largest_share > 0.3) {
      std::snprintf(
          text, sizeof text,
          "how noise falls with remission cannot be seen: %.0f %% of the returns have the largest value "
          "that the device tells (%g)",
          100 * out_.largest_share, out_.largest_units);
    } else {
      std::snprintf(
          text, sizeof text,
          "no model in which noise depends on remission (%.3g to %.3g of white) predicts a withheld "
          "band better than one number does",
          bins_.front().remission, bins_.back().remission);
    }
    out_.result.not_identifiable.emplace_back("noise_slope", text);
  }

  void summarise() {
    FitResult& f = out_.result;
    std::vector<double> e;
    double from = 1e300, to = 0;
    bool still = true;
    for (const NoiseCells::Group& g : cells_.groups) still = still && g.degree == 0;
    for (const float x : out_.shot_residual_m)
      if (std::isfinite(x)) e.push_back(static_cast<double>(x));
    for (const Bin& b : bins_) from = std::min(from, b.remission), to = std::max(to, b.remission);
    std::size_t all = 0;
    for (const NoiseCells::Group& g : cells_.groups) all += g.end - g.begin;
    f.residuals = statistics_of(e, "m");
    f.residuals.rejected = all - f.residuals.count;
    f.validity.push_back({"remission", from, to});
    if (!still || !(step_m_ > 0)) return;
    std::vector<RoundedSeries> series;
    const std::size_t every = std::max<std::size_t>(1, cells_.groups.size() / 60);
    for (std::size_t i = 0; i < cells_.groups.size(); i += every) {
      const NoiseCells::Group& g = cells_.groups[i];
      if (!g.cell.used || (g.cell.remission > 1 && !all_are_plain_)) continue;
      std::map<std::int64_t, std::uint32_t> counts;
      for (std::uint32_t k = g.begin; k < g.end; ++k)
        if (std::isfinite(out_.shot_residual_m[cells_.order[k]]))
          ++counts[std::llround(static_cast<double>(r_.all[cells_.order[k]].range_m) / step_m_)];
      series.push_back({{counts.begin(), counts.end()}});
    }
    const RoundedSigma s = sigma_of_rounded(series);
    out_.rounded_sigma_m = s.sigma * step_m_;
    out_.rounded_sigma_uncertainty_m = s.uncertainty * step_m_;
  }

  const LidarReturns& r_;
  const models::LidarModel& sensor_model_;
  const NoiseFitOptions& o_;
  double step_m_, least_ = 0, dof_ = 0;
  NoiseCells cells_;
  int bands_ = 0;
  double retro_sigma_ = 0, retro_uncertainty_ = 0;
  bool all_are_plain_ = false;  ///< no split at white
  std::vector<Bin> bins_;
  NoiseFit out_;
};

}  // namespace

double NoiseModel::sigma_m(double remission) const {
  if (!(scale_m > 0)) return floor_m;
  return models::LidarMath<double>::lidar_range_sigma_m(std::max(remission, 1e-9), floor_m, scale_m, offset,
                                                        exponent);
}

Result<NoiseFit> fit_range_noise(const LidarReturns& returns, const models::LidarModel& sensor_model,
                                 const NoiseFitOptions& options) {
  return RangeNoiseFit(returns, sensor_model, options).run();
}

}  // namespace rigor::calibration
