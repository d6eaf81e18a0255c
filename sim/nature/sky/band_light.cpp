#include "sim/nature/sky/band_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/nature/sky/solar_position.h"

namespace rigor::nature {
namespace {

constexpr double kRad = std::numbers::pi / 180;
// Cross-sections of ozone in the Chappuis bands (Serdyuchenko et al. 2014, rounded), 1e-21 cm²; 300 Dobson
// units are 8.06e18 molecules per cm².
constexpr std::array<double, kBandCount> kOzoneCrossSection = {4.0, 3.4, 0.35, 0.0, 0.0, 0.0};
constexpr double kOzoneColumn = 8.06e-3;
// Absorption coefficients of water vapour, means of Bird & Riordan's table over each band.
constexpr std::array<double, kBandCount> kWaterAbsorption = {0.01, 0.0, 0.0, 0.35, 1.5, 0.01};

}  // namespace

OpticalDepths optical_depths(double turbidity) {
  OpticalDepths d;
  const double beta = std::max(0.04608 * turbidity - 0.04586, 0.0);
  for (int b = 0; b < kBandCount; ++b) {
    const double um = world::kBandWavelength_nm[b] * 1e-3, um2 = um * um;
    d.rayleigh[b] = 0.008569 / (um2 * um2) * (1 + 0.0113 / um2 + 0.00013 / (um2 * um2));
    d.aerosol[b] = beta * std::pow(um, -1.3);
    d.ozone[b] = kOzoneCrossSection[b] * kOzoneColumn;
  }
  return d;
}

double air_mass(double elevation_deg) {
  const double h = std::clamp(elevation_deg, -0.5, 90.0);
  return 1 / (std::sin(h * kRad) + 0.50572 * std::pow(h + 6.07995, -1.6364));
}

double low_air_mass(double elevation_deg) {
  const double h = std::clamp(elevation_deg, -0.5, 90.0);
  return 1 / (std::sin(h * kRad) + 0.0548 * std::pow(h + 2.65, -1.452));
}

double precipitable_water_cm(double temperature_c) {
  const double kelvin = std::max(temperature_c + 273.15, 180.0);
  const double saturation_pa = std::exp(26.23 - 5416 / kelvin);
  return std::clamp(0.493 * 0.6 * saturation_pa / kelvin, 0.02, 6.0);
}

std::array<double, kBandCount> water_vapour_transmittance(double water_cm, double mass) {
  std::array<double, kBandCount> t{};
  for (int b = 0; b < kBandCount; ++b) {
    const double a = kWaterAbsorption[b] * water_cm * mass;
    t[b] = std::exp(-0.2385 * a / std::pow(1 + 20.07 * a, 0.45));
  }
  return t;
}

double visible_disc(double elevation_deg) {
  const double x = std::clamp(elevation_deg / 0.2665, -1.0, 1.0);
  return 0.5 + (x * std::sqrt(1 - x * x) + std::asin(x)) / std::numbers::pi;
}

Spectrum direct_irradiance(double elevation_deg, double distance_au, const ClearAir& air) {
  Spectrum e{};
  const double disc = visible_disc(elevation_deg);
  if (!(disc > 0)) return e;
  const auto depths = optical_depths(air.turbidity);
  const double mass = air_mass(elevation_deg), low_mass = low_air_mass(elevation_deg);
  const auto water = water_vapour_transmittance(precipitable_water_cm(air.temperature_c), low_mass);
  const double pressure = air_pressure_hpa(air.height_m) / 1013.25;
  const double aerosol_left = std::exp(-std::max(air.height_m, 0.0) / kAerosolScaleHeight_m);
  for (int b = 0; b < kBandCount; ++b) {
    const double depth = (depths.rayleigh[b] * pressure + depths.ozone[b]) * mass +
                         depths.aerosol[b] * aerosol_left * low_mass;
    e[b] = static_cast<float>(disc * kSolarIrradiance[b] / (distance_au * distance_au) * std::exp(-depth) *
                              water[b]);
  }
  return e;
}

}  // namespace rigor::nature
