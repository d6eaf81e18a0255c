// A time-of-flight camera as numbers: geometry, modulation, pixel, errors.
#pragma once

namespace rigor::models {

struct TofModel {};

}  // namespace rigor::models
