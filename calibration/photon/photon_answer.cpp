// What the fit says: parameters that the data determine, and words for those that they do not.
#include <algorithm>
#include <cmath>

#include "calibration/photon/photon_problem.h"

namespace rigor::calibration {

void PhotonProblem::after(PhotonModel& m, LeastSquares::Outcome&) {
  FitResult& r = out_.result;
  out_.black_dn = m.p[kBlack];
  // The mean of the offset pattern is the same in all levels: none of them tells it from the black level.
  if (const int b = r.index_of("black_level_dn"); b >= 0 && plan_.dark_level && st_.dark_pattern_dn2.valid) {
    const double pixels = std::max(1.0, st_.dark_pattern_dn2.pixels);
    r.covariance(b, b) += std::max(0.0, st_.dark_pattern_dn2.value) / pixels;
    r.parameters[static_cast<std::size_t>(b)].sigma = std::sqrt(r.covariance(b, b));
  }
  // K times the full well is known far better than either: the ridge is curved, and what the covariance
  // leaves out of it (second order, e_K e_W) would be the larger part of its width.
  if (const int w = r.index_of("full_well_e"), g = r.index_of("system_gain_dn_per_e"); w >= 0 && g >= 0)
    r.covariance(w, w) += 3 * r.covariance(w, w) * r.covariance(g, g) / (m.p[kGain] * m.p[kGain]);
  if (const int w = r.index_of("full_well_e"); w >= 0 && m.two_gains) {
    // Somewhere between two levels the gain changes.
    r.covariance(w, w) += std::pow((1 / m.p[kGain] - 1 / m.upper[0]) * m.break_sigma_dn, 2);
    r.parameters[static_cast<std::size_t>(w)].sigma = std::sqrt(r.covariance(w, w));
  }
  curve(m);
  say_not_identifiable(m);
  // What was held, or says nothing, is not a parameter of the result.
  const auto drop = [&](const std::string& name) {
    for (const auto& [n, why] : r.not_identifiable)
      if (n == name) return true;
    return name == "variance_offset_dn2" && plan_.dark_level;
  };
  std::vector<Eigen::Index> kept;
  std::vector<Parameter> parameters;
  for (std::size_t i = 0; i < r.parameters.size(); ++i)
    if (!r.parameters[i].held && !drop(r.parameters[i].name)) {
      kept.push_back(static_cast<Eigen::Index>(i));
      parameters.push_back(r.parameters[i]);
    }
  r.parameters = std::move(parameters);
  r.covariance = r.covariance(kept, kept).eval();
  hot_pixels(m);
  stripes(m);
  if (m.two_gains)
    r.warnings.push_back(photon_text(
        "the gain changes at %.5g DN above black: %.4g DN/e below, %.4g above. The simulator's model has one "
        "gain: the sensor model gets that below",
        m.break_dn, m.p[kGain], m.upper[0]));
  r.warnings.insert(r.warnings.end(), st_.warnings.begin(), st_.warnings.end());
  double s0 = 1e300, s1 = 0, t0 = 1e300, t1 = 0;
  for (std::size_t k = 0; k < st_.points.size(); ++k) {
    if (!out_.in_range[k]) continue;
    s0 = std::min(s0, st_.points[k].mean_dn - m.p[kBlack]);
    s1 = std::max(s1, st_.points[k].mean_dn - m.p[kBlack]);
    t0 = std::min(t0, level(k).settings.exposure_s), t1 = std::max(t1, level(k).settings.exposure_s);
  }
  r.validity = {{"signal_dn", s0, s1}, {"exposure_s", t0, t1}};
}

void PhotonProblem::say_not_identifiable(const PhotonModel& m) {
  FitResult& r = out_.result;
  const auto say = [&](const char* name, const std::string& why) {
    r.not_identifiable.emplace_back(name, why);
  };
  bool darks = false, dark_clipped = false, dark_single = false, white = false;
  for (const LevelPoint& p : st_.points) {
    const bool light = stacks_.levels()[p.level].settings.light;
    darks = darks || !light;
    if (!light && p.why == "clipped at black") dark_clipped = true;
    if (!light && p.frames < 2) dark_single = true;
    white = white || (light && p.why == "saturated");
  }
  const double gain = m.p[kGain];
  if (!plan_.light)
    say("system_gain_dn_per_e",
        "it needs levels of light between black and saturation, of two frames each, there is none");
  std::string no_dark;
  if (!plan_.dark_level)
    no_dark = !darks ? "there are no dark frames"
              : dark_clipped
                  ? "the dark frames are clipped at black: their noise and their level are cut off; raise "
                    "the camera's black level"
              : dark_single ? "it takes two dark frames of the same exposure"
                            : "no dark level can be used";
  if (!plan_.dark_level) {
    say("black_level_dn", no_dark);
    say("read_noise_e", no_dark);
    say("dark_current_e_per_s", no_dark);
    say("dsnu_e", no_dark);
  } else if (plan_.light) {
    const Parameter* read = r.find("read_noise_e");
    double least = 1e300;
    for (const std::size_t k : of(false)) least = std::min(least, st_.points[k].variance_dn2);
    if (least < kNoNoise_dn2)
      say("read_noise_e",
          photon_text("the dark frames hardly change (variance %.2g DN²): their noise lies below "
                      "the converter's step",
                      least));
    else if (read && read->value < 6 * read->sigma)
      say("read_noise_e", photon_text("it is below %.3g e (95 %%), and not told from 0",
                                      std::sqrt(read->value * read->value + 4 * read->value * read->sigma)));
    if (!plan_.dark_current)
      say("dark_current_e_per_s",
          "all dark frames have one exposure time: take them at two times or more, the longest of seconds. "
          "Until then "
          "black level and read noise hold its share");
    else if (const Parameter* d = r.find("dark_current_e_per_s"); d && d->value < 3 * d->sigma)
      say("dark_current_e_per_s",
          d->value < -3 * d->sigma
              ? "the dark level falls with the exposure time: the camera takes it out by itself"
              : photon_text("it is below %.3g e/s (95 %%), and not told from 0: take longer dark exposures",
                            std::max(0.0, d->value) + 1.645 * d->sigma));
    if (plan_.dsnu_rounded)
      say("dsnu_e",
          "the noise is below the converter's step, whose rounding shapes the pattern: take more bits, or "
          "gain");
    else if (!plan_.dsnu)
      say("dsnu_e",
          photon_text(
              "the dark frames differ from pixel to pixel by no more than their noise (below %.3g e): "
              "average "
              "more of them",
              std::sqrt(std::max(0.0, st_.dark_pattern_dn2.value) + 2 * st_.dark_pattern_dn2.sigma) / gain));
    if (const Parameter* d = r.find("dark_doubling_k"); plan_.doubling && d && !(d->sigma < 0.3 * d->value))
      say("dark_doubling_k",
          "the dark current is not seen well enough at two temperatures: take longer dark exposures");
    if (plan_.dark_current && !plan_.doubling)
      say("dark_doubling_k", "all dark frames are of one temperature, or of none that is known");
  } else {
    say("read_noise_e", "without light there is no gain that leads to electrons");
    say("dark_current_e_per_s", "without light there is no gain that leads to electrons");
    say("dsnu_e", "without light there is no gain that leads to electrons");
  }
  if (!plan_.prnu) {
    if (!plan_.light || !plan_.dark_level)
      say("prnu", plan_.light ? no_dark : "there are no usable levels of light");
    else
      say("prnu",
          photon_text(
              "the bright frames differ from pixel to pixel by no more than their noise (below %.2g %%): "
              "average more of them",
              100 * std::sqrt(std::max(0.0, st_.light_pattern.value) + 2 * st_.light_pattern.sigma)));
  }
  if (!plan_.full_well)
    say("full_well_e",
        out_.converter_saturates
            ? photon_text("the converter is full first, at %.5g DN: it is at least %.4g e",
                          double(st_.max_dn), (st_.max_dn - m.p[kBlack]) / gain)
        : out_.saturation_signal_dn
            ? photon_text(
                  "the variance peaks near %.5g DN above black (%.4g e), but no level has all pixels full",
                  *out_.saturation_signal_dn, *out_.saturation_signal_dn / gain)
            : "no level is saturated: go on with longer exposures");
}

/// Rows and columns of the fixed patterns, where they are there beyond chance. In electrons, and relative.
void PhotonProblem::stripes(const PhotonModel& m) {
  FitResult& r = out_.result;
  for (const bool light : {false, true}) {
    const PatternSplit& s = light ? st_.light_split : st_.dark_split_dn2;
    if (!s.pixel.valid || !(light ? plan_.prnu : plan_.dsnu)) continue;
    const double unit = light ? 1 : 1 / m.p[kGain];
    std::string found;
    for (const bool row : {true, false}) {
      const PatternVariance& v = row ? s.row : s.column;
      if (!v.valid || !(v.value > 4 * v.sigma)) continue;
      const double value = std::sqrt(v.value) * unit, sigma = 0.5 * v.sigma / v.value * value;
      const auto n = static_cast<Eigen::Index>(r.parameters.size());
      Eigen::MatrixXd c = Eigen::MatrixXd::Zero(n + 1, n + 1);
      c.topLeftCorner(n, n) = r.covariance;
      c(n, n) = sigma * sigma;
      r.covariance = c;
      r.parameters.push_back(
          {std::string(light ? "prnu_" : "dsnu_") + (row ? "row" : "column") + (light ? "" : "_e"), value,
           sigma, 0.5 * value});
      found += (found.empty() ? "" : " and ") + std::string(row ? "rows" : "columns");
    }
    if (!found.empty())
      r.warnings.push_back(photon_text(light ? "the gain pattern is striped: %.2g %% of pixels apart from "
                                             : "the offset pattern is striped: %.3g e of pixels apart from ",
                                       std::sqrt(std::max(0.0, s.pixel.value)) * (light ? 100 : unit)) +
                           found + "; the simulator's pattern is of pixels alone");
  }
}

/// Excess dark current of hot pixels: an exponential distribution above the limit at which they are found,
/// those that are full censored. Its share below the limit is in the mean of the others: taken out.
void PhotonProblem::hot_pixels(const PhotonModel& m) {
  FitResult& r = out_.result;
  const OutlierPixels& o = st_.outliers;
  const int g = r.index_of("system_gain_dn_per_e"), d = r.index_of("dark_current_e_per_s");
  if (!plan_.dark_current || d < 0) return;
  const double n = static_cast<double>(o.hot_dn_per_s.size()), seen = n - static_cast<double>(o.hot_full);
  const double all = static_cast<double>(o.bad.size());
  if (seen < 10) {
    r.not_identifiable.emplace_back(
        "hot_pixel_share", photon_text("%.0f hot pixels are too few to tell how many and how hot", n));
    return;
  }
  double sum = 0;
  for (const double x : o.hot_dn_per_s) sum += x - o.hot_limit_dn_per_s;
  const double gain = m.p[kGain], limit = o.hot_limit_dn_per_s, h = sum / seen;
  const double share = std::min(1.0, n / all * std::exp(limit / h));
  const double var_h = h * h / seen,
               var_share = share * share / n + std::pow(share * limit / (h * h), 2) * var_h;
  const double hidden = h - (limit + h) * std::exp(-limit / h);
  r.parameters[static_cast<std::size_t>(d)].value -= share * hidden / gain;
  const auto p = static_cast<Eigen::Index>(r.parameters.size());
  Eigen::MatrixXd c = Eigen::MatrixXd::Zero(p + 2, p + 2);
  c.topLeftCorner(p, p) = r.covariance;
  const double hidden_sigma = share * hidden / gain * std::sqrt(1 / n + 1 / seen);
  c(d, d) += hidden_sigma * hidden_sigma;
  c(p, p) = var_share;
  const double to_gain = -h / (gain * gain);
  c.row(p + 1).head(p) = to_gain * r.covariance.row(g);
  c.col(p + 1).head(p) = c.row(p + 1).head(p).transpose();
  c(p + 1, p + 1) = var_h / (gain * gain) + to_gain * to_gain * r.covariance(g, g);
  c(p, p + 1) = c(p + 1, p) = -share * limit / (h * h) * var_h / gain;
  r.parameters[static_cast<std::size_t>(d)].sigma = std::sqrt(c(d, d));
  r.parameters.push_back({"hot_pixel_share", share, std::sqrt(var_share), 0.5 * share});
  r.parameters.push_back({"hot_pixel_dark_e_per_s", h / gain, std::sqrt(c(p + 1, p + 1)), 0.5 * h / gain});
  r.covariance = c;
}

void PhotonProblem::curve(const PhotonModel& m) {
  double top = 0;
  for (std::size_t k = 0; k < st_.points.size(); ++k)
    if (st_.points[k].usable) top = std::max(top, st_.points[k].mean_dn - m.p[kBlack]);
  const auto& c = out_.result.covariance;
  const int g = out_.result.index_of("system_gain_dn_per_e"), s = out_.result.index_of("read_noise_e"),
            o = out_.result.index_of("variance_offset_dn2");
  for (int i = 0; i <= 100; ++i) {
    const double x = top * i / 100, k = m.p[kGain], read = m.p[kRead];
    const PhotonResponse& response = out_.response;
    const double before = response.terms > 0 ? response.inverse(x) : x;
    const double slope = response.terms > 0 ? response.slope(before) : 1;
    double v = slope * slope * (m.p[kOffset] + k * k * read * read + k * before);
    if (m.two_gains && x > m.break_dn) v = m.upper[1] + m.upper[0] * (x - m.break_dn);
    double mean, rounded;
    rounded_moments(m.p[kBlack] + x, v, 10, mean, rounded);
    Eigen::Vector3d j(x + 2 * k * read * read, 2 * k * k * read, 1);
    Eigen::Matrix3d part = Eigen::Matrix3d::Zero();
    const int at[3] = {g, s, o};
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b)
        if (at[a] >= 0 && at[b] >= 0) part(a, b) = c(at[a], at[b]);
    out_.curve_signal_dn.push_back(x);
    out_.curve_variance_dn2.push_back(rounded);
    out_.curve_sigma_dn2.push_back(std::sqrt(std::max(0.0, j.dot(part * j))));
  }
}

}  // namespace rigor::calibration
