// Numbers that many files need by name.
#pragma once

#include <limits>

namespace rigor {

/// Not a number: a value that is not known.
inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

}  // namespace rigor
