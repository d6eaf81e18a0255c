// Samples of simulated channels without a run, with their ground truth.
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <cstring>

#include "bench/capture/sensor_probe.h"
#include "python/arrays.h"
#include "python/errors.h"
#include "python/module.h"
#include "python/rig_options.h"
#include "python/samples.h"

namespace rigor::python {
namespace {

class Probe {
 public:
  Probe(const std::string& file, const py::dict& rig_options, const py::dict& options) {
    const RigOptions given(rig_options);
    SensorProbeOptions how;
    how.channel = options["channel"].cast<std::string>();
    how.joints_deg = options["joints_deg"].cast<std::vector<std::pair<std::string, double>>>();
    how.ideal = options["ideal"].cast<bool>();
    how.only = options["only"].cast<std::vector<std::string>>();
    how.renderer = options["renderer"].cast<std::string>();
    how.truth = options["truth"].cast<bool>();
    Result<std::unique_ptr<SensorProbe>> probe = [&]() -> Result<std::unique_ptr<SensorProbe>> {
      const py::gil_scoped_release without_gil;
      auto rig = given.load(file);
      if (!rig) return tl::unexpected<Error>(rig.error());
      return SensorProbe::open(std::move(*rig), std::move(how));
    }();
    probe_ = value_of(std::move(probe));
  }

  /// (record, content as an array of bytes that can be written, truth or None, directions or None).
  py::tuple capture(double at_s) {
    Result<Capture> taken = [&] {
      const py::gil_scoped_release without_gil;
      return probe_->capture(at_s);
    }();
    Capture capture = value_of(std::move(taken));
    const Sample& sample = capture.sample;
    const auto bytes = sample.bytes();
    py::array_t<std::uint8_t> content(static_cast<py::ssize_t>(bytes.size()));
    if (!bytes.empty()) std::memcpy(content.mutable_data(), bytes.data(), bytes.size());
    py::object directions = py::none();
    if (!capture.directions.empty()) {
      const auto* info = sample.as<RangeImageInfo>();
      std::vector<float> flat(capture.directions.size() * 3);
      std::memcpy(flat.data(), capture.directions.data(), flat.size() * sizeof(float));
      directions = array_of(std::move(flat), {static_cast<py::ssize_t>(info->height_px),
                                              static_cast<py::ssize_t>(info->width_px), 3});
    }
    return py::make_tuple(sample_record(sample), std::move(content),
                          truth_of(std::move(capture.truth), sample.as<PointCloudInfo>() != nullptr),
                          std::move(directions));
  }
  [[nodiscard]] std::string kind() const { return std::string(kind_name(probe_->kind())); }
  [[nodiscard]] std::string renderer() const { return probe_->renderer(); }

 private:
  std::unique_ptr<SensorProbe> probe_;
};

}  // namespace

void add_sensing(py::module_& m) {
  py::class_<Probe>(m, "Probe")
      .def(py::init<const std::string&, const py::dict&, const py::dict&>())
      .def("capture", &Probe::capture)
      .def_property_readonly("kind", &Probe::kind)
      .def_property_readonly("renderer", &Probe::renderer);
}

}  // namespace rigor::python
