// Sunlight in Rigor's bands, above the air and through it.
//
// An irradiance or radiance "in a band" is the integral over the band's width about its wavelength:
//
//   band      red      green    blue     850      905      1550 nm
//   width     100      100      100      50       50       50 nm
//   above     168      185      190      49       45       13.5 W/m² at 1 au
//
// A camera or scanner whose filter is narrower takes the share width_of_filter / width of what it is given.
#pragma once

#include "sim/render/content/content.h"

namespace rigor::nature {

using render::kBandCount;
using render::Spectrum;

inline constexpr std::array<double, kBandCount> kBandWidth_nm = {100, 100, 100, 50, 50, 50};
/// Mean of the solar spectrum (ASTM E490) over the band, times its width. W/m² at 1 au.
inline constexpr std::array<double, kBandCount> kSolarIrradiance = {168, 185, 190, 49, 45, 13.5};

/// Vertical optical depths at sea level, per band.
struct OpticalDepths {
  std::array<double, kBandCount> rayleigh{}, aerosol{}, ozone{};
};
/// Rayleigh: Hansen & Travis 1974. Aerosol: β = 0.04608·turbidity − 0.04586, Ångström exponent 1.3 (Preetham
/// et al. 1999). Ozone: 300 Dobson units in the Chappuis bands.
[[nodiscard]] OpticalDepths optical_depths(double turbidity);

inline constexpr double kRayleighScaleHeight_m = 8000, kAerosolScaleHeight_m = 1200;

/// Kasten & Young 1989, relative to the zenith; apparent elevation, taken as −0.5° where it is lower.
[[nodiscard]] double air_mass(double elevation_deg);
/// The same for what lies low, aerosol and water vapour: Kasten 1966.
[[nodiscard]] double low_air_mass(double elevation_deg);

/// Water above the place, in cm: Leckner 1978 at 60 % relative humidity.
[[nodiscard]] double precipitable_water_cm(double temperature_c);
/// What water vapour leaves of each band (Bird & Riordan 1986, one coefficient a band).
[[nodiscard]] std::array<double, kBandCount> water_vapour_transmittance(double water_cm, double mass);

struct ClearAir {
  double turbidity = 3, temperature_c = 15, height_m = 0;
};
/// Direct irradiance on a plane square to the sun, through clear air, W/m² per band. 0 once the disc has set.
[[nodiscard]] Spectrum direct_irradiance(double elevation_deg, double distance_au, const ClearAir& air);
/// Share of the sun's disc above the horizon.
[[nodiscard]] double visible_disc(double elevation_deg);

}  // namespace rigor::nature
