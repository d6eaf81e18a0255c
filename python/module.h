// The parts of the extension module rigor._rigor, each in a file of its own.
#pragma once

#include <pybind11/pybind11.h>

namespace rigor::python {

void add_recordings(pybind11::module_& m);   // recordings.cpp
void add_rigs(pybind11::module_& m);         // rigs.cpp
void add_sensing(pybind11::module_& m);      // sensing.cpp
void add_datasets(pybind11::module_& m);     // datasets.cpp
void add_worlds(pybind11::module_& m);       // worlds.cpp
void add_calibration(pybind11::module_& m);  // calibration.cpp
void add_models(pybind11::module_& m);       // models.cpp

}  // namespace rigor::python
