#include "calibration/lidar/range_noise.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>

#include "calibration/core/least_squares.h"
#include "calibration/core/model_choice.h"
#include "calibration/lidar/noise_likelihood.h"
#include "calibration/lidar/rounded_values.h"
#include "rt-core/numbers.h"
#include "sensor-hal/models/lidar/lidar_math.h"

namespace rigor::calibration {
namespace {

using namespace lidar;

using Eigen::Index;
using Eigen::MatrixXd;
constexpr double kOutlier = 4.5;  ///< a shot beyond this many sigmas is not noise

/// Quantile of χ²/dof (Wilson & Hilferty 1931); z of the normal distribution.
double chi_square_quantile(double dof, double z) {
  const double a = 2 / (9 * dof), t = 1 - a + z * std::sqrt(a);
  return t > 0 ? t * t * t : 0;
}

class RangeNoiseFit {
 public:
  RangeNoiseFit(const LidarReturns& returns, const models::LidarModel& sensor_model,
                const NoiseFitOptions& options)
      : r_(returns), sensor_model_(sensor_model), o_(options), step_m_(sensor_model.range.step_m) {}

  Result<NoiseFit> run() {
    group();
    for (Group& g : groups_) measure(g);
    std::erase_if(groups_, [](const Group& g) { return g.cell.dof < 1; });
    if (groups_.size() < 5)
      return fail(ErrorCode::bad_input, "",
                  "expected shots of one beam at one spot to compare, found " +
                      std::to_string(groups_.size()) +
                      " such spots: several scans from a stand that does not move are needed");
    choose_cells();
    make_bins();
    if (bins_.empty())
      return fail(
          ErrorCode::bad_input, "",
          "expected spots where the range holds still, found none among " + std::to_string(groups_.size()));
    if (Status s = compare(); !s) return tl::unexpected<Error>(s.error());
    summarise();
    return std::move(out_);
  }

 private:
  struct Group {
    std::uint32_t begin = 0, end = 0;  ///< into order_
    int degree = 0;
    NoiseCell cell;
  };

  void group() {
    // As narrow as a column of the scan where there are scans enough, else as wide as a dozen shots need.
    const double column =
        std::max(1e-4, std::abs(sensor_model_.scan.rotation_radps) * sensor_model_.scan.column_period_s);
    // Beyond a few degrees a parabola is not what a wall looks like.
    constexpr double kWidest = 2.5 * std::numbers::pi / 180;
    width_ = column * std::clamp(std::floor(kWidest / column), 1.0, std::ceil(12.0 / std::max(1u, r_.scans)));
    order_.resize(r_.all.size());
    std::vector<std::uint64_t> key(r_.all.size());
    for (std::uint32_t i = 0; i < order_.size(); ++i) {
      order_[i] = i;
      const LidarReturn& x = r_.all[i];
      // Columns lie at whole multiples: cells are centred on them.
      const auto cell = static_cast<std::uint64_t>(
          std::floor((static_cast<double>(x.azimuth_rad) - sensor_model_.scan.start_azimuth_rad) / width_ +
                     0.5) +
          (1 << 24));
      key[i] = static_cast<std::uint64_t>(x.beam) << 32 | cell;
    }
    std::sort(order_.begin(), order_.end(),
              [&](std::uint32_t a, std::uint32_t b) { return key[a] != key[b] ? key[a] < key[b] : a < b; });
    for (std::uint32_t i = 0; i < order_.size();) {
      std::uint32_t j = i;
      while (j < order_.size() && key[order_[j]] == key[order_[i]]) ++j;
      if (j - i >= 4) groups_.push_back({i, j, 0, {}});
      i = j;
    }
    out_.shot_residual_m.assign(r_.all.size(), std::numeric_limits<float>::quiet_NaN());
  }

