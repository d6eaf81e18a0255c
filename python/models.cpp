// The error models as functions of arrays, with derivatives: the formulas that simulators, shaders and
// calibrations share (sensor-hal/models), over double and over numbers with derivatives.
#include <ceres/jet.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <array>

#include "python/errors.h"
#include "python/module.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/lidar/lidar_math.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/tof/tof_math.h"
#include "sensor-hal/models/tof/tof_yaml.h"

namespace rigor::python {
namespace {

using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

/// A function of N numbers that gives M, element by element.
///
/// `f(in, out)` over any number type. The functions of Python take a list of N arrays of one size and give an
/// array (M, n) or, with derivatives, that and one of (M, N, n): d out_i / d in_j.
template <int N, int M, class F>
void add_function(py::module_& m, py::dict& about, const char* name, std::vector<std::string> in_names,
                  std::vector<std::string> out_names, F f) {
  about[name] = py::make_tuple(in_names, out_names);
  m.def(name, [f](const std::vector<Array>& in, bool derivatives) -> py::object {
    if (in.size() != N) throw std::invalid_argument("expected " + std::to_string(N) + " arrays");
    const py::ssize_t n = in[0].size();
    std::array<const double*, N> at{};
    for (int i = 0; i < N; ++i) {
      if (in[i].size() != n) throw std::invalid_argument("expected arrays of one size");
      at[i] = in[i].data();
    }
    py::array_t<double> out(std::vector<py::ssize_t>{M, n});
    double* values = out.mutable_data();
    if (!derivatives) {
      const py::gil_scoped_release without_gil;
      for (py::ssize_t k = 0; k < n; ++k) {
        double x[N], y[M];
        for (int i = 0; i < N; ++i) x[i] = at[i][k];
        f(x, y);
        for (int i = 0; i < M; ++i) values[i * n + k] = y[i];
      }
      return out;
    }
    py::array_t<double> by(std::vector<py::ssize_t>{M, N, n});
    double* slopes = by.mutable_data();
    {
      const py::gil_scoped_release without_gil;
      using Jet = ceres::Jet<double, N>;
      for (py::ssize_t k = 0; k < n; ++k) {
        Jet x[N], y[M];
        for (int i = 0; i < N; ++i) x[i] = Jet(at[i][k], i);
        f(x, y);
        for (int i = 0; i < M; ++i) {
          values[i * n + k] = y[i].a;
          for (int j = 0; j < N; ++j) slopes[(i * N + j) * n + k] = y[i].v[j];
        }
      }
    }
    return py::make_tuple(std::move(out), std::move(by));
  });
}

#define MODEL(...)                               \
  [](const auto* x, auto* y) {                   \
    using T = std::remove_cvref_t<decltype(*y)>; \
    __VA_ARGS__                                  \
  }

void add_lens(py::module_& m, py::dict& about) {
  const std::vector<std::string> k{"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"};
  const auto with = [](std::vector<std::string> names, const std::vector<std::string>& more) {
    names.insert(names.end(), more.begin(), more.end());
    return names;
  };
  add_function<10, 2>(m, about, "lens_distort", with({"x", "y"}, k), {"x", "y"}, MODEL({
                        models::LensMath<T>::lens_distort(x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7],
                                                          x[8], x[9], y[0], y[1]);
                      }));
  add_function<10, 3>(m, about, "lens_undistort", with({"x", "y"}, k), {"x", "y", "valid"}, MODEL({
                        models::LensMath<T>::lens_undistort(x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7],
                                                            x[8], x[9], T(1e-13), y[0], y[1], y[2]);
                      }));
  add_function<8, 3>(m, about, "fisheye_project", {"x", "y", "z", "k1", "k2", "k3", "k4", "theta_max"},
                     {"x", "y", "valid"}, MODEL({
                       models::LensMath<T>::fisheye_project(x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7],
                                                            y[0], y[1], y[2]);
                     }));
  add_function<7, 4>(m, about, "fisheye_unproject", {"x", "y", "k1", "k2", "k3", "k4", "theta_max"},
                     {"x", "y", "z", "valid"}, MODEL({
                       models::LensMath<T>::fisheye_unproject(x[0], x[1], x[2], x[3], x[4], x[5], x[6],
                                                              T(1e-15), y[0], y[1], y[2], y[3]);
                     }));
}

