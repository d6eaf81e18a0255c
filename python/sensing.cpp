// Samples of simulated channels without a run, with their ground truth.
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <cstring>

#include "bench/capture/sensor_probe.h"
#include "python/errors.h"
#include "python/module.h"
#include "python/rig_options.h"
#include "python/samples.h"

namespace rigor::python {
namespace {

/// An array over a vector that it keeps; null where it is empty.
template <class T>
py::object array_of(std::vector<T> values, std::vector<py::ssize_t> shape) {
  if (values.empty()) return py::none();
  auto* owned = new std::vector<T>(std::move(values));
  const py::capsule base(owned, [](void* p) { delete static_cast<std::vector<T>*>(p); });
  return py::array_t<T>(std::move(shape), owned->data(), base);
}

py::object truth_of(GroundTruth truth, bool points) {
  if (truth.node.empty() && truth.width == 0) return py::none();
  const auto n = static_cast<py::ssize_t>(truth.width) * truth.height;
  const auto shape = [&](py::ssize_t each) {
    std::vector<py::ssize_t> s = points ? std::vector<py::ssize_t>{n}
                                        : std::vector<py::ssize_t>{static_cast<py::ssize_t>(truth.height),
                                                                   static_cast<py::ssize_t>(truth.width)};
    if (each > 1) s.push_back(each);
    return s;
  };
  py::dict d;
  d["node"] = array_of(std::move(truth.node), shape(1));
  d["class_index"] = array_of(std::move(truth.class_index), shape(1));
  d["class_names"] = truth.class_names;
  d["range_m"] = array_of(std::move(truth.range_m), shape(1));
  d["normal"] = array_of(std::move(truth.normal), shape(3));
  d["flow_px_per_s"] = array_of(std::move(truth.flow_px), shape(2));
  return std::move(d);
}

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