  /// Residuals of a cell's shots about a polynomial over azimuth; `limit_m`: shots beyond it take no part.
  void measure(Group& g, double limit_m = 0, bool keep = false) {
    const std::size_t n = g.end - g.begin;
    double a0 = 0, low = 1e9, high = -1e9;
    for (std::uint32_t k = g.begin; k < g.end; ++k) {
      const double a = r_.all[order_[k]].azimuth_rad;
      a0 += a / static_cast<double>(n), low = std::min(low, a), high = std::max(high, a);
    }
    g.degree = high - low < 2e-5 ? 0 : width_ < 0.01 ? 1 : 2;
    std::vector<char> in(n, 1);
    g.cell = {};
    std::vector<double> e(n, 0), size(n, 0), t(n, 0), v(n, 0);
    const double reference = r_.all[order_[g.begin]].range_m, half = std::max(1e-9, 0.5 * (high - low));
    for (std::size_t i = 0; i < n; ++i) {
      const LidarReturn& x = r_.all[order_[g.begin + i]];
      t[i] = (static_cast<double>(x.azimuth_rad) - a0) / half;
      v[i] = static_cast<double>(x.range_m) - reference;
    }
    const int m = g.degree + 1;
    const auto fit = [&](const auto& weight) {
      Eigen::Matrix3d h = Eigen::Matrix3d::Identity();
      Eigen::Vector3d b = Eigen::Vector3d::Zero();
      h.topLeftCorner(m, m).setZero();
      for (std::size_t i = 0; i < n; ++i) {
        const double w = weight(i);
        const Eigen::Vector3d p(1, m > 1 ? t[i] : 0, m > 2 ? t[i] * t[i] : 0);
        h += w * p * p.transpose(), b += w * v[i] * p;
      }
      for (int k = m; k < 3; ++k) h(k, k) = 1;
      const Eigen::Vector3d c = h.ldlt().solve(b);
      for (std::size_t i = 0; i < n; ++i) e[i] = v[i] - c[0] - c[1] * t[i] - c[2] * t[i] * t[i];
    };
    // Least absolute residuals, from the median: a third of the shots may lie anywhere.
    size = v;
    std::nth_element(size.begin(), size.begin() + static_cast<std::ptrdiff_t>(n / 2), size.end());
    const double centre = size[n / 2];
    for (std::size_t i = 0; i < n; ++i) e[i] = v[i] - centre;
    const auto typical = [&] {
      for (std::size_t i = 0; i < n; ++i) size[i] = std::abs(e[i]);
      std::nth_element(size.begin(), size.begin() + static_cast<std::ptrdiff_t>(n / 2), size.end());
      return size[n / 2];
    };
    if (g.degree > 0)
      for (int round = 0; round < 6; ++round) {
        const double s = std::max(typical(), 1e-9 * std::abs(reference));
        fit([&](std::size_t i) { return 1 / (s + std::abs(e[i])); });
      }
    if (limit_m == 0) {
      const double s = 1.4826 * typical(),
                   share = static_cast<double>(n) / static_cast<double>(n - static_cast<std::size_t>(m));
      g.cell.variance_m2 = s * s * share;
      g.cell.dof = static_cast<double>(n) - m;
    } else {
      double used = 0, sum = 0;
      for (int round = 0; round < 3; ++round) {
        used = sum = 0;
        for (std::size_t i = 0; i < n; ++i) in[i] = std::abs(e[i]) <= limit_m, used += in[i];
        if (used < m + 1) {
          g.cell.dof = 0;
          return;
        }
        fit([&](std::size_t i) { return in[i] ? 1.0 : 0.0; });
      }
      for (std::size_t i = 0; i < n; ++i)
        if (in[i]) sum += e[i] * e[i];
      g.cell.variance_m2 = sum / (used - m);
      g.cell.dof = used - m;
    }
    double used = 0, units = 0, units_square = 0, range = 0;
    for (std::size_t i = 0; i < n; ++i) {
      if (!in[i]) continue;
      const LidarReturn& x = r_.all[order_[g.begin + i]];
      ++used;
      const double u = std::isfinite(x.remission) ? static_cast<double>(x.remission) : 0;
      units += u, units_square += u * u;
      range += static_cast<double>(x.range_m);
    }
    g.cell.units = units / used, g.cell.range_m = range / used;
    g.cell.units_variance = std::max(0.0, units_square - units * units / used) / (used - 1);
    g.cell.remission = remission_from_units(sensor_model_.remission, g.cell.units, g.cell.range_m);
    if (!keep) return;
    for (std::size_t i = 0; i < n; ++i)
      if (in[i]) out_.shot_residual_m[order_[g.begin + i]] = static_cast<float>(e[i]);
  }

