#include "python/arrays.h"

#include <pybind11/stl.h>

namespace rigor::python {

pybind11::object truth_of(GroundTruth truth, bool points) {
  if (truth.node.empty() && truth.width == 0) return pybind11::none();
  const auto n = static_cast<pybind11::ssize_t>(truth.width) * truth.height;
  const auto shape = [&](pybind11::ssize_t each) {
    std::vector<pybind11::ssize_t> s =
        points ? std::vector<pybind11::ssize_t>{n}
               : std::vector<pybind11::ssize_t>{static_cast<pybind11::ssize_t>(truth.height),
                                                static_cast<pybind11::ssize_t>(truth.width)};
    if (each > 1) s.push_back(each);
    return s;
  };
  pybind11::dict d;
  d["node"] = array_of(std::move(truth.node), shape(1));
  d["class_index"] = array_of(std::move(truth.class_index), shape(1));
  d["class_names"] = truth.class_names;
  d["range_m"] = array_of(std::move(truth.range_m), shape(1));
  d["normal"] = array_of(std::move(truth.normal), shape(3));
  d["flow_px_per_s"] = array_of(std::move(truth.flow_px), shape(2));
  return d;
}

}  // namespace rigor::python