void add_camera_noise(py::module_& m, py::dict& about) {
  add_function<4, 1>(m, about, "emva_mean_electrons",
                     {"rate_e_per_s", "dark_e_per_s", "gain_pattern", "exposure_s"}, {"mean_e"},
                     MODEL({ y[0] = models::NoiseMath<T>::emva_mean_electrons(x[0], x[1], x[2], x[3]); }));
  add_function<2, 1>(m, about, "poisson_quantile", {"mean", "u"}, {"count"},
                     MODEL({ y[0] = models::NoiseMath<T>::poisson_quantile(x[0], x[1]); }));
  add_function<1, 1>(m, about, "normal_quantile", {"u"}, {"z"},
                     MODEL({ y[0] = models::NoiseMath<T>::normal_quantile(x[0]); }));
  add_function<5, 1>(
      m, about, "emva_collected_electrons",
      {"shot_e", "full_well_e", "offset_pattern_e", "read_noise_e", "read_draw"}, {"electrons"},
      MODEL({ y[0] = models::NoiseMath<T>::emva_collected_electrons(x[0], x[1], x[2], x[3], x[4]); }));
  add_function<6, 1>(m, about, "emva_signal_dn",
                     {"electrons", "gain_dn_per_e", "black_dn", "full_scale_dn", "c2", "c3"}, {"dn"}, MODEL({
                       using Noise = models::NoiseMath<T>;
                       const T above = Noise::emva_analogue_dn(x[0], x[1], T(0.0));
                       y[0] = x[2] + Noise::emva_response(above, x[3] - x[2], x[4], x[5]);
                     }));
  add_function<2, 1>(m, about, "emva_quantise", {"dn", "max_dn"}, {"dn"},
                     MODEL({ y[0] = models::NoiseMath<T>::emva_quantise(x[0], x[1]); }));
}

void add_lidar(py::module_& m, py::dict& about) {
  add_function<6, 1>(
      m, about, "lidar_surface_remission",
      {"cos_incidence", "reflectance", "metallic", "roughness", "retro", "retro_gain"}, {"remission"},
      MODEL({ y[0] = models::LidarMath<T>::lidar_surface_remission(x[0], x[1], x[2], x[3], x[4], x[5]); }));
  add_function<3, 1>(m, about, "lidar_beam_diameter_m", {"start_diameter_m", "divergence_rad", "range_m"},
                     {"diameter_m"},
                     MODEL({ y[0] = models::LidarMath<T>::lidar_beam_diameter_m(x[0], x[1], x[2]); }));
  add_function<4, 1>(m, about, "lidar_received_power", {"remission", "range_m", "reference_m", "overlap_m"},
                     {"power"},
                     MODEL({ y[0] = models::LidarMath<T>::lidar_received_power(x[0], x[1], x[2], x[3]); }));
  add_function<5, 1>(
      m, about, "lidar_least_remission",
      {"range_m", "minimum_remission", "limit_remission", "limit_range_m", "overlap_m"}, {"remission"},
      MODEL({ y[0] = models::LidarMath<T>::lidar_least_remission(x[0], x[1], x[2], x[3], x[4]); }));
  add_function<7, 1>(
      m, about, "lidar_range_error_m",
      {"range_m", "scale", "bias_m", "remission_bias_m", "remission", "incidence_bias_m", "cos_incidence"},
      {"error_m"},
      MODEL({ y[0] = models::LidarMath<T>::lidar_range_error_m(x[0], x[1], x[2], x[3], x[4], x[5], x[6]); }));
  add_function<5, 1>(
      m, about, "lidar_range_sigma_m", {"q", "floor_m", "scale_m", "offset", "exponent"}, {"sigma_m"},
      MODEL({ y[0] = models::LidarMath<T>::lidar_range_sigma_m(x[0], x[1], x[2], x[3], x[4]); }));
  add_function<6, 1>(
      m, about, "lidar_remission_units",
      {"remission", "range_m", "scale", "retro_scale", "reference_m", "range_exponent"}, {"units"},
      MODEL({ y[0] = models::LidarMath<T>::lidar_remission_units(x[0], x[1], x[2], x[3], x[4], x[5]); }));
  add_function<2, 1>(m, about, "lidar_quantise", {"value", "step"}, {"value"},
                     MODEL({ y[0] = models::LidarMath<T>::lidar_quantise(x[0], x[1]); }));
}

