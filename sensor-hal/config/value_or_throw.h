// Inside functions that throw ConfigError: the value of a Result, or its error thrown.
#pragma once

#include <utility>

#include "sensor-hal/config/yaml.h"

namespace rigor {

template <class T>
T value_or_throw(Result<T> result) {
  if (!result) throw ConfigError(result.error());
  return std::move(*result);
}

}  // namespace rigor
