// How a rig is loaded and run, from keyword arguments of Python.
#pragma once

#include <pybind11/pybind11.h>

#include <optional>
#include <string>
#include <vector>

#include "bench/bench.h"

namespace rigor::python {

struct RigOptions {
  /// Reads the dictionary: keys are those of rigor/_rig.py, all of them present.
  explicit RigOptions(const pybind11::dict& given);
  /// The rig with these options in place of its own values; by a short name, too (installed_configs.h).
  [[nodiscard]] Result<RigConfig> load(const std::string& file) const;
  [[nodiscard]] Result<BenchOptions> bench_options() const;

  std::vector<std::string> set;
  std::string clock, record, report, trace, junit, faults_from;
  std::vector<std::string> fail_on;
  std::optional<double> duration_s;
  std::optional<std::string> live;  ///< [ADDRESS:]PORT
  double pace = 0;
  int workers = 0;
  bool replace = false, control = false;
};

}  // namespace rigor::python
