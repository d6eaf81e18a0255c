// Light of the cloudless sky: scattering by air and aerosol in a round atmosphere, band by band.
//
// First-order scattering is integrated along the line of sight through a spherical shell of 100 km, so that
// twilight comes out of the geometry; what is scattered twice or more is taken as equal in all directions
// (Hillaire 2020, "A Scalable and Production Ready Sky and Atmosphere Rendering Technique", section 5).
// Rayleigh scatterers and aerosol fall off exponentially with height, ozone is a tent about 25 km.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "sim/nature/sky/band_light.h"

namespace rigor::nature {

using BandValues = std::array<double, kBandCount>;

/// Ways through the scatterers along a straight line, in metres at the density of sea level (ozone: of the
/// tent's peak). Of one metre: the density itself.
struct AirColumns {
  double rayleigh_m = 0, aerosol_m = 0, ozone_m = 0;
};

/// Extinction and scattering per metre at sea level (ozone: at its peak).
struct AirCoefficients {
  BandValues rayleigh{}, aerosol_extinction{}, aerosol_scattering{}, ozone{};
  [[nodiscard]] static AirCoefficients of(double turbidity);
  [[nodiscard]] BandValues transmittance(const AirColumns& columns) const;
  /// What of `left` a piece of way of these densities scatters towards the eye, for light of radiance 1 from
  /// all sides (without the phase function); takes the piece's extinction from `left`.
  struct Scattered {
    BandValues by_air{}, by_aerosol{};
  };
  [[nodiscard]] Scattered scattered(const AirColumns& density, double way_m, BandValues& left) const;
};

inline constexpr double kEarthRadius_m = 6'371'000, kAirTop_m = 100'000;

/// From a height above the sea out of the atmosphere, at a cosine of the zenith angle. Ways that meet the
/// ground: as if there were none at the horizon. From a table. Any thread.
[[nodiscard]] AirColumns columns_to_space(double height_m, double cos_zenith);

/// Share of the sun's light at a height that the ground does not hide, 0 … 1 across the disc.
[[nodiscard]] double sun_above_ground(double height_m, double cos_zenith);

class ClearSky {
 public:
  /// About 30 ms: the light that is scattered more than once, for every height and sun.
  ClearSky(double turbidity, const Spectrum& ground_albedo);

  /// The sky of one sun and one place, ready to be asked in every direction. About 10 ms.
  class View {
   public:
    /// Radiance per band in W/(m² sr). `relative_azimuth_rad` is counted from the sun.
    [[nodiscard]] Spectrum radiance(int row, double relative_azimuth_rad) const;
    [[nodiscard]] int rows() const noexcept { return rows_; }

   private:
    friend class ClearSky;
    struct Node {
      BandValues rayleigh{}, aerosol{}, multiple{};  ///< without the phase function
    };
    int rows_ = 0;
    double sun_elevation_rad_ = 0;
    std::vector<Node> nodes_;  ///< row by row, azimuths 0 … pi
  };
  /// Rows at elevations (row + ½)·90°/rows. `solar`: irradiance above the atmosphere.
  [[nodiscard]] View view(double sun_elevation_deg, double height_m, const BandValues& solar, int rows) const;
  [[nodiscard]] const AirCoefficients& air() const noexcept { return air_; }

 private:
  [[nodiscard]] BandValues multiple(double height_m, double cos_sun) const;
  AirCoefficients air_;
  std::vector<BandValues> multiple_;  ///< mean radiance per unit of solar irradiance: height, then sun
};

}  // namespace rigor::nature
