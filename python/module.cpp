// rigor._rigor: what the package rigor (rigor/*.py) is built on. Everything here takes and gives plain values
// and arrays; names, defaults and documentation are the package's.
#include "python/module.h"

#include "bench/console/progress.h"
#include "bench/files/installed_configs.h"

PYBIND11_MODULE(_rigor, m) {
  namespace py = pybind11;
  // Progress goes where the caller's callback says, not to stderr.
  rigor::set_progress_format(rigor::ProgressFormat::none);
  m.attr("version") = RIGOR_VERSION;
  m.def("find_config", [](const std::string& name) { return rigor::find_config(name).string(); });
  m.def("installed_rigs", [] {
    py::list rigs;
    for (const auto& rig : rigor::installed_rigs())
      rigs.append(py::make_tuple(rig.name, rig.about, rig.file.string()));
    return rigs;
  });
  rigor::python::add_recordings(m);
  rigor::python::add_rigs(m);
  rigor::python::add_sensing(m);
  rigor::python::add_datasets(m);
  rigor::python::add_worlds(m);
  rigor::python::add_calibration(m);
  rigor::python::add_models(m);
}
