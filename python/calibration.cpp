// Calibrations: options by name, results as plain values.
#include <pybind11/eigen.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <fmt/format.h>

#include <functional>
#include <map>
#include <nlohmann/json.hpp>

#include "calibration/procedures/calibration_report.h"
#include "calibration/procedures/camera_calibration.h"
#include "calibration/procedures/delay_calibration.h"
#include "calibration/procedures/extrinsics_calibration.h"
#include "calibration/procedures/latency_calibration.h"
#include "calibration/procedures/lidar_calibration.h"
#include "calibration/procedures/pair_calibration.h"
#include "calibration/procedures/photon_calibration.h"
#include "calibration/procedures/shading_calibration.h"
#include "calibration/procedures/stereo_calibration.h"
#include "calibration/procedures/tof_calibration.h"
#include "calibration/procedures/twin_calibration.h"
#include "python/errors.h"
#include "python/interruptible.h"
#include "python/module.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/config/yaml.h"

namespace rigor::python {
namespace {

/// Takes options out of a dictionary; what is left over is refused.
class Keywords {
 public:
  explicit Keywords(const py::dict& given) : left_(given.attr("copy")()) {}
  template <class T>
  void operator()(const char* name, T& value) {
    names_.emplace_back(name);
    if (!left_.contains(name)) return;
    try {
      value = left_[name].template cast<T>();
    } catch (const py::cast_error&) {
      raise({ErrorCode::bad_input, name,
             fmt::format("expected {}, got {}", kind_of<T>(), std::string(py::repr(left_[name])))});
    }
    left_.attr("pop")(name);
  }
  void finish() const {
    for (const auto& [key, value] : left_) {
      const auto name = key.cast<std::string>();
      raise({ErrorCode::bad_input, name,
             fmt::format("expected one of {}, got \"{}\"{}", joined_or_none(names_), name,
                         did_you_mean(name, names_))});
    }
  }

