// Figures of a calibration as SVG text.
#pragma once

#include <string>

#include "calibration/core/figures.h"

namespace rigor {
[[nodiscard]] std::string svg_figure(const calibration::Figure& figure);
}
