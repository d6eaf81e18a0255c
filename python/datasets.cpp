// Labelled samples of a rig's simulated sensors: rigor.dataset.
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <cstring>
#include <nlohmann/json.hpp>

#include "bench/dataset/dataset_texts.h"
#include "bench/dataset/fill_dataset.h"
#include "bench/files/installed_configs.h"
#include "python/arrays.h"
#include "python/errors.h"
#include "python/interruptible.h"
#include "python/module.h"
#include "sensor-hal/rig/rig.h"

namespace rigor::python {
namespace {

/// Texts by the names of rigor.dataset's keywords.
DatasetTexts texts_of(const py::dict& given) {
  DatasetTexts t;
  const auto read = [&](const char* key, auto& value) {
    value = given[key].cast<std::remove_reference_t<decltype(value)>>();
  };
  read("source", t.source);
  read("poses", t.poses), read("along", t.along), read("within", t.within);
  read("set", t.overrides), read("vary", t.vary);
  read("channels", t.channels), read("sample", t.samples), read("seed", t.seed);
  read("height", t.height), read("yaw", t.yaw), read("pitch", t.pitch), read("roll", t.roll);
  read("lateral", t.lateral), read("clearance", t.clearance), read("split", t.split);
  read("renderer", t.renderer), read("draw_devices", t.draw_devices), read("truth", t.truth);
  t.dashes = "";
  return t;
}

template <class T>
py::array_t<std::uint8_t> bytes_of(const std::vector<T>& values) {
  py::array_t<std::uint8_t> bytes(static_cast<py::ssize_t>(values.size() * sizeof(T)));
  if (!values.empty()) std::memcpy(bytes.mutable_data(), values.data(), values.size() * sizeof(T));
  return bytes;
}

py::list instances_of(const DatasetLabels& labels, const std::vector<DatasetCategory>& categories) {
  py::list all;
  for (const DatasetInstance& i : labels.instances) {
    py::dict d;
    d["id"] = i.id, d["node"] = i.node, d["name"] = i.name;
    const auto category = std::find_if(categories.begin(), categories.end(),
                                       [&](const DatasetCategory& c) { return c.id == i.category; });
    d["category"] = i.category;
    d["class"] = category == categories.end() ? std::string() : category->name;
    d["box"] = py::make_tuple(i.box_px[0], i.box_px[1], i.box_px[2], i.box_px[3]);
    d["area_px"] = i.area_px, d["cut_off"] = i.cut_off, d["median_depth_m"] = i.median_depth_m;
    all.append(std::move(d));
  }
  return all;
}

py::dict view_of(DatasetView view, const std::vector<DatasetCategory>& categories) {
  py::dict d;
  const auto height = static_cast<py::ssize_t>(view.height), width = static_cast<py::ssize_t>(view.width);
  const bool cloud = view.kind == SampleKind::point_cloud;
  const std::vector<py::ssize_t> shape =
      cloud ? std::vector<py::ssize_t>{width} : std::vector<py::ssize_t>{height, width};
  d["kind"] = std::string(kind_name(view.kind));
  d["width"] = width, d["height"] = height;
  d["device"] = view.device;
  d["T_world_sensor"] = Eigen::Matrix4d(view.T_world_sensor.matrix());
  d["lens"] = py::none();
  if (view.lens) {
    py::dict lens;
    lens["fx_px"] = view.lens->fx_px, lens["fy_px"] = view.lens->fy_px;
    lens["cx_px"] = view.lens->cx_px, lens["cy_px"] = view.lens->cy_px;
    d["lens"] = lens;
  }
  if (view.kind == SampleKind::image) {
    d["format"] = std::string(pfnc_name(view.image.format));
    d["bytes"] = bytes_of(view.pixels);
  } else if (view.kind == SampleKind::range_image) {
    d["range_m"] = array_of(std::move(view.range_m), shape);
    d["amplitude"] = array_of(std::move(view.amplitude), shape);
  } else {
    d["bytes"] = bytes_of(view.points);
  }
  d["instances"] = instances_of(view.labels, categories);
  d["depth_m"] = array_of(std::move(view.depth_m), shape);
  d["category"] = array_of(std::move(view.labels.category), shape);
  d["instance"] = array_of(std::move(view.labels.instance), shape);
  d["truth"] = truth_of(std::move(view.truth), cloud);
  return d;
}

/// Everything that measures runs on one thread of its own, as the renderers want it.
class PythonDataset {
  template <class Work>
  auto on_thread(Work&& work) {
    return interruptible(worker_, std::forward<Work>(work), [] {});
  }

