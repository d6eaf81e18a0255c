#include "sim/nature/sky/sky_scattering.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor::nature {
namespace {

using std::numbers::pi;
constexpr double kTop = kEarthRadius_m + kAirTop_m;
const double kHorizon = std::sqrt(kTop * kTop - kEarthRadius_m * kEarthRadius_m);
constexpr double kOzonePeak_m = 25'000, kOzoneHalfWidth_m = 15'000;
constexpr double kAerosolAlbedo = 0.92;     // share of aerosol extinction that is scattering, not absorption
constexpr double kAerosolAsymmetry = 0.74;  // of the phase function
constexpr double kSunRadius_rad = 0.00465;

AirColumns densities(double height_m) {
  const double h = std::max(height_m, 0.0);
  return {std::exp(-h / kRayleighScaleHeight_m), std::exp(-h / kAerosolScaleHeight_m),
          std::max(0.0, 1 - std::abs(h - kOzonePeak_m) / kOzoneHalfWidth_m)};
}

/// Height after a way along a straight line.
double height_after(double r, double mu, double way) {
  return std::sqrt(std::max(0.0, r * r + way * way + 2 * r * mu * way)) - kEarthRadius_m;
}
double way_to_top(double r, double mu) {
  return std::max(0.0, -r * mu + std::sqrt(std::max(0.0, r * r * (mu * mu - 1) + kTop * kTop)));
}
double way_to_ground(double r, double mu) {
  return std::max(
      0.0, -r * mu - std::sqrt(std::max(0.0, r * r * (mu * mu - 1) + kEarthRadius_m * kEarthRadius_m)));
}
double cos_horizon(double r) {
  const double s = std::min(1.0, kEarthRadius_m / r);
  return -std::sqrt(1 - s * s);
}

// ---------------------------------------------------------------- columns, after Bruneton 2017
constexpr int kHeights = 48, kCosines = 160;

struct ColumnTable {
  std::vector<AirColumns> cells = std::vector<AirColumns>(kHeights * kCosines);
  ColumnTable() {
    for (int i = 0; i < kHeights; ++i) {
      const double rho = kHorizon * i / (kHeights - 1);
      const double r = std::sqrt(rho * rho + kEarthRadius_m * kEarthRadius_m);
      for (int j = 0; j < kCosines; ++j) {
        const double shortest = kTop - r, longest = rho + kHorizon;
        const double d = shortest + (longest - shortest) * j / (kCosines - 1);
        const double mu =
            d <= 0 ? 1 : std::clamp((kHorizon * kHorizon - rho * rho - d * d) / (2 * r * d), -1.0, 1.0);
        cells[static_cast<std::size_t>(i * kCosines + j)] = integrate(r, mu);
      }
    }
  }
  static AirColumns integrate(double r, double mu) {
    // Steps follow s², which puts most of them where the air is dense: near the lowest point of the way.
    const double way = way_to_top(r, mu);
    const double lowest = std::clamp(-r * mu, 0.0, way);
    AirColumns c;
    const auto leg = [&](double from, double to) {
      constexpr int kSteps = 80;
      for (int k = 0; k < kSteps; ++k) {
        const double s0 = static_cast<double>(k) / kSteps, s1 = static_cast<double>(k + 1) / kSteps;
        const double t0 = s0 * s0, t1 = s1 * s1;
        const double t = from + (to - from) * 0.5 * (t0 + t1);
        const auto n = densities(height_after(r, mu, t));
        const double dt = std::abs(to - from) * (t1 - t0);
        c.rayleigh_m += n.rayleigh_m * dt;
        c.aerosol_m += n.aerosol_m * dt;
        c.ozone_m += n.ozone_m * dt;
      }
    };
    leg(lowest, way);
    if (lowest > 0) leg(lowest, 0);
    return c;
  }
};

// ---------------------------------------------------------------- scattered more than once
constexpr int kMultipleHeights = 16, kMultipleSuns = 28;
constexpr double kLowestSun = -0.36;  // cosine: 21° below the horizon

/// Cells are close together near the horizon, where twilight changes fastest.
double sun_of_cell(double x) {
  const double s = 2 * x - 1;  // −1 … 1
  return s < 0 ? kLowestSun * s * s : s * s;
}
double cell_of_sun(double mu) {
  const double m = std::clamp(mu, kLowestSun, 1.0);
  return 0.5 * (1 + (m < 0 ? -std::sqrt(m / kLowestSun) : std::sqrt(m)));
}

double rayleigh_phase(double c) { return 3 / (16 * pi) * (1 + c * c); }
double three_halves(double x) { return x * std::sqrt(x); }
/// Cornette & Shanks 1992.
double aerosol_phase(double c) {
  const double g = kAerosolAsymmetry, g2 = g * g;
  return 3 / (8 * pi) * (1 - g2) * (1 + c * c) / ((2 + g2) * three_halves(1 + g2 - 2 * g * c));
}

constexpr int kAzimuths = 25;  // of a view, over half a turn

}  // namespace