void add_tof(py::module_& m, py::dict& about) {
  add_function<4, 1>(m, about, "tof_active_electrons",
                     {"electrons_per_radiance", "intensity_w_per_sr", "range_m", "remission"}, {"electrons"},
                     MODEL({ y[0] = models::TofMath<T>::tof_active_electrons(x[0], x[1], x[2], x[3]); }));
  add_function<8, 2>(
      m, about, "tof_phasor", {"turns", "triangle", "a3", "a5", "a7", "a9", "bias", "variation"}, {"x", "y"},
      MODEL({ models::TofMath<T>::tof_phasor(x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], y[0], y[1]); }));
  add_function<5, 4>(m, about, "tof_taps", {"active_e", "sum_x_e", "sum_y_e", "contrast", "background_e"},
                     {"d0", "d1", "d2", "d3"}, MODEL({
                       models::TofMath<T>::tof_taps(x[0], x[1], x[2], x[3], x[4], y[0], y[1], y[2], y[3]);
                     }));
  add_function<6, 2>(m, about, "tof_read_tap",
                     {"arrived_e", "drained_e", "full_well_e", "read_noise_e", "read_draw", "step_e"},
                     {"electrons", "saturated"}, MODEL({
                       y[0] = models::TofMath<T>::tof_read_tap(x[0], x[1], x[2], x[3], x[4], x[5], y[1]);
                     }));
  add_function<4, 2>(m, about, "tof_demodulate", {"d0", "d1", "d2", "d3"}, {"turns", "amplitude_e"},
                     MODEL({ models::TofMath<T>::tof_demodulate(x[0], x[1], x[2], x[3], y[0], y[1]); }));
  add_function<3, 1>(m, about, "tof_nearest_range", {"turns", "turns_per_m", "about_m"}, {"range_m"},
                     MODEL({ y[0] = models::TofMath<T>::tof_nearest_range(x[0], x[1], x[2]); }));
  add_function<5, 1>(m, about, "tof_range_sigma",
                     {"turns_per_m", "signal_e", "background_e", "read_noise_e", "contrast"}, {"sigma_m"},
                     MODEL({ y[0] = models::TofMath<T>::tof_range_sigma(x[0], x[1], x[2], x[3], x[4]); }));
  add_function<3, 1>(m, about, "tof_range_error", {"offset_m", "amplitude_error_m_e", "amplitude_e"},
                     {"error_m"}, MODEL({ y[0] = models::TofMath<T>::tof_range_error(x[0], x[1], x[2]); }));
}

#undef MODEL

py::dict camera_values(const std::string& file, std::uint64_t draw) {
  const CameraSensorModel sensor_model = value_of(load_camera(file, draw));
  const CameraModel& c = sensor_model.model;
  py::dict d;
  d["width_px"] = c.width_px, d["height_px"] = c.height_px;
  d["fx_px"] = c.fx_px, d["fy_px"] = c.fy_px, d["cx_px"] = c.cx_px, d["cy_px"] = c.cy_px;
  const bool fisheye = c.projection == Projection::kannala_brandt;
  d["projection"] = fisheye ? "kannala_brandt" : "opencv";
  d["lens"] = fisheye ? std::vector<double>{c.fisheye.k1, c.fisheye.k2, c.fisheye.k3, c.fisheye.k4}
                      : std::vector<double>{c.lens.k1, c.lens.k2, c.lens.p1, c.lens.p2,
                                            c.lens.k3, c.lens.k4, c.lens.k5, c.lens.k6};
  d["theta_max_rad"] = fisheye ? fisheye_theta_max_rad(c.fisheye) : 0.0;
  d["exposure_s"] = sensor_model.exposure_s;
  d["gain_dn_per_e"] = c.system_gain_dn_per_e();
  d["black_dn"] = c.noise.black_level_dn;
  d["full_well_e"] = c.noise.full_well_e;
  d["read_noise_e"] = c.noise.read_noise_e;
  d["dark_e_per_s"] = c.noise.dark_current_at_temperature_e_per_s();
  d["dsnu_e"] = c.noise.dsnu_e, d["prnu"] = c.noise.prnu;
  d["adc_bits"] = c.noise.adc_bits;
  d["response"] = std::vector<double>{c.noise.response_c2, c.noise.response_c3};
  d["shot_noise"] = c.noise.shot_noise;
  return d;
}

