// Haze, fog, rain and snow: what they take from a ray of each band, and the drops that one sees.
#pragma once

#include "sim/nature/sky/band_light.h"

namespace rigor::nature {

/// Extinction per metre of haze or fog of a meteorological range (2 % contrast at 550 nm, Koschmieder), by
/// wavelength after Kim, McArthur & Korevaar 2001. Infinite range: 0. Precondition: visibility_m > 0.
[[nodiscard]] double haze_extinction_per_m(double visibility_m, double wavelength_nm);
[[nodiscard]] Spectrum haze_extinction_per_m(double visibility_m);

/// Marshall–Palmer drop sizes, extinction efficiency 2, the same in all bands. 0 at 0 mm/h.
[[nodiscard]] double rain_extinction_per_m(double rain_mm_per_h);
/// Sekhon & Srivastava 1970 sizes of molten flakes, as flakes of 100 kg/m³. `snow_mm_per_h`: of water.
[[nodiscard]] double snow_extinction_per_m(double snow_mm_per_h);

/// Atlas, Srivastava & Sekhon 1973 (a fit to Gunn & Kinzer 1949); never negative.
[[nodiscard]] double rain_fall_speed_m_per_s(double diameter_m);

/// Rain or snow, whichever is more; extinction of both. The drops that are drawn are of median volume
/// diameter, and as many as have the extinction of all.
[[nodiscard]] render::Precipitation precipitation(double rain_mm_per_h, double snow_mm_per_h,
                                                  const Eigen::Vector3d& wind_m_per_s);

/// `from_deg`: 0 from the north, 90 from the east. World frame.
[[nodiscard]] Eigen::Vector3d wind_velocity(double speed_m_per_s, double from_deg);

}  // namespace rigor::nature
