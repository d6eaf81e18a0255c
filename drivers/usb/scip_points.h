// Steps of a scanner to points and back.
#pragma once

#include <span>

#include "drivers/usb/scip_device.h"
#include "sensor-hal/types/sample.h"

namespace rigor::usb {

/// Points of a scan, in the order in which they were measured; codes below DMIN and ranges beyond DMAX give
/// none. A cluster's point lies at its middle. Remission is the intensity (0 where the scan has none).
/// Offsets count from the first step of the detection range, whatever the scan's own first step is.
/// `points` has room for request.count(). Returns how many. Any thread, no allocation.
std::size_t scan_points(const ScipScan& scan, const ScannerParameters& parameters,
                        std::span<LidarPoint> points) noexcept;

/// A simulated scan as the scanner measures it: each point goes to the step that is nearest to its azimuth,
/// the nearest point of a step counts; steps without one get the model's codes. The spans reach from step 0
/// to end_step.
void measure_points(std::span<const LidarPoint> points, const ScannerModel& model,
                    std::span<std::uint32_t> range_mm, std::span<std::uint32_t> intensity) noexcept;

}  // namespace rigor::usb