  /// Median variance by remission: what most cells have, edges and movers aside.
  void choose_cells() {
    for (int round = 0; round < 2; ++round) {
      std::vector<std::size_t> by(groups_.size());
      for (std::size_t i = 0; i < by.size(); ++i) by[i] = i;
      std::stable_sort(by.begin(), by.end(), [&](std::size_t a, std::size_t b) {
        return groups_[a].cell.remission < groups_[b].cell.remission;
      });
      const std::size_t bins = std::clamp<std::size_t>(groups_.size() / 40, 1, 40);
      std::vector<double> limit(groups_.size(), 0);
      for (std::size_t k = 0; k < bins; ++k) {
        const std::size_t from = k * by.size() / bins, to = (k + 1) * by.size() / bins;
        std::vector<double> v;
        for (std::size_t i = from; i < to; ++i) {
          const NoiseCell& c = groups_[by[i]].cell;
          if (c.dof >= 1) v.push_back(c.variance_m2 / chi_square_quantile(c.dof, 0));
        }
        if (v.empty()) continue;
        std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
        const double typical = std::max(v[v.size() / 2], step_m_ * step_m_ / 100);
        for (std::size_t i = from; i < to; ++i) limit[by[i]] = typical;
      }
      for (std::size_t i = 0; i < groups_.size(); ++i) {
        Group& g = groups_[i];
        if (round == 0) {
          measure(g, kOutlier * std::sqrt(limit[i]) + step_m_, false);
        } else {
          // One good cell in ten thousand goes with the bad.
          g.cell.used =
              g.cell.dof >= 1 && g.cell.variance_m2 <= limit[i] * chi_square_quantile(g.cell.dof, 3.72);
          if (g.cell.used) measure(g, kOutlier * std::sqrt(limit[i]) + step_m_, true);
        }
      }
    }
    for (const Group& g : groups_) out_.cells.push_back(g.cell);
  }

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
    std::vector<std::vector<double>> errors(shapes.size());
    for (std::size_t m = 0; m < shapes.size(); ++m) {
      const Shape& s = *shapes[m];
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
        for (int band = 0; band < bands_; ++band) {
          Guess g = best;
          l.fit(s, g, band);
          double measured = 0, predicted = 0, d = 0;
          for (const Bin& b : bins_)
            if (b.band == band)
              measured += b.dof * b.variance, predicted += b.dof * l.variance(g.model(s), b.remission),
                  d += b.dof;
          if (!(d > 0)) continue;
          errors[m].push_back(0.5 * std::log(measured / predicted));
        }
        double sum = 0, fourth = 0;
        for (const double e : errors[m]) sum += e * e, fourth += e * e * e * e;
        const auto n = static_cast<double>(errors[m].size());
        c.cross_validation = std::sqrt(sum / n);
        c.cross_validation_sigma = std::sqrt(std::max(0.0, fourth / n - sum * sum / (n * n)) / n) /
                                   (2 * std::max(1e-12, c.cross_validation));
        // Two models that both predict to within what the data can judge are equally good.
        c.cross_validation_sigma = std::max(c.cross_validation_sigma, std::sqrt(n / (2 * dof_)));
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
    if (!s.scale) explain_constant();
    return {};
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
    for (const Group& g : groups_) still = still && g.degree == 0;
    for (const float x : out_.shot_residual_m)
      if (std::isfinite(x)) e.push_back(static_cast<double>(x));
    for (const Bin& b : bins_) from = std::min(from, b.remission), to = std::max(to, b.remission);
    std::size_t all = 0;
    for (const Group& g : groups_) all += g.end - g.begin;
    f.residuals = statistics_of(e, "m");
    f.residuals.rejected = all - f.residuals.count;
    f.validity.push_back({"remission", from, to});
    if (!still || !(step_m_ > 0)) return;
    std::vector<RoundedSeries> series;
    const std::size_t every = std::max<std::size_t>(1, groups_.size() / 60);
    for (std::size_t i = 0; i < groups_.size(); i += every) {
      const Group& g = groups_[i];
      if (!g.cell.used || (g.cell.remission > 1 && !all_are_plain_)) continue;
      std::map<std::int64_t, std::uint32_t> counts;
      for (std::uint32_t k = g.begin; k < g.end; ++k)
        if (std::isfinite(out_.shot_residual_m[order_[k]]))
          ++counts[std::llround(static_cast<double>(r_.all[order_[k]].range_m) / step_m_)];
      series.push_back({{counts.begin(), counts.end()}});
    }
    const RoundedSigma s = sigma_of_rounded(series);
    out_.rounded_sigma_m = s.sigma * step_m_;
    out_.rounded_sigma_uncertainty_m = s.uncertainty * step_m_;
  }

  const LidarReturns& r_;
  const models::LidarModel& sensor_model_;
  const NoiseFitOptions& o_;
  double step_m_, width_ = 0, least_ = 0, dof_ = 0;
  int bands_ = 0;
  double retro_sigma_ = 0, retro_uncertainty_ = 0;
  bool all_are_plain_ = false;  ///< no split at white
  std::vector<std::uint32_t> order_;
  std::vector<Group> groups_;
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
