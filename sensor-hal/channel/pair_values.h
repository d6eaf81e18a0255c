// Samples that are a few numbers, compared number by number, real − simulated: registers each in its unit,
// and of inertial units, satellite receivers and odometry what `compared_values` lists. Any thread, no
// allocation.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include "sensor-hal/types/sample.h"

namespace rigor {

struct ComparedValue {
  std::string_view name, unit;
};
/// What `value_differences` compares of a kind, in its order; empty for kinds that are not numbers, and for
/// registers, whose channel names them.
[[nodiscard]] std::span<const ComparedValue> compared_values(SampleKind kind) noexcept;

/// How many of `difference` were set; 0: the two cannot be compared (kinds or counts differ, no fix).
/// Places of receivers are compared along east, north and up at the real one; both linearised on the
/// ellipsoid, which is good to a millimetre for differences up to 100 m away from the poles. Odometry is
/// compared by x, y and yaw in its own frame.
[[nodiscard]] std::uint32_t value_differences(const Sample& real, const Sample& simulated,
                                              std::array<double, RegisterBlock::kMax>& difference) noexcept;

}  // namespace rigor