py::dict lidar_values(const std::string& file, std::uint64_t draw) {
  const models::LidarModel l = value_of(load_lidar_model(file, draw));
  py::dict d;
  d["wavelength_nm"] = l.wavelength_nm;
  d["beams"] = l.scan.beams.size(), d["columns"] = l.scan.columns;
  d["column_period_s"] = l.scan.column_period_s;
  d["divergence_rad"] =
      std::vector<double>{l.footprint.horizontal_divergence_rad, l.footprint.vertical_divergence_rad};
  d["start_diameter_m"] = l.footprint.start_diameter_m;
  d["min_m"] = l.range.min_m, d["max_m"] = l.range.max_m, d["step_m"] = l.range.step_m;
  d["bias_m"] = l.range.bias_m, d["scale"] = l.range.scale;
  d["remission_bias_m"] = l.range.remission_bias_m, d["incidence_bias_m"] = l.range.incidence_bias_m;
  std::vector<double> beam_bias, beam_gain, elevation;
  for (const models::LidarBeam& b : l.scan.beams)
    beam_bias.push_back(b.range_bias_m), beam_gain.push_back(b.remission_gain),
        elevation.push_back(b.elevation_rad);
  d["beam_bias_m"] = beam_bias, d["beam_gain"] = beam_gain, d["elevation_rad"] = elevation;
  d["floor_m"] = l.noise.floor_m, d["scale_m"] = l.noise.scale_m, d["offset"] = l.noise.offset;
  d["exponent"] = l.noise.exponent, d["reference_range_m"] = l.noise.reference_range_m;
  d["retro_sigma_m"] = l.noise.retro_sigma_m;
  d["minimum_remission"] = l.detection.minimum_remission, d["limit_remission"] = l.detection.limit_remission;
  d["limit_range_m"] = l.detection.limit_range_m, d["overlap_m"] = l.detection.overlap_m;
  d["remission_scale"] = l.remission.scale, d["remission_noise"] = l.remission.noise;
  d["retro_scale"] = l.remission.retro_scale, d["range_exponent"] = l.remission.range_exponent;
  d["remission_reference_m"] = l.remission.reference_range_m;
  d["remission_maximum"] = l.remission.maximum, d["remission_step"] = l.remission.step;
  return d;
}

py::dict tof_values(const std::string& file, std::uint64_t draw) {
  const models::TofModel t = value_of(load_tof_model(file, draw));
  py::dict d;
  d["width_px"] = t.width_px, d["height_px"] = t.height_px;
  d["fx_px"] = t.fx_px, d["fy_px"] = t.fy_px, d["cx_px"] = t.cx_px, d["cy_px"] = t.cy_px;
  d["lens"] = std::vector<double>{t.lens.k1, t.lens.k2, t.lens.p1, t.lens.p2,
                                  t.lens.k3, t.lens.k4, t.lens.k5, t.lens.k6};
  d["frequencies_hz"] = t.modulation.frequencies_hz;
  d["contrast"] = t.modulation.contrast;
  const auto waveform = t.modulation.waveform;
  d["triangle"] = waveform == models::TofWaveform::triangle;
  d["harmonics"] = waveform == models::TofWaveform::harmonics
                       ? std::vector<double>(t.modulation.harmonics.begin(), t.modulation.harmonics.end())
                       : std::vector<double>(4, 0.0);
  d["wiggling_bias"] = t.modulation.wiggling_bias, d["sine_like_noise"] = t.modulation.sine_like_noise;
  d["intensity_w_per_sr"] = t.illumination.radiant_intensity_w_per_sr;
  d["electrons_per_radiance"] = t.electrons_per_radiance();
  d["unambiguous_range_m"] = t.unambiguous_range_m();
  d["full_well_e"] = t.pixel.full_well_e, d["read_noise_e"] = t.pixel.read_noise_e;
  d["dark_e"] = t.pixel.dark_current_e_per_s * t.modulation.integration_time_s;
  d["step_e"] = t.pixel.adc_bits > 0 ? t.pixel.full_well_e / (std::exp2(t.pixel.adc_bits) - 1) : 0.0;
  d["ambient_suppression"] = t.pixel.ambient_suppression;
  d["offset_m"] = t.range_error.offset_m, d["amplitude_error_m_e"] = t.range_error.amplitude_error_m_e;
  return d;
}

}  // namespace

void add_models(py::module_& m) {
  py::module_ f = m.def_submodule("models");
  py::dict about;
  add_lens(f, about);
  add_camera_noise(f, about);
  add_lidar(f, about);
  add_tof(f, about);
  f.attr("functions") = about;  // name -> (names of what it takes, names of what it gives)
  m.def("load_camera", &camera_values);
  m.def("load_lidar", &lidar_values);
  m.def("load_tof", &tof_values);
}

}  // namespace rigor::python
