#include "sim/gis/grid.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <thread>

#include "rt-core/numbers.h"

namespace rigor::gis {
namespace {

using world::Vector3;

constexpr double kEarth_m = 6'371'000;
constexpr std::int64_t kChunkRows =
    16;  // what comes out does not depend on the number of threads, only on this

// Runs `work(first row, last row + 1)` for every chunk of rows on all cores; progress on this thread.
template <class MakeWorker>
void for_chunks(std::int64_t rows, const Progress& progress, MakeWorker&& make_worker) {
  std::atomic<std::int64_t> next{0};
  const std::int64_t chunks = (rows + kChunkRows - 1) / kChunkRows;
  const auto run = [&](bool tells) {
    auto work = make_worker();
    for (std::int64_t c; (c = next.fetch_add(1)) < chunks;) {
      work(c * kChunkRows, std::min(rows, (c + 1) * kChunkRows));
      if (tells && progress) progress(static_cast<double>(c + 1) / static_cast<double>(chunks));
    }
  };
  const unsigned helpers = std::min<unsigned>(std::max(1u, std::thread::hardware_concurrency()), 16) - 1;
  std::vector<std::jthread> threads;
  if (chunks > 1)
    for (unsigned i = 0; i < helpers; ++i) threads.emplace_back([&] { run(false); });
  run(true);
}

std::vector<Raster::Probe> probes_of(const Rasters& rasters) {
  std::vector<Raster::Probe> probes;
  probes.reserve(rasters.size());
  for (const auto& r : rasters) probes.emplace_back(*r);
  return probes;
}

Status status_of(const Rasters& rasters) {
  for (const auto& r : rasters)
    if (auto s = r->status(); !s) return s;
  return {};
}

}  // namespace

// Heights of the first raster that has any, for all places.
class Mosaic {
 public:
  explicit Mosaic(const Rasters& rasters) : probes_(probes_of(rasters)) {}
  void heights(std::span<const double> lat, std::span<const double> lon, std::span<double> out) {
    std::fill(out.begin(), out.end(), kNaN);
    // The rim of a raster and of its holes, half a pixel wide, is left to the others first: where rasters
    // overlap, no seam shows.
    const bool several = probes_.size() > 1;
    if (several)
      for (auto& probe : probes_) fill(probe, lat, lon, out, true);
    for (auto& probe : probes_) fill(probe, lat, lon, out, false);
  }