AirColumns columns_to_space(double height_m, double cos_zenith) {
  static const ColumnTable table;
  const double r = kEarthRadius_m + std::clamp(height_m, 0.0, kAirTop_m - 1);
  const double rho = std::sqrt(std::max(0.0, r * r - kEarthRadius_m * kEarthRadius_m));
  const double mu = std::max(cos_zenith, cos_horizon(r));
  const double d = way_to_top(r, mu), shortest = kTop - r, longest = rho + kHorizon;
  const double u = std::clamp((d - shortest) / (longest - shortest), 0.0, 1.0) * (kCosines - 1);
  const double v = rho / kHorizon * (kHeights - 1);
  const int i = std::min(static_cast<int>(v), kHeights - 2), j = std::min(static_cast<int>(u), kCosines - 2);
  const double fi = v - i, fj = u - j;
  const AirColumns* c = &table.cells[static_cast<std::size_t>(i * kCosines + j)];
  const auto mix = [&](double AirColumns::*m) {
    return (c[0].*m * (1 - fj) + c[1].*m * fj) * (1 - fi) +
           (c[kCosines].*m * (1 - fj) + c[kCosines + 1].*m * fj) * fi;
  };
  return {mix(&AirColumns::rayleigh_m), mix(&AirColumns::aerosol_m), mix(&AirColumns::ozone_m)};
}

double sun_above_ground(double height_m, double cos_zenith) {
  const double r = kEarthRadius_m + std::max(height_m, 0.0);
  const double h = cos_horizon(r);
  const double above = (cos_zenith - h) / std::max(std::sqrt(1 - h * h), 0.1) / kSunRadius_rad;
  const double x = std::clamp(0.5 * (above + 1), 0.0, 1.0);
  return x * x * (3 - 2 * x);
}

AirCoefficients AirCoefficients::of(double turbidity) {
  const auto depths = optical_depths(turbidity);
  AirCoefficients c;
  for (int b = 0; b < kBandCount; ++b) {
    c.rayleigh[b] = depths.rayleigh[b] / kRayleighScaleHeight_m;
    c.aerosol_extinction[b] = depths.aerosol[b] / kAerosolScaleHeight_m;
    c.aerosol_scattering[b] = kAerosolAlbedo * c.aerosol_extinction[b];
    c.ozone[b] = depths.ozone[b] / kOzoneHalfWidth_m;
  }
  return c;
}

BandValues AirCoefficients::transmittance(const AirColumns& n) const {
  BandValues t{};
  for (int b = 0; b < kBandCount; ++b)
    t[b] =
        std::exp(-(rayleigh[b] * n.rayleigh_m + aerosol_extinction[b] * n.aerosol_m + ozone[b] * n.ozone_m));
  return t;
}

AirCoefficients::Scattered AirCoefficients::scattered(const AirColumns& n, double way_m,
                                                      BandValues& left) const {
  Scattered s;
  for (int b = 0; b < kBandCount; ++b) {
    const double by_air = rayleigh[b] * n.rayleigh_m, by_aerosol = aerosol_scattering[b] * n.aerosol_m;
    const double extinction = by_air + aerosol_extinction[b] * n.aerosol_m + ozone[b] * n.ozone_m;
    const double through = std::exp(-extinction * way_m);
    const double seen = left[b] * (extinction > 1e-15 ? (1 - through) / extinction : way_m);
    s.by_air[b] = by_air * seen;
    s.by_aerosol[b] = by_aerosol * seen;
    left[b] *= through;
  }
  return s;
}

