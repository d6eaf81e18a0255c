// A flat field as a grid of cells: how much light each part of the picture got.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor::calibration {

struct ShadingCell {
  double u_px = 0, v_px = 0;  ///< centre, in pixels of the full sensor
  double light = 0;           ///< relative to any other cell; above 0
  double sigma = 0;           ///< standard uncertainty of it; 0: not known
  double size_px = 0;         ///< side of the area that it is the mean of; 0: a point
};

/// Cells of the mean of flat pictures, `black_dn` taken off; `columns` over the width, square. The colours of
/// a 2x2 mosaic are brought to one level first. Pixels that stand out of their cell, dust and defects, are
/// left out. bad_input: nothing above black.
[[nodiscard]] Result<std::vector<ShadingCell>> flat_field_cells(std::span<const double> mean_dn, int width_px,
                                                                int height_px, double black_dn, bool mosaic,
                                                                int columns = 32);

/// Cells of a table of gains that even a flat field out (light = 1/gain), row by row over the whole picture,
/// the values at the cells' centres. bad_input: a gain that is none.
[[nodiscard]] Result<std::vector<ShadingCell>> gain_table_cells(std::span<const double> gains, int columns,
                                                                int width_px, int height_px);

}  // namespace rigor::calibration
