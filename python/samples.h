// One sample as two blocks of bytes: the record that the application protocol has of it
// (bench/application/process_protocol.h), which rigor_client.py reads, and its content.
#pragma once

#include <pybind11/pybind11.h>

#include "sensor-hal/types/sample.h"

namespace rigor::python {

/// The record alone; its place and that of its content are 0. With the GIL.
[[nodiscard]] pybind11::bytes sample_record(const Sample& sample);

}  // namespace rigor::python