ClearSky::ClearSky(double turbidity, const Spectrum& ground_albedo)
    : air_(AirCoefficients::of(turbidity)),
      multiple_(static_cast<std::size_t>(kMultipleHeights * kMultipleSuns)) {
  constexpr std::size_t kSteps = 14;
  constexpr int kRings = 10, kSpokes = 6;  // spokes: half a turn, the rest is its mirror image
  for (int i = 0; i < kMultipleHeights; ++i) {
    const double x = (i + 0.02) / (kMultipleHeights - 1);
    const double height = std::min(kAirTop_m * x * x, kAirTop_m - 10), r = kEarthRadius_m + height;
    // What is scattered on the way back along each ring's line of sight does not hang on the sun.
    struct Ring {
      double mu = 0, way = 0;
      bool down = false;
      BandValues left{};
      std::array<double, kSteps> t{}, h{};
      std::array<BandValues, kSteps> gained{};
    };
    std::array<Ring, kRings> rings;
    BandValues again{};
    for (int k = 0; k < kRings; ++k) {
      auto& ring = rings[static_cast<std::size_t>(k)];
      // Rings of equal solid angle; an even number keeps the horizon between two of them.
      ring.mu = 1 - 2 * (k + 0.5) / kRings;
      ring.down = ring.mu < cos_horizon(r);
      ring.way = ring.down ? way_to_ground(r, ring.mu) : way_to_top(r, ring.mu);
      ring.left.fill(1);
      for (std::size_t step = 0; step < kSteps; ++step) {
        const double s0 = static_cast<double>(step) / kSteps, s1 = static_cast<double>(step + 1) / kSteps;
        const double t0 = ring.way * s0 * s0, t1 = ring.way * s1 * s1;
        ring.t[step] = 0.5 * (t0 + t1);
        ring.h[step] = height_after(r, ring.mu, ring.t[step]);
        const auto part = air_.scattered(densities(ring.h[step]), t1 - t0, ring.left);
        for (int b = 0; b < kBandCount; ++b) {
          ring.gained[step][b] = part.by_air[b] + part.by_aerosol[b];
          again[b] += kSpokes * ring.gained[step][b];
        }
      }
    }
    for (int j = 0; j < kMultipleSuns; ++j) {
      const double mu_sun = sun_of_cell(static_cast<double>(j) / (kMultipleSuns - 1));
      const double sin_sun = std::sqrt(1 - mu_sun * mu_sun);
      BandValues second{};
      for (const auto& ring : rings) {
        const double sin_view = std::sqrt(1 - ring.mu * ring.mu);
        for (int spoke = 0; spoke < kSpokes; ++spoke) {
          const double cos_between =
              ring.mu * mu_sun + sin_view * sin_sun * std::cos(pi * (spoke + 0.5) / kSpokes);
          for (std::size_t k = 0; k < kSteps; ++k) {
            const double mu_there = (r * mu_sun + ring.t[k] * cos_between) / (kEarthRadius_m + ring.h[k]);
            const double lit = sun_above_ground(ring.h[k], mu_there);
            if (!(lit > 0)) continue;
            const auto sun = air_.transmittance(columns_to_space(ring.h[k], mu_there));
            for (int b = 0; b < kBandCount; ++b) second[b] += ring.gained[k][b] * lit * sun[b] / (4 * pi);
          }
          if (!ring.down) continue;
          const double mu_there = (r * mu_sun + ring.way * cos_between) / kEarthRadius_m;
          const double lit = sun_above_ground(0, mu_there) * std::max(mu_there, 0.0);
          if (!(lit > 0)) continue;
          const auto sun = air_.transmittance(columns_to_space(0, mu_there));
          for (int b = 0; b < kBandCount; ++b)
            second[b] += ring.left[b] * ground_albedo[b] / pi * sun[b] * lit;
        }
      }
      auto& cell = multiple_[static_cast<std::size_t>(i * kMultipleSuns + j)];
      for (int b = 0; b < kBandCount; ++b) {
        constexpr double kShare = 1.0 / (kRings * kSpokes);
        cell[b] = second[b] * kShare / (1 - std::min(again[b] * kShare, 0.95));
      }
    }
  }
}