 private:
  template <class T>
  static const char* kind_of() {
    if constexpr (std::is_same_v<T, bool>)
      return "True or False";
    else if constexpr (std::is_arithmetic_v<T>)
      return "a number";
    else if constexpr (std::is_same_v<T, std::string>)
      return "text";
    else if constexpr (std::is_same_v<T, std::filesystem::path>)
      return "the name of a file";
    else
      return "a list of names of files";
  }
  py::dict left_;
  std::vector<std::string> names_;
};

void read(Keywords& k, CalibrationInputs& o) {
  k("inputs", o.inputs), k("base", o.base), k("model", o.model), k("channel", o.channel);
}
void read_own(Keywords& k, CameraCalibrationOptions& o) {
  k("target", o.target), k("size", o.size), k("start_fx_px", o.start_fx_px), k("all_corners", o.all_corners);
  k("rolling_shutter", o.rolling_shutter), k("chromatic", o.chromatic), k("twin", o.twin);
  k("rate_hz", o.rate_hz), k("longest_gap_ms", o.longest_gap_ms), k("looked_for_folder", o.looked_for_folder);
}
void read_own(Keywords& k, StereoCalibrationOptions& o) {
  k("right", o.right), k("right_channel", o.right_channel), k("target", o.target), k("size", o.size);
  k("left_model", o.left_model_file), k("right_model", o.right_model_file), k("within_ms", o.within_ms);
  k("looked_for_folder", o.looked_for_folder);
}
void read_own(Keywords& k, LidarCalibrationOptions& o) {
  k("targets", o.targets), k("noise_model", o.noise_model);
}
void read_own(Keywords& k, TofCalibrationOptions& o) {
  k("raw", o.raw), k("board", o.board), k("target", o.target), k("distances", o.distances), k("unit", o.unit);
  k("amplitude_unit", o.amplitude_unit), k("noise", o.noise), k("distance_sigma_m", o.distance_sigma_m);
  k("period_s", o.period_s), k("window_px", o.window_px);
}
void read_own(Keywords& k, PhotonCalibrationOptions& o) {
  k("dark", o.input.dark), k("temperature_c", o.input.temperature_c), k("bits", o.bits),
      k("mosaic", o.mosaic);
  k("grey", o.grey), k("sensor_model", o.sensor_model);
}
void read_own(Keywords& k, ShadingCalibrationOptions& o) {
  k("dark", o.input.dark), k("black_dn", o.black_dn), k("mosaic", o.mosaic);
}
void read_own(Keywords& k, ExtrinsicsCalibrationOptions& o) {
  k("camera", o.camera), k("second", o.second), k("camera_model", o.camera_model_file);
  k("second_model", o.second_model_file), k("target", o.target), k("rough", o.rough),
      k("margin_m", o.margin_m);
  k("sigma_m", o.sigma_m), k("still_m", o.still_m), k("views", o.views);
}
void read_own(Keywords& k, DelayCalibrationOptions& o) {
  k("first", o.first), k("second", o.second), k("target", o.target), k("camera_model", o.camera_model_file);
  k("largest_s", o.largest_s), k("same_quantity", o.same_quantity);
}
void read_own(Keywords& k, PairCalibrationOptions& o) { k("from_s", o.from_s), k("until_s", o.until_s); }
void read_own(Keywords& k, TwinCalibrationOptions& o) {
  k("real", o.real), k("simulated", o.simulated), k("tolerance_ms", o.tolerance_ms);
}

template <class Options>
CalibrationResult calibrate(Result<CalibrationResult> (*procedure)(const Options&, const StopToken&),
                            const py::dict& given) {
  Options options;
  Keywords keywords(given);
  read(keywords, options);
  read_own(keywords, options);
  keywords.finish();
  return value_of(interruptible([&](StopToken stop) { return procedure(options, stop); }));
}

using Procedure = CalibrationResult (*)(const py::dict&);
const std::map<std::string, Procedure>& procedures() {
  static const std::map<std::string, Procedure> all{
      {"camera", [](const py::dict& o) { return calibrate(calibrate_camera, o); }},
      {"stereo", [](const py::dict& o) { return calibrate(calibrate_stereo, o); }},
      {"lidar", [](const py::dict& o) { return calibrate(calibrate_lidar, o); }},
      {"tof", [](const py::dict& o) { return calibrate(calibrate_tof, o); }},
      {"photon", [](const py::dict& o) { return calibrate(calibrate_photon, o); }},
      {"shading", [](const py::dict& o) { return calibrate(calibrate_shading, o); }},
      {"extrinsics", [](const py::dict& o) { return calibrate(calibrate_extrinsics, o); }},
      {"delay", [](const py::dict& o) { return calibrate(calibrate_delay, o); }},
      {"pair", [](const py::dict& o) { return calibrate(calibrate_pair, o); }},
      {"twin", [](const py::dict& o) { return calibrate(calibrate_twin, o); }},
  };
  return all;
}

py::list parameters_of(const calibration::FitResult& fit) {
  py::list all;
  for (const calibration::Parameter& p : fit.parameters)
    all.append(py::make_tuple(p.name, p.value, p.sigma, p.held, fit.identifiable(p.name)));
  return all;
}

py::list latency(const py::dict& given) {
  LatencyCalibrationOptions o;
  Keywords k(given);
  k("inputs", o.inputs), k("channels", o.channels), k("quantile", o.fit.quantile);
  k("confidence", o.fit.confidence), k("trigger", o.trigger),
      k("trigger_to_capture_ms", o.trigger_to_capture_ms);
  k.finish();
  const LatencyCalibration found =
      value_of(interruptible([&](StopToken stop) { return calibrate_latency(o, stop); }));
  py::list all;
  for (const ChannelLatency& c : found.channels) {
    py::dict d;
    d["channel"] = c.channel;
    d["samples"] = c.fit.samples;
    d["p50_ns"] = c.fit.p50_ns, d["p99_ns"] = c.fit.p99_ns, d["max_ns"] = c.fit.max_ns;
    d["bound_ns"] = c.fit.bound_ns;
    d["present_ns"] = c.present_ns;
    d["latency_ms"] = static_cast<double>(c.put_ns) * 1e-6;
    d["set"] = c.rig_override();
    d["warnings"] = c.warnings;
    all.append(std::move(d));
  }
  return all;
}

}  // namespace

void add_calibration(py::module_& m) {
  py::class_<CalibrationResult>(m, "CalibrationResult")
      .def_property_readonly("title", [](const CalibrationResult& r) { return r.title; })
      .def_property_readonly("model", [](const CalibrationResult& r) { return r.fit.model; })
      .def_property_readonly("parameters", [](const CalibrationResult& r) { return parameters_of(r.fit); })
      .def_property_readonly("covariance", [](const CalibrationResult& r) { return r.fit.covariance; })
      .def_property_readonly("warnings", [](const CalibrationResult& r) { return r.fit.warnings; })
      .def_property_readonly("notes", [](const CalibrationResult& r) { return r.notes; })
      .def_property_readonly("record_next", [](const CalibrationResult& r) { return r.record_next; })
      .def_property_readonly("interrupted", [](const CalibrationResult& r) { return r.fit.interrupted; })
      .def_property_readonly("parts",
                             [](const CalibrationResult& r) {
                               py::dict parts;
                               for (const SensorModelPart& p : r.parts)
                                 parts[py::str(p.name)] =
                                     py::make_tuple(parameters_of(p.fit), py::cast(p.fit.covariance));
                               return parts;
                             })
      .def("json",
           [](const CalibrationResult& r) {
             return result_json(r).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
           })
      .def("text", [](const CalibrationResult& r) { return text_report(r); })
      .def("html", [](const CalibrationResult& r) { return html_report(r); })
      .def("yaml", [](const CalibrationResult& r) { return value_of(sensor_model_yaml(r)); })
      .def("save", [](const CalibrationResult& r, const std::filesystem::path& file) {
        std::vector<std::filesystem::path> files;
        for (const SavedSensorModel& s : value_of(save_sensor_model(r, file))) files.push_back(s.file);
        return files;
      });
  m.def("calibrate",
        [](const std::string& what, const py::dict& options) { return procedures().at(what)(options); });
  m.def("calibrate_latency", &latency);
}

}  // namespace rigor::python