 private:
  void fill(Raster::Probe& probe, std::span<const double> lat, std::span<const double> lon,
            std::span<double> out, bool whole) {
    index_.clear(), lat_.clear(), lon_.clear();
    for (std::size_t i = 0; i < out.size(); ++i)
      if (std::isnan(out[i])) index_.push_back(i), lat_.push_back(lat[i]), lon_.push_back(lon[i]);
    if (index_.empty()) return;
    more_.resize(index_.size());
    probe.heights(lat_, lon_, more_, whole);
    for (std::size_t k = 0; k < index_.size(); ++k) out[index_[k]] = more_[k];
  }
  std::vector<Raster::Probe> probes_;
  std::vector<std::size_t> index_;
  std::vector<double> lat_, lon_, more_;
};

Result<Grid> plan_grid(const LocalFrame& frame, const Rasters& rasters, std::optional<double> half_extent_m,
                       double spacing_m) {
  constexpr double kFarthest_m = 1e6;
  constexpr double kMostCells = 64e6;
  Grid grid;
  grid.spacing_m = spacing_m;
  if (spacing_m <= 0) {
    double finest = std::numeric_limits<double>::infinity();
    for (const auto& r : rasters) finest = std::min(finest, r->pixel_m());
    if (!std::isfinite(finest)) finest = 1;
    // Three digits, rounded down: 9.996 m of a projection becomes 9.99 m, and a world's file stays readable.
    const double digit = std::pow(10, std::floor(std::log10(finest)) - 2);
    grid.spacing_m = std::floor(finest / digit + 1e-6) * digit;
  }
  double west = 0, east = 0, south = 0, north = 0;
  if (half_extent_m) {
    const double reach = std::floor(*half_extent_m / grid.spacing_m + 1e-9) * grid.spacing_m;
    west = south = -reach;
    east = north = reach;
  } else {
    west = south = std::numeric_limits<double>::infinity();
    east = north = -west;
    for (const auto& r : rasters)
      for (GeoPoint p : r->border()) {
        p.height_m = frame.anchor().height_m;
        const Vector3 v = frame.to_world(p);
        if (v.z() < -kEarth_m / 2)
          return fail(ErrorCode::bad_input, r->file(),
                      "expected sources around the anchor, got one that reaches around the earth: give "
                      "half_extent_m");
        west = std::min(west, v.x()), east = std::max(east, v.x());
        south = std::min(south, v.y()), north = std::max(north, v.y());
      }
    west = std::ceil(west / grid.spacing_m - 1e-6) * grid.spacing_m;
    north = std::floor(north / grid.spacing_m + 1e-6) * grid.spacing_m;
  }
  const std::string where = rasters.empty() ? "half_extent_m" : rasters.front()->file();
  if (std::max({-west, east, -south, north}) > kFarthest_m)
    return fail(
        ErrorCode::bad_input, where,
        "expected an extent within 1000 km of the anchor, got more: give half_extent_m, or another anchor");
  const double columns = std::floor((east - west) / grid.spacing_m + 1e-6) + 1;
  const double rows = std::floor((north - south) / grid.spacing_m + 1e-6) + 1;
  if (columns * rows > kMostCells || columns > 100'000 || rows > 100'000)
    return fail(
        ErrorCode::bad_input, where,
        fmt::format(
            "expected a grid of at most 64 million cells, got {:.0f} x {:.0f} at {} m: give a coarser "
            "spacing_m or a smaller half_extent_m",
            columns, rows, grid.spacing_m));
  grid.columns = static_cast<std::int64_t>(std::max(columns, 1.0));
  grid.rows = static_cast<std::int64_t>(std::max(rows, 1.0));
  grid.x_m = west;
  grid.y_m = north;
  for (const auto& r : rasters)
    r->reduce(static_cast<int>(std::clamp(std::floor(grid.spacing_m / r->pixel_m() + 0.01), 1.0, 10'000.0)));
  return grid;
}

void Ground::use(const Rasters* rasters) { rasters_ = rasters; }
void Ground::use(Grid grid, std::vector<float> z_m) { keep(grid, std::move(z_m)); }

Result<std::vector<float>> Ground::z_grid(const Grid& grid, const Progress& progress) const {
  std::vector<float> z_m(grid.cells(), std::numeric_limits<float>::quiet_NaN());
  const auto columns = static_cast<std::size_t>(grid.columns);
  for_chunks(grid.rows, progress, [&] {
    return [&, mosaic = Mosaic(*rasters_), z = std::vector<double>(columns), lat = std::vector<double>(),
            lon = std::vector<double>(), h = std::vector<double>(), ground = std::vector<double>(),
            active = std::vector<std::size_t>()](std::int64_t first, std::int64_t end) mutable {
      // A cell's z and the place that it asks the raster for depend on each other: the frame's up leans
      // against the plumb line by distance/radius. What a step of z moves the place by is that share of it,
      // so a step or two reach a tenth of a millimetre; the row above is the first guess.
      for (std::int64_t row = first; row < end; ++row) {
        const double y = grid.y_m - static_cast<double>(row) * grid.spacing_m;
        if (row == first)
          for (std::size_t c = 0; c < columns; ++c) {
            const double x = grid.x_m + static_cast<double>(c) * grid.spacing_m;
            z[c] = -(x * x + y * y) / (2 * kEarth_m);
          }
        active.resize(columns);
        for (std::size_t c = 0; c < columns; ++c) active[c] = c;
        for (int step = 0; step < 10 && !active.empty(); ++step) {
          const std::size_t n = active.size();
          lat.resize(n), lon.resize(n), h.resize(n), ground.resize(n);
          for (std::size_t k = 0; k < n; ++k) {
            const double x = grid.x_m + static_cast<double>(active[k]) * grid.spacing_m;
            const GeoPoint p = frame_.to_geo({x, y, z[active[k]]});
            lat[k] = p.latitude_deg, lon[k] = p.longitude_deg, h[k] = p.height_m;
          }
          mosaic.heights(lat, lon, ground);
          std::size_t left = 0;
          for (std::size_t k = 0; k < n; ++k) {
            const std::size_t c = active[k];
            const double x = grid.x_m + static_cast<double>(c) * grid.spacing_m;
            const double lean = std::sqrt(x * x + y * y) / kEarth_m;
            float& out = z_m[static_cast<std::size_t>(row) * columns + c];
            if (std::isnan(ground[k])) {
              out = std::numeric_limits<float>::quiet_NaN();
              // Seen from the guess's place; at the height of the anchor it may lie elsewhere. Once more
              // there.
              if (step == 0 && lean > 1e-4) {
                z[c] = -(x * x + y * y) / (2 * kEarth_m);
                active[left++] = c;
              }
              continue;
            }
            const double change = (ground[k] - h[k]) / std::sqrt(std::max(0.01, 1 - lean * lean));
            z[c] += change;
            out = static_cast<float>(z[c]);
            if (std::abs(change) * lean * 2 > 1e-4) active[left++] = c;
          }
          active.resize(left);
        }
      }
    };
  });
  if (auto s = status_of(*rasters_); !s) return tl::unexpected(s.error());
  return z_m;
}

double Ground::z_at(double x_m, double y_m) const {
  if (!z_m_.empty()) {
    const double u = (x_m - grid_.x_m) / grid_.spacing_m, v = (grid_.y_m - y_m) / grid_.spacing_m;
    const double c = std::clamp(u, 0.0, static_cast<double>(grid_.columns - 1));
    const double r = std::clamp(v, 0.0, static_cast<double>(grid_.rows - 1));
    if (std::abs(c - u) <= 0.75 && std::abs(r - v) <= 0.75) {
      const auto c0 = static_cast<std::int64_t>(c), r0 = static_cast<std::int64_t>(r);
      const auto c1 = std::min(c0 + 1, grid_.columns - 1), r1 = std::min(r0 + 1, grid_.rows - 1);
      const double a = c - static_cast<double>(c0), b = r - static_cast<double>(r0);
      const auto at = [&](std::int64_t column, std::int64_t row) {
        return static_cast<double>(z_m_[static_cast<std::size_t>(row * grid_.columns + column)]);
      };
      const double z =
          (1 - b) * ((1 - a) * at(c0, r0) + a * at(c1, r0)) + b * ((1 - a) * at(c0, r1) + a * at(c1, r1));
      if (!std::isnan(z)) return z;
      const double nearest = at(a < 0.5 ? c0 : c1, b < 0.5 ? r0 : r1);
      if (!std::isnan(nearest)) return nearest;
    }
  }
  return frame_.z_at_height(x_m, y_m, frame_.anchor().height_m);
}

Status Ground::heights_at(std::span<const GeoPoint> places, std::span<double> heights_m) const {
  const std::size_t n = places.size();
  if (rasters_) {
    std::vector<double> lat(n), lon(n);
    for (std::size_t i = 0; i < n; ++i) lat[i] = places[i].latitude_deg, lon[i] = places[i].longitude_deg;
    if (!mosaic_) mosaic_ = std::make_shared<Mosaic>(*rasters_);
    mosaic_->heights(lat, lon, heights_m);
    if (auto s = status_of(*rasters_); !s) return s;
    for (double& h : heights_m)
      if (std::isnan(h)) h = frame_.anchor().height_m;
    return {};
  }
  for (std::size_t i = 0; i < n; ++i) {
    heights_m[i] = frame_.anchor().height_m;
    if (z_m_.empty()) continue;
    for (int step = 0; step < 4; ++step) {
      const Vector3 v = frame_.to_world({places[i].latitude_deg, places[i].longitude_deg, heights_m[i]});
      heights_m[i] = frame_.to_geo({v.x(), v.y(), z_at(v.x(), v.y())}).height_m;
    }
  }
  return {};
}

namespace {

// Where the cells of a row lie on the ellipsoid, on the ground.
void places_of_row(const Grid& grid, const Ground& ground, std::int64_t row, std::vector<double>& lat,
                   std::vector<double>& lon) {
  const double y = grid.y_m - static_cast<double>(row) * grid.spacing_m;
  lat.resize(static_cast<std::size_t>(grid.columns));
  lon.resize(lat.size());
  for (std::size_t c = 0; c < lat.size(); ++c) {
    const double x = grid.x_m + static_cast<double>(c) * grid.spacing_m;
    const GeoPoint p = ground.frame().to_geo({x, y, ground.z_at(x, y)});
    lat[c] = p.latitude_deg;
    lon[c] = p.longitude_deg;
  }
}

}  // namespace

Result<std::vector<std::byte>> picture_grid(const Grid& grid, const Ground& ground, const Rasters& rasters,
                                            const Progress& progress) {
  std::vector<std::byte> rgb(grid.cells() * 3);
  const auto columns = static_cast<std::size_t>(grid.columns);
  for_chunks(grid.rows, progress, [&] {
    return [&, probes = probes_of(rasters), lat = std::vector<double>(), lon = std::vector<double>(),
            values = std::vector<float>(columns * 3)](std::int64_t first, std::int64_t end) mutable {
      for (std::int64_t row = first; row < end; ++row) {
        places_of_row(grid, ground, row, lat, lon);
        std::byte* const out = rgb.data() + static_cast<std::size_t>(row) * columns * 3;
        std::vector<bool> has(columns);
        for (auto& probe : probes) {
          probe.values(lat, lon, values);
          for (std::size_t c = 0; c < columns; ++c) {
            if (has[c] || std::isnan(values[c * 3])) continue;
            has[c] = true;
            long v[3];
            for (int k = 0; k < 3; ++k) v[k] = std::clamp(std::lround(values[c * 3 + k]), 0L, 255L);
            if (v[0] == 0 && v[1] == 0 && v[2] == 0) v[0] = v[1] = v[2] = 1;
            for (int k = 0; k < 3; ++k) out[c * 3 + k] = static_cast<std::byte>(v[k]);
          }
        }
      }
    };
  });
  if (auto s = status_of(rasters); !s) return tl::unexpected(s.error());
  return rgb;
}

Result<std::vector<CoverCell>> cover_grid(const Grid& grid, const Ground& ground, const Rasters& rasters,
                                          const Progress& progress) {
  std::vector<CoverCell> cells(grid.cells());
  const auto columns = static_cast<std::size_t>(grid.columns);
  for_chunks(grid.rows, progress, [&] {
    return [&, probes = probes_of(rasters), lat = std::vector<double>(), lon = std::vector<double>(),
            values = std::vector<float>(columns)](std::int64_t first, std::int64_t end) mutable {
      for (std::int64_t row = first; row < end; ++row) {
        places_of_row(grid, ground, row, lat, lon);
        CoverCell* const out = cells.data() + static_cast<std::size_t>(row) * columns;
        for (std::size_t p = 0; p < probes.size(); ++p) {
          probes[p].values(lat, lon, values);
          for (std::size_t c = 0; c < columns; ++c)
            if (out[c].raster < 0 && !std::isnan(values[c]))
              out[c] = {static_cast<std::int32_t>(p), values[c]};
        }
      }
    };
  });
  if (auto s = status_of(rasters); !s) return tl::unexpected(s.error());
  return cells;
}

}  // namespace rigor::gis