BandValues ClearSky::multiple(double height_m, double cos_sun) const {
  const double v = std::clamp(std::sqrt(std::max(height_m, 0.0) / kAirTop_m) * (kMultipleHeights - 1) - 0.02,
                              0.0, kMultipleHeights - 1.0);
  const double u = cell_of_sun(cos_sun) * (kMultipleSuns - 1);
  const int i = std::min(static_cast<int>(v), kMultipleHeights - 2);
  const int j = std::min(static_cast<int>(u), kMultipleSuns - 2);
  const double fi = v - i, fj = u - j;
  const BandValues* c = &multiple_[static_cast<std::size_t>(i * kMultipleSuns + j)];
  BandValues m{};
  for (int b = 0; b < kBandCount; ++b)
    m[b] = (c[0][b] * (1 - fj) + c[1][b] * fj) * (1 - fi) +
           (c[kMultipleSuns][b] * (1 - fj) + c[kMultipleSuns + 1][b] * fj) * fi;
  return m;
}

ClearSky::View ClearSky::view(double sun_elevation_deg, double height_m, const BandValues& solar,
                              int rows) const {
  constexpr std::size_t kSteps = 30;
  View view;
  view.rows_ = rows;
  view.sun_elevation_rad_ = sun_elevation_deg * pi / 180;
  view.nodes_.resize(static_cast<std::size_t>(rows * kAzimuths));
  const double mu_sun = std::sin(view.sun_elevation_rad_), sin_sun = std::cos(view.sun_elevation_rad_);
  const double r = kEarthRadius_m + std::clamp(height_m, 0.0, 20'000.0);
  struct Step {
    double t = 0, h = 0;
    AirCoefficients::Scattered part{};
  };
  std::array<Step, kSteps> steps;
  for (int row = 0; row < rows; ++row) {
    const double elevation = (row + 0.5) * pi / 2 / rows;
    const double mu = std::sin(elevation), sin_view = std::cos(elevation);
    const double way = way_to_top(r, mu);
    BandValues left = solar;
    for (std::size_t k = 0; k < kSteps; ++k) {
      const double s0 = static_cast<double>(k) / kSteps, s1 = static_cast<double>(k + 1) / kSteps;
      const double t0 = way * s0 * s0, t1 = way * s1 * s1;
      auto& step = steps[k];
      step.t = 0.5 * (t0 + t1);
      step.h = height_after(r, mu, step.t);
      step.part = air_.scattered(densities(step.h), t1 - t0, left);
    }
    for (int a = 0; a < kAzimuths; ++a) {
      auto& node = view.nodes_[static_cast<std::size_t>(row * kAzimuths + a)];
      const double cos_between = mu * mu_sun + sin_view * sin_sun * std::cos(pi * a / (kAzimuths - 1));
      for (const auto& step : steps) {
        const double mu_there = (r * mu_sun + step.t * cos_between) / (kEarthRadius_m + step.h);
        const auto spread = multiple(step.h, mu_there);
        const double lit = sun_above_ground(step.h, mu_there);
        if (lit > 0) {
          const auto sun = air_.transmittance(columns_to_space(step.h, mu_there));
          for (int b = 0; b < kBandCount; ++b) {
            node.rayleigh[b] += step.part.by_air[b] * sun[b] * lit;
            node.aerosol[b] += step.part.by_aerosol[b] * sun[b] * lit;
          }
        }
        for (int b = 0; b < kBandCount; ++b)
          node.multiple[b] += (step.part.by_air[b] + step.part.by_aerosol[b]) * spread[b];
      }
    }
  }
  return view;
}

Spectrum ClearSky::View::radiance(int row, double relative_azimuth_rad) const {
  const double turn = std::abs(std::remainder(relative_azimuth_rad, 2 * pi));
  const double u = turn / pi * (kAzimuths - 1);
  const int a = std::min(static_cast<int>(u), kAzimuths - 2);
  const double f = u - a;
  const double elevation = (row + 0.5) * pi / 2 / rows_;
  const double cos_between =
      std::sin(elevation) * std::sin(sun_elevation_rad_) +
      std::cos(elevation) * std::cos(sun_elevation_rad_) * std::cos(relative_azimuth_rad);
  const double by_air = rayleigh_phase(cos_between), by_aerosol = aerosol_phase(cos_between);
  const Node* n = &nodes_[static_cast<std::size_t>(row * kAzimuths + a)];
  Spectrum s{};
  for (int b = 0; b < kBandCount; ++b)
    s[b] = static_cast<float>(
        ((n[0].rayleigh[b] * by_air + n[0].aerosol[b] * by_aerosol + n[0].multiple[b]) * (1 - f) +
         (n[1].rayleigh[b] * by_air + n[1].aerosol[b] * by_aerosol + n[1].multiple[b]) * f));
  return s;
}

}  // namespace rigor::nature
