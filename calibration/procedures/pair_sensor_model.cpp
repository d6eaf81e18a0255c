#include "calibration/procedures/pair_sensor_model.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "sensor-hal/models/imu/imu_yaml.h"
#include "sensor-hal/models/lidar/lidar_math.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"

namespace rigor {

using namespace calibration;

PairProposal::PairProposal(const FitResult& change) : more(nlohmann::json::object()), change_(change) {
  out_ = change;
  out_.parameters.clear(), out_.covariance.resize(0, 0);
  // How it came about, in numbers of its own.
  more["change"] = nlohmann::json::object();
  for (const Parameter& p : change.parameters)
    more["change"][p.name] = {{"value", p.value}, {"sigma", p.sigma}};
}

void PairProposal::estimate(const std::string& name, double value, double sigma) {
  const Eigen::Index n = change_.covariance.rows();
  Eigen::MatrixXd c = Eigen::MatrixXd::Zero(n + 1, n + 1);
  c.topLeftCorner(n, n) = change_.covariance;
  c(n, n) = sigma * sigma;
  change_.covariance = c;
  change_.parameters.push_back({.name = name, .value = value, .sigma = sigma});
  more["change"][name] = {{"value", value}, {"sigma", sigma}};
  for (Eigen::VectorXd& row : rows_) row.conservativeResizeLike(Eigen::VectorXd::Zero(n + 1));
}

void PairProposal::add(const std::string& name, double value, const std::vector<Term>& terms,
                       const std::string& path, double scale, bool at_bound) {
  Eigen::VectorXd row = Eigen::VectorXd::Zero(change_.covariance.rows());
  for (const Term& t : terms) {
    const int at = change_.index_of(t.change);
    if (at < 0) return;
    row[at] = t.derivative;
  }
  const double variance = row.dot(change_.covariance * row);
  out_.parameters.push_back(
      {.name = name, .value = value, .sigma = std::sqrt(variance), .at_bound = at_bound});
  rows_.push_back(row);
  if (path.empty()) return;
  recipe_.set.emplace_back(path, exact_text(value * scale));
  recipe_.places.push_back({name, path, scale});
}

const Parameter* PairProposal::change(const std::string& name) const { return change_.find(name); }

bool PairProposal::changed(const std::string& name, double sigmas) const {
  const Parameter* p = change(name);
  return p && std::abs(p->value) > sigmas * p->sigma;
}

void PairProposal::mount(const RecordedPair& pair, const Eigen::Matrix3d& R, const Eigen::Vector3d& t) {
  static constexpr std::array<const char*, 6> kNames{"mount_x_rad",    "mount_y_rad",    "mount_z_rad",
                                                     "mount_move_x_m", "mount_move_y_m", "mount_move_z_m"};
  bool any = false;
  nlohmann::json sigmas = nlohmann::json::object();
  for (const char* name : kNames) {
    const Parameter* p = change(name);
    if (!p) continue;
    any = any || changed(name);
    sigmas[name] = p->sigma;
    add(name, p->value, {{name}});
  }
  if (sigmas.empty()) return;
  nlohmann::json& m = more["mount"] = {{"changed", any}, {"sigma", sigmas}};
  if (pair.mount_key.empty()) return;
  Eigen::Isometry3d change = Eigen::Isometry3d::Identity();
  change.linear() = R, change.translation() = t;
  const Eigen::Isometry3d proposed = pair.T_parent_sensor * change;
  Eigen::Quaterniond q(proposed.linear());
  if (q.w() < 0) q.coeffs() = -q.coeffs();
  const Eigen::Vector3d p = proposed.translation();
  // To a micrometre and a nanoradian: what a person copies, and finer than any mount is known.
  const auto metres = [](double x) { return exact_text(std::round(x * 1e6) / 1e6); };
  const auto turn = [](double x) { return exact_text(std::round(x * 1e9) / 1e9); };
  const std::string yaml =
      fmt::format("{{ position_m: [{}, {}, {}], quaternion_wxyz: [{}, {}, {}, {}]{} }}", metres(p.x()),
                  metres(p.y()), metres(p.z()), turn(q.w()), turn(q.x()), turn(q.y()), turn(q.z()),
                  pair.above_ground ? ", above_ground: true" : "");
  const std::string key = fmt::format("channels.{}.pair.simulated.{}", pair.channel, pair.mount_key);
  m["key"] = key;
  m["position_m"] = {p.x(), p.y(), p.z()};
  m["quaternion_wxyz"] = {q.w(), q.x(), q.y(), q.z()};
  m["value"] = yaml;
  if (!any) {
    say("The mount has not changed: no turn or move is beyond three of its sigmas.");
    return;
  }
  std::string words;
  for (const char* name : kNames)
    if (const Parameter* c = change_.find(name)) {
      const bool angle = std::string_view(name).ends_with("_rad");
      const double unit = angle ? 180 / std::numbers::pi : 1e3;
      const double sigma = c->sigma * unit;  // told with two digits, and the value with as many places
      const int places = std::isfinite(sigma) && sigma > 0
                             ? std::clamp(1 - static_cast<int>(std::floor(std::log10(sigma))), 0, 9)
                             : 4;
      words += fmt::format("{}{} {:+.{}f} ± {:.{}f} {}", words.empty() ? "" : ", ",
                           std::string_view(name).substr(6, angle ? 1 : 6), c->value * unit, places, sigma,
                           places, angle ? "°" : "mm");
    }
  for (char& c : words)
    if (c == '_') c = ' ';
  say(fmt::format("The mount has changed, about and along the sensor's own axes: {}. In the rig: {}: {}",
                  words, key, yaml));
}

FitResult PairProposal::result() const {
  FitResult f = out_;
  f.not_identifiable = change_.not_identifiable;
  f.warnings = change_.warnings;
  f.weak = change_.weak;
  const auto n = Eigen::Index(rows_.size());
  Eigen::MatrixXd l(n, change_.covariance.rows());
  for (Eigen::Index i = 0; i < n; ++i) l.row(i) = rows_[std::size_t(i)];
  f.covariance = l * change_.covariance * l.transpose();
  return f;
}

Result<PairProposal> propose_camera(const RecordedPair& pair, const ImagePairFit& fit,
                                    const CameraModel& simulated) {
  PairProposal p(fit.change);
  const CameraModel& c = fit.camera;
  const bool fisheye = c.projection == Projection::kannala_brandt;
  p.add("fx_px", c.fx_px, {{"focal_length", simulated.fx_px}}, "intrinsics.fx_px");
  p.add("fy_px", c.fy_px, {{"focal_length", simulated.fy_px}}, "intrinsics.fy_px");
  p.add("cx_px", c.cx_px, {{"cx_px"}}, "intrinsics.cx_px");
  p.add("cy_px", c.cy_px, {{"cy_px"}}, "intrinsics.cy_px");
  p.add("k1", fisheye ? c.fisheye.k1 : c.lens.k1, {{"k1"}}, fisheye ? "fisheye.k1" : "lens.k1");
  p.add("a2", c.vignetting.a2, {{"a2"}}, "vignetting.a2");
  const EmvaNoise& n = simulated.noise;
  const ImageProcessing& processing = simulated.processing;
  const bool raw = processing.gamma == 1 && !processing.median_filter && !processing.demosaic;
  if (!raw || !n.linear()) {
    p.leave_open("noise",
                 "the camera's own processing (gamma, median, demosaicing) or its bent response stand "
                 "between light and numbers; record a raw format");
    if (p.changed("gain"))
      p.leave_open("gain",
                   fmt::format("the pictures are {:.4g} times as bright, which gamma or a bent response "
                               "does not let tell as a gain of the sensor model",
                               fit.gain));
  } else {
    if (!processing.subtract_black) {
      const double black = n.black_level_dn + fit.offset_dn / fit.format_scale;
      if (p.change("offset_dn"))
        p.add("black_level_dn", std::max(0.0, black), {{"offset_dn", 1 / fit.format_scale}},
              "noise.black_level_dn", 1, black < 0);
    } else if (p.changed("offset_dn")) {
      p.leave_open("offset",
                   "the camera takes its black level off by itself: its sensor model has no key for another");
    }
    const Parameter* gain = p.change("gain");
    const ImageNoiseFit noise = fit_image_noise(fit, simulated, gain ? gain->sigma : 1);
    const double k = simulated.system_gain_dn_per_e();
    if (noise.levels < 2) {
      p.leave_open("noise",
                   "too few places of the pictures are smooth; record surfaces without texture, bright "
                   "and dark ones");
    } else {
      const double sigma = noise.sigma_e * std::sqrt(std::max(1.0, noise.chi2 / (noise.levels - 1)));
      p.estimate("read_noise_e", noise.read_noise_e, sigma);
      p.add("read_noise_e", noise.read_noise_e, {{"read_noise_e"}}, "noise.read_noise_e", 1, noise.at_bound);
      if (noise.chi2 > 4 * noise.levels)
        p.warn(fmt::format(
            "the noise by brightness is not what shot and read noise make of it (chi-squared {:.0f} "
            "of {} levels); `rigor calibrate photon` solves for all of it",
            noise.chi2, noise.levels));
    }
    if (gain && noise.gain != ImageNoiseFit::Gain::none) {
      const double apart = std::abs(noise.chi2_electronics - noise.chi2_light);
      FitResult candidates;
      p.more["gain"] = {{"chi2_electronics", noise.chi2_electronics}, {"chi2_light", noise.chi2_light}};
      if (noise.gain == ImageNoiseFit::Gain::electronics)
        p.add("system_gain_dn_per_e", k * fit.gain, {{"gain", k}}, "noise.system_gain_dn_per_e");
      else if (simulated.optics.transmission * fit.gain <= 1)
        p.add("transmission", simulated.optics.transmission * fit.gain,
              {{"gain", simulated.optics.transmission}}, "optics.transmission");
      else
        p.add("f_number", simulated.optics.f_number / std::sqrt(fit.gain),
              {{"gain", -0.5 * simulated.optics.f_number / std::pow(fit.gain, 1.5)}}, "optics.f_number");
      p.say(fmt::format(
          "Brightness has changed by {:+.2f} %: by its noise this is {} (chi-squared {:.1f} against "
          "{:.1f} the other way{}).",
          100 * (fit.gain - 1),
          noise.gain == ImageNoiseFit::Gain::electronics ? "the gain of the sensor"
                                                         : "the light that reaches it",
          std::min(noise.chi2_electronics, noise.chi2_light),
          std::max(noise.chi2_electronics, noise.chi2_light),
          apart < 9 ? "; the data hardly tell the two apart" : ""));
    } else if (gain) {
      p.add("gain", fit.gain, {{"gain"}});
    }
  }
  p.mount(pair, fit.R_simulated_real, Eigen::Vector3d::Zero());
  for (const auto& tile : fit.tiles)
    if (std::abs(tile.change) > 0.01 && std::abs(tile.change) > 6 * tile.sigma)
      p.warn(fmt::format(
          "{} of 6x4 is {:+.1f} % brighter than the rest says: dirt, or a fall-off that the sensor model "
          "has no key for",
          tile.name, 100 * tile.change));
  if (!fit.change.find("cx_px") && fit.change.find("mount_x_rad"))
    p.leave_open("principal point",
                 "a shift of it looks like a turn of the mount, which is solved for; with "
                 "--model principal-point the mount stays and it is solved for");
  if (!fit.change.find("k1"))
    p.leave_open("lens distortion",
                 "not asked for: --model lens frees k1; all of a lens needs a board "
                 "(`rigor calibrate camera`)");
  return p;
}

double model_sigma_m(const models::LidarModel& m, double remission, double range_m) {
  double e = m.remission.scale > 0 ? remission / m.remission.scale : remission;
  if (m.remission.range_exponent != 0 && m.remission.reference_range_m > 0)
    e *= std::pow(range_m / m.remission.reference_range_m, m.remission.range_exponent);
  using Math = models::LidarMath<double>;
  const double q =
      m.noise.reference_range_m > 0
          ? Math::lidar_received_power(e, range_m, m.noise.reference_range_m, m.detection.overlap_m)
          : e;
  const double sigma = m.noise.scale_m > 0
                           ? Math::lidar_range_sigma_m(std::max(q, 1e-4), m.noise.floor_m, m.noise.scale_m,
                                                       m.noise.offset, m.noise.exponent)
                           : m.noise.floor_m;
  // What rounding adds.
  return std::sqrt(sigma * sigma + m.range.step_m * m.range.step_m / 12);
}

Result<PairProposal> propose_lidar(const RecordedPair& pair, const CloudPairFit& fit) {
  const auto model = load_lidar_model(pair.sensor_model_file);
  if (!model) return tl::unexpected<Error>(model.error());
  PairProposal p(fit.change);
  const models::LidarRange& r = model->range;
  const double s = 1 + fit.scale;
  const bool scaled = p.change("range_scale") != nullptr;
  std::vector<PairProposal::Term> bias{{"range_bias_m"}};
  if (scaled) bias.push_back({"range_scale", r.bias_m});
  p.add("range_bias_m", r.bias_m * s + fit.bias_m, bias, "range.bias_mm", 1e3);
  if (scaled) p.add("range_scale", r.scale * s, {{"range_scale", r.scale}}, "range.scale");
  if (!fit.beam_m.empty()) {
    const auto& beams = model->scan.beams;
    std::string list;
    for (std::size_t i = 0; i < beams.size(); ++i) {
      const std::size_t group = i < fit.beam_of_ring.size() ? fit.beam_of_ring[i] : 0;
      const std::string change = fmt::format("beam_bias_m[{}]", group);
      const double value = beams[i].range_bias_m * s + (p.change(change) ? fit.beam_m[group] : 0);
      list += (i > 0 ? ", " : "") + exact_text(1e3 * value);
      // Of a group of beams the first one's place stands for all.
      if (i == 0 || fit.beam_of_ring[i] != fit.beam_of_ring[i - 1]) {
        p.add(change, value, {{change}});
        if (p.change(change)) p.place(change, fmt::format("beams.bias_mm.{}", i), 1e3);
      }
    }
    p.set("beams.bias_mm", "[" + list + "]");
  }
  if (const Parameter* gain = p.change("remission_gain")) {
    p.add("remission_scale", model->remission.scale * (1 + gain->value),
          {{"remission_gain", model->remission.scale}}, "remission.scale");
    if (model->remission.retro_scale > 0)
      p.add("retro_scale", model->remission.retro_scale * (1 + gain->value),
            {{"remission_gain", model->remission.retro_scale}}, "remission.retro_scale");
  }
  const NoiseFactor noise = noise_factor(fit.noise);
  const models::LidarNoise& n = model->noise;
  if (noise.levels == 0) {
    p.leave_open("noise", "there are too few points in a row on smooth surfaces");
  } else {
    const double sigma = noise.sigma * std::sqrt(std::max(1.0, noise.chi2 / std::max(1, noise.levels - 1)));
    p.estimate("noise_factor", noise.factor, sigma);
    for (const auto& [name, path, value] : {std::tuple{"noise_floor_m", "noise.floor_mm", n.floor_m},
                                            {"noise_scale_m", "noise.scale_mm", n.scale_m},
                                            {"retro_sigma_m", "noise.retro_sigma_mm", n.retro_sigma_m}})
      if (value > 0) p.add(name, value * noise.factor, {{"noise_factor", value}}, path, 1e3);
    if (noise.levels > 1 && noise.chi2 > 4 * (noise.levels - 1))
      p.warn(
          fmt::format("the noise has not changed by one factor at all remissions (chi-squared {:.0f} of {} "
                      "levels); `rigor calibrate lidar` fits the law itself",
                      noise.chi2, noise.levels));
  }
  p.mount(pair, fit.R_simulated_real, fit.t_simulated_real_m);
  p.more["lost"] = fit.lost, p.more["gained"] = fit.gained;
  return p;
}

Result<PairProposal> propose_tof(const RecordedPair& pair, const RangePairFit& fit) {
  const auto model = load_tof_model(pair.sensor_model_file);
  if (!model) return tl::unexpected<Error>(model.error());
  PairProposal p(fit.change);
  p.add("range_offset_m", model->range_error.offset_m + fit.offset_m, {{"range_offset_m"}},
        "range_error.offset_mm", 1e3);
  if (p.change("range_scale"))
    p.leave_open("range scale",
                 fmt::format("ranges are {:+.3f} % longer, for which the sensor model has no key; "
                             "`rigor calibrate tof` fits wiggling",
                             100 * fit.scale));
  const double light = model->illumination.radiant_intensity_w_per_sr;
  p.add("radiant_intensity_w_per_sr", light * fit.amplitude_gain, {{"amplitude_gain", light}},
        "illumination.radiant_intensity_w_per_sr");
  const RangeNoiseFit noise = fit_range_noise(fit, model->modulation.contrast);
  if (!noise.solved) {
    p.leave_open("noise", "there are too few smooth surfaces of different brightness");
  } else {
    const double read = model->pixel.read_noise_e, square = read * read + noise.more_e2;
    const double spread =
        noise.sigma_e2 * std::sqrt(std::max(1.0, noise.chi2 / std::max(1, noise.levels - 1)));
    const double value = std::sqrt(std::max(0.0, square));
    const double sigma = value > 0 ? std::min(spread / (2 * value), std::sqrt(spread)) : std::sqrt(spread);
    p.estimate("read_noise_e", value, sigma);
    p.add("read_noise_e", value, {{"read_noise_e"}}, "pixel.read_noise_e", 1, value == 0);
  }
  p.leave_open("mount",
               "range images of one place do not tell a turn from a change of shape; `rigor calibrate "
               "extrinsics` does, with a board");
  p.more["lost"] = fit.lost, p.more["gained"] = fit.gained;
  return p;
}

Result<PairProposal> propose_values(const RecordedPair& pair, const std::vector<ValueFit>& fits) {
  FitResult change;
  std::vector<std::pair<const ValueFit*, bool>> moving;
  std::size_t size = 0;
  for (const ValueFit& f : fits) {
    const bool moves = std::isfinite(f.scale_sigma);
    moving.emplace_back(&f, moves);
    size += moves ? 3 : 1;
  }
  change.covariance = Eigen::MatrixXd::Zero(Eigen::Index(size), Eigen::Index(size));
  Eigen::Index at = 0;
  for (const auto& [f, moves] : moving) {
    const Eigen::Index n = moves ? 3 : 1;
    change.covariance.block(at, at, n, n) = f->covariance.topLeftCorner(n, n);
    const std::string unit = f->unit.empty() ? "" : " [" + f->unit + "]";
    change.parameters.push_back({.name = f->name + " bias" + unit, .value = f->bias, .sigma = f->bias_sigma});
    if (moves) {
      change.parameters.push_back({.name = f->name + " scale", .value = f->scale, .sigma = f->scale_sigma});
      change.parameters.push_back(
          {.name = f->name + " delay_s", .value = f->delay_s, .sigma = f->delay_sigma_s});
    } else {
      change.not_identifiable.emplace_back(f->name + " scale and delay",
                                           "the number does not move enough; record it in motion");
    }
    at += n;
  }
  PairProposal p(change);
  if (pair.kind != SampleKind::imu || pair.sensor_model_file.empty()) {
    for (const Parameter& c : change.parameters) p.add(c.name, c.value, {{c.name}});
    for (const ValueFit& f : fits)
      if (f.noise_ratio > 0 && std::isfinite(f.noise_ratio)) {
        p.estimate(f.name + " noise_ratio", f.noise_ratio, f.noise_ratio_sigma);
        p.add(f.name + " noise_ratio", f.noise_ratio, {{f.name + " noise_ratio"}});
      } else if (f.noise_real > 0) {
        p.say(fmt::format("{}: the device has noise of {:.3g} {}, the simulated side none.", f.name,
                          f.noise_real, f.unit));
      }
    return p;
  }
  const auto model = load_imu_model(pair.sensor_model_file);
  if (!model) return tl::unexpected<Error>(model.error());
  constexpr double kG = 9.80665, kDegree = std::numbers::pi / 180;
  double delay_weights = 0, delay_sum = 0;
  for (int triad = 0; triad < 2; ++triad) {
    const models::ImuTriad& t = triad == 0 ? model->accelerometer : model->gyroscope;
    const std::string section = triad == 0 ? "accelerometer" : "gyroscope";
    const std::string bias_key = triad == 0 ? "bias_mg" : "bias_deg_per_s";
    const double unit = triad == 0 ? kG * 1e-3 : kDegree;
    std::string biases, scales;
    std::array<double, 3> ratio{1, 1, 1};
    for (std::size_t k = 0; k < 3; ++k) {
      const ValueFit& f = fits[std::size_t(3 * triad) + k];
      const bool moves = std::isfinite(f.scale_sigma);
      const std::string name = f.name + " bias" + (f.unit.empty() ? "" : " [" + f.unit + "]");
      const double bias = (1 + f.scale) * t.bias[k] + f.bias;
      p.add(f.name + "_bias", bias, {{name}});
      p.place(f.name + "_bias", fmt::format("{}.{}.{}", section, bias_key, k), 1 / unit);
      biases += (k > 0 ? ", " : "") + exact_text(bias / unit);
      const double scale = (1 + t.scale[k]) * (1 + f.scale) - 1;
      scales += (k > 0 ? ", " : "") + exact_text(100 * scale);
      if (moves) {
        p.add(f.name + "_scale", scale, {{f.name + " scale", 1 + t.scale[k]}});
        p.place(f.name + "_scale", fmt::format("{}.scale_percent.{}", section, k), 100);
        const double w = 1 / (f.delay_sigma_s * f.delay_sigma_s);
        delay_weights += w, delay_sum += w * f.delay_s;
      }
      if (f.noise_ratio > 0 && std::isfinite(f.noise_ratio)) {
        ratio[k] = f.noise_ratio;
        p.estimate(f.name + "_noise_ratio", f.noise_ratio, f.noise_ratio_sigma);
        p.add(f.name + "_noise_ratio", f.noise_ratio, {{f.name + "_noise_ratio"}});
      }
    }
    p.set(section + "." + bias_key, "[" + biases + "]");
    p.set(section + ".scale_percent", "[" + scales + "]");
    if (t.white != std::array<double, 3>{}) {
      // Under the key that the sensor model has, in its unit.
      auto sensor_model = ConfigDocument::load(pair.sensor_model_file);
      if (!sensor_model) return tl::unexpected<Error>(sensor_model.error());
      const auto list = catch_config([&] {
        const ConfigNode n = sensor_model->map(section);
        for (const char* key : {"noise_density_ug_per_sqrt_hz", "velocity_random_walk_m_per_s_per_sqrt_h",
                                "noise_density_deg_per_s_per_sqrt_hz", "angle_random_walk_deg_per_sqrt_h"})
          if (n.has(key)) return std::pair{std::string(key), n.numbers_or(key, {})};
        return std::pair{std::string(), std::vector<double>{}};
      });
      if (!list) return tl::unexpected<Error>(list.error());
      if (!list->second.empty()) {
        std::string values;
        for (std::size_t k = 0; k < 3; ++k)
          values +=
              (k > 0 ? ", " : "") + exact_text(list->second[list->second.size() == 3 ? k : 0] * ratio[k]);
        p.set(section + "." + list->first, "[" + values + "]");
      }
    }
  }
  if (delay_weights > 0) {
    const double delay = delay_sum / delay_weights;
    p.estimate("delay_s", delay, 1 / std::sqrt(delay_weights));
    const double total = model->delay_s + delay;
    p.add("delay_s", std::max(0.0, total), {{"delay_s"}}, "delay_ms", 1e3, total < 0);
  }
  return p;
}

}  // namespace rigor