 public:
  explicit PythonDataset(const py::dict& given) {
    DatasetTexts texts = texts_of(given);
    if (!is_dataset_file(texts.source)) texts.source = find_config(texts.source.string());
    dataset_ = value_of(on_thread([&](StopToken) -> Result<std::unique_ptr<Dataset>> {
      auto options = read_dataset_options(texts);
      if (!options) return tl::unexpected<Error>(options.error());
      return Dataset::create(*options);
    }));
  }
  ~PythonDataset() {
    const py::gil_scoped_release without_gil;
    worker_.begin([this] { dataset_.reset(); });
    while (!worker_.ended_within(std::chrono::milliseconds(1000))) {
    }
  }
  PythonDataset(const PythonDataset&) = delete;
  PythonDataset& operator=(const PythonDataset&) = delete;

  [[nodiscard]] std::uint64_t size() const { return dataset_->size(); }
  [[nodiscard]] py::list channels() const {
    py::list all;
    for (const Dataset::Channel& c : dataset_->channels())
      all.append(py::make_tuple(c.name, std::string(kind_name(c.kind)), c.drawn));
    return all;
  }
  [[nodiscard]] py::list categories() const {
    py::list all;
    for (const DatasetCategory& c : dataset_->categories()) {
      py::dict d;
      d["id"] = c.id, d["name"] = c.name, d["base"] = c.base, d["thing"] = c.thing;
      all.append(std::move(d));
    }
    return all;
  }
  [[nodiscard]] std::string manifest() const { return dataset_->manifest().dump(); }

  py::dict sample(std::uint64_t index) {
    DatasetSample s = value_of(on_thread([&](StopToken) { return dataset_->sample(index); }));
    py::dict d;
    d["index"] = s.index, d["split"] = s.split;
    d["T_world_carrier"] = Eigen::Matrix4d(s.T_world_carrier.matrix());
    py::dict conditions;
    for (const auto& [key, value] : s.conditions)
      if (!value.empty()) conditions[py::str(key)] = value;
    d["conditions"] = std::move(conditions);
    py::list rejected;
    for (const DatasetRejection& r : s.rejected)
      rejected.append(py::make_tuple(Eigen::Vector3d(r.position_m), r.reason, r.detail));
    d["rejected"] = std::move(rejected);
    py::dict views;
    for (DatasetView& v : s.views) {
      const std::string channel = v.channel;
      views[py::str(channel)] = view_of(std::move(v), dataset_->categories());
    }
    d["views"] = std::move(views);
    return d;
  }

  /// Goes on where an earlier call was interrupted.
  py::dict save(const std::filesystem::path& folder, const std::optional<std::vector<std::string>>& layers,
                bool exr, std::uint32_t min_area_px, int threads) {
    DatasetOutputOptions how;
    if (layers) how.layers = *layers;
    how.exr = exr;
    how.min_area_px = min_area_px;
    const Filled filled = value_of(on_thread([&](StopToken stop) -> Result<Filled> {
      auto opened = DatasetOutput::open(folder, *dataset_, how);
      if (!opened) return tl::unexpected<Error>(opened.error());
      FillOptions fill;
      fill.threads = threads;
      fill.stop = stop;
      return fill_dataset(*dataset_, **opened, fill);
    }));
    py::dict d;
    d["samples"] = filled.summary.samples, d["left_out"] = filled.summary.left_out;
    d["annotations"] = filled.summary.annotations;
    d["made"] = filled.made, d["there"] = filled.there, d["seconds"] = filled.whole_s;
    return d;
  }

 private:
  Worker worker_;
  std::unique_ptr<Dataset> dataset_;
};

}  // namespace

void add_datasets(py::module_& m) {
  py::class_<PythonDataset>(m, "Dataset")
      .def(py::init<const py::dict&>())
      .def("size", &PythonDataset::size)
      .def("channels", &PythonDataset::channels)
      .def("categories", &PythonDataset::categories)
      .def("manifest", &PythonDataset::manifest)
      .def("sample", &PythonDataset::sample)
      .def("save", &PythonDataset::save);
  m.attr("dataset_layers") = dataset_layers();
}

}  // namespace rigor::python
