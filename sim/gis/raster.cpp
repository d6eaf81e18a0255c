#include "sim/gis/raster.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

namespace rigor::gis {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();

struct Unit {
  const char* name;
  double metres;
};
constexpr Unit kUnits[] = {{"", 1},
                           {"m", 1},
                           {"metre", 1},
                           {"meter", 1},
                           {"metres", 1},
                           {"meters", 1},
                           {"ft", 0.3048},
                           {"foot", 0.3048},
                           {"feet", 0.3048},
                           {"cm", 0.01},
                           {"mm", 0.001},
                           {"km", 1000},
                           {"US survey foot", 1200.0 / 3937},
                           {"ftUS", 1200.0 / 3937},
                           {"us-ft", 1200.0 / 3937}};

}  // namespace

Result<std::unique_ptr<Raster>> Raster::open(const std::string& file, const ImportSource& source, Use use) {
  auto dataset = open_dataset(file, GDAL_OF_RASTER);
  if (!dataset) return tl::unexpected(dataset.error());
  std::unique_ptr<Raster> r(new Raster);
  r->file_ = file;
  r->use_ = use;
  r->dataset_ = std::move(*dataset);
  if (auto s = r->set_up_bands(source); !s) return tl::unexpected(s.error());
  if (auto s = r->set_up_place(source); !s) return tl::unexpected(s.error());
  r->reduce(1);
  return r;
}

Status Raster::set_up_bands(const ImportSource& source) {
  const int bands = dataset_->GetRasterCount();
  if (bands < 1)
    return fail(
        ErrorCode::bad_input, file_,
        "expected a raster with at least one band, got none (a container: give one of its subdatasets)");
  GDALRasterBand& band = *dataset_->GetRasterBand(1);
  if (use_ == Use::imagery) {
    channels_ = 3;
    if (bands == 2)
      if (dataset_->GetRasterBand(2)->GetColorInterpretation() != GCI_AlphaBand)
        return fail(ErrorCode::bad_input, file_, "expected a picture of 1 (grey), 3 or 4 bands, got 2");
    for (int b = 1; b <= std::min(bands, 3); ++b)
      if (const auto type = dataset_->GetRasterBand(b)->GetRasterDataType(); type != GDT_Byte)
        return fail(
            ErrorCode::bad_input, file_,
            fmt::format(
                "expected a picture of 8 bits a band, got {}: gdal_translate -ot Byte -scale makes one",
                GDALGetDataTypeName(type)));
    return {};
  }
  if (GDALDataTypeIsComplex(band.GetRasterDataType()))
    return fail(ErrorCode::bad_input, file_, "expected a raster of real numbers, got complex ones");
  if (use_ == Use::land_cover) {
    if (band.GetColorInterpretation() == GCI_RedBand)
      return fail(ErrorCode::bad_input, file_, "expected one band of class values, got a picture in colour");
    if (char** names = band.GetCategoryNames())
      for (; *names; ++names) categories_.emplace_back(*names);
    return {};
  }
  const std::string unit = band.GetUnitType() ? band.GetUnitType() : "";
  const auto* known =
      std::find_if(std::begin(kUnits), std::end(kUnits), [&](const Unit& u) { return unit == u.name; });
  if (known == std::end(kUnits))
    return fail(ErrorCode::bad_input, file_,
                fmt::format("expected heights in metres or feet, got the unit '{}'", unit));
  unit_m_ = known->metres;
  above_geoid_ = source.heights_above_geoid;
  if (above_geoid_) {
    auto t = geoid_transformation();
    if (!t) return tl::unexpected(t.error());
    geoid_ = std::move(*t);
  }
  return {};
}

Status Raster::set_up_place(const ImportSource& source) {
  std::array<double, 6> to_crs{};
  GdalMessages messages;
  if (dataset_->GetGeoTransform(to_crs.data()) != CE_None)
    return fail(ErrorCode::bad_input, file_,
                dataset_->GetGCPCount() > 0
                    ? "expected a raster with a geotransform, got ground control points: gdalwarp makes one"
                    : "expected a raster with a place (a geotransform or a world file), got none");
  if (!GDALInvGeoTransform(to_crs.data(), from_crs_.data()))
    return fail(ErrorCode::bad_input, file_,
                "expected a geotransform that can be inverted, got a singular one");

  const std::string where = file_;
  OGRSpatialReference crs;
  if (!source.crs.empty()) {
    auto given = parse_crs(source.crs, where + ": crs");
    if (!given) return tl::unexpected(given.error());
    crs = *given;
  } else if (const OGRSpatialReference* own = dataset_->GetSpatialRef(); own && !own->IsLocal()) {
    crs = *own;
  } else {
    return fail(ErrorCode::bad_input, file_,
                "expected a reference system, the raster has none: give it as crs (such as EPSG:25832)");
  }
  crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  if (crs.IsCompound()) {
    if (use_ == Use::elevation && !above_geoid_)
      warnings_.push_back(
          fmt::format("{}: its reference system says what its heights count from ({}); they are taken as "
                      "above the ellipsoid. Say "
                      "heights_above_geoid: true where that is a geoid",
                      file_, crs.GetName()));
    crs.StripVertical();
  }
  auto to_geo = transformation(crs, wgs84(), where), to_raster = transformation(wgs84(), crs, where);
  if (!to_geo) return tl::unexpected(to_geo.error());
  if (!to_raster) return tl::unexpected(to_raster.error());
  to_raster_ = std::move(*to_raster);

  const double width = dataset_->GetRasterXSize(), height = dataset_->GetRasterYSize();
  const auto place = [&](double column, double row) -> std::optional<GeoPoint> {
    double x = to_crs[0] + column * to_crs[1] + row * to_crs[2];
    double y = to_crs[3] + column * to_crs[4] + row * to_crs[5];
    if (!(*to_geo)->Transform(1, &x, &y) || !std::isfinite(x) || !std::isfinite(y) || std::abs(y) > 90 + 1e-6)
      return std::nullopt;
    return GeoPoint{std::clamp(y, -90.0, 90.0), x, 0};
  };
  if (crs.IsGeographic()) {
    wrap_ = 2 * M_PI / crs.GetAngularUnits();
    wrap_centre_ = to_crs[0] + width / 2 * to_crs[1] + height / 2 * to_crs[2];
    around_ = to_crs[2] == 0 && to_crs[4] == 0 &&
              std::abs(width * std::abs(to_crs[1]) - wrap_) < std::abs(to_crs[1]) / 2;
    const OGRSpatialReference reference = wgs84();
    const char* const ignore_names[] = {"IGNORE_DATA_AXIS_TO_SRS_AXIS_MAPPING=YES", nullptr};
    same_as_wgs84_ = crs.IsSame(&reference, ignore_names);
  }
  const auto centre = place(width / 2, height / 2);
  const auto right = place(width / 2 + 1, height / 2), below = place(width / 2, height / 2 + 1);
  for (int side = 0; side < 4; ++side)
    for (int i = 0; i < 32; ++i) {
      const double t = i / 32.0;
      const auto p = side == 0   ? place(t * width, 0)
                     : side == 1 ? place(width, t * height)
                     : side == 2 ? place((1 - t) * width, height)
                                 : place(0, (1 - t) * height);
      if (p) border_.push_back(*p);
    }
  if (!centre || !right || !below || border_.empty())
    return fail(
        ErrorCode::bad_input, file_,
        fmt::format("expected a raster that lies on the earth, got coordinates outside of what {} can do: "
                    "is the reference system right?",
                    crs.GetName() ? crs.GetName() : "its reference system"));
  centre_ = *centre;
  const LocalFrame here({centre_.latitude_deg, centre_.longitude_deg, 0});
  pixel_m_ = std::min(here.to_world(*right).head<2>().norm(), here.to_world(*below).head<2>().norm());
  if (pixel_m_ <= 0) pixel_m_ = here.to_world(*right).head<2>().norm();
  return {};
}

void Raster::reduce(int factor) {
  factor_ = std::max(1, factor);
  columns_ = (dataset_->GetRasterXSize() + factor_ - 1) / factor_;
  rows_ = (dataset_->GetRasterYSize() + factor_ - 1) / factor_;
  tiles_across_ = (columns_ + kTile - 1) / kTile;
  const auto count = static_cast<std::size_t>(tiles_across_ * ((rows_ + kTile - 1) / kTile));
  tiles_.clear();
  tiles_.resize(count);
  ready_ = std::make_unique<std::atomic<const float*>[]>(count);
  for (std::size_t i = 0; i < count; ++i) ready_[i].store(nullptr, std::memory_order_relaxed);
}

Status Raster::status() const {
  const std::lock_guard lock(reading_);
  return status_;
}

// Reads source pixels, channel-interleaved, NaN where there is no data. Under the lock.
void Raster::read_strip(int x, int y, int width, int height, std::vector<float>& pixels) {
  const auto n = static_cast<std::size_t>(width) * height, channels = static_cast<std::size_t>(channels_);
  pixels.assign(n * channels, kNone);
  if (!status_) return;
  GdalMessages messages;
  const auto broken = [&] {
    status_ = fail(ErrorCode::bad_input, file_,
                   fmt::format("expected pixels in rows {} to {}, the file is cut short or broken: {}", y,
                               y + height - 1, messages.text()));
  };
  const int bands = dataset_->GetRasterCount();
  if (use_ != Use::imagery) {
    GDALRasterBand& band = *dataset_->GetRasterBand(1);
    std::vector<double> raw(n);
    if (band.RasterIO(GF_Read, x, y, width, height, raw.data(), width, height, GDT_Float64, 0, 0, nullptr) !=
            CE_None ||
        messages.failed())
      return broken();
    std::vector<std::uint8_t> mask;
    if (band.GetMaskFlags() & (GMF_PER_DATASET | GMF_ALPHA)) {
      mask.resize(n);
      if (band.GetMaskBand()->RasterIO(GF_Read, x, y, width, height, mask.data(), width, height, GDT_Byte, 0,
                                       0, nullptr) != CE_None ||
          messages.failed())
        return broken();
    }
    int has_nodata = 0;
    const double nodata = band.GetNoDataValue(&has_nodata), scale = band.GetScale(),
                 offset = band.GetOffset();
    const bool float32 = band.GetRasterDataType() == GDT_Float32;
    for (std::size_t i = 0; i < n; ++i) {
      const double v = raw[i];
      const bool none =
          !std::isfinite(v) || (!mask.empty() && mask[i] == 0) ||
          (has_nodata && (v == nodata || (float32 && static_cast<float>(v) == static_cast<float>(nodata))));
      if (!none) pixels[i] = static_cast<float>(use_ == Use::elevation ? (v * scale + offset) * unit_m_ : v);
    }
    return;
  }
  std::vector<std::uint8_t> raw(n), valid(n, 0);
  const bool colour_table = bands == 1 && dataset_->GetRasterBand(1)->GetColorTable();
  for (std::size_t c = 0; c < 3; ++c) {
    GDALRasterBand& band = *dataset_->GetRasterBand(bands >= 3 ? static_cast<int>(c) + 1 : 1);
    if (band.RasterIO(GF_Read, x, y, width, height, raw.data(), width, height, GDT_Byte, 0, 0, nullptr) !=
            CE_None ||
        messages.failed())
      return broken();
    for (std::size_t i = 0; i < n; ++i) {
      float v = raw[i];
      if (colour_table)
        if (const GDALColorEntry* e = band.GetColorTable()->GetColorEntry(raw[i]))
          v = c == 0 ? e->c1 : c == 1 ? e->c2 : e->c3;
      pixels[i * 3 + c] = v;
    }
    if (band.GetMaskFlags() & GMF_ALL_VALID) {
      std::fill(valid.begin(), valid.end(), std::uint8_t{1});
    } else {
      if (band.GetMaskBand()->RasterIO(GF_Read, x, y, width, height, raw.data(), width, height, GDT_Byte, 0,
                                       0, nullptr) != CE_None ||
          messages.failed())
        return broken();
      // A pixel has data where any of its bands has: a band's nodata value is a good colour in the others.
      for (std::size_t i = 0; i < n; ++i) valid[i] |= raw[i] != 0;
    }
  }
  for (std::size_t i = 0; i < n; ++i)
    if (!valid[i]) pixels[i * 3] = pixels[i * 3 + 1] = pixels[i * 3 + 2] = kNone;
}

const float* Raster::load(std::size_t index) {
  const std::lock_guard lock(reading_);
  if (const float* p = ready_[index].load(std::memory_order_acquire)) return p;
  const auto channels = static_cast<std::size_t>(channels_);
  tiles_[index] = std::make_unique<float[]>(std::size_t{kTile} * kTile * channels);
  float* const out = tiles_[index].get();
  std::fill_n(out, std::size_t{kTile} * kTile * channels, kNone);
  const auto tile_x = static_cast<int>(static_cast<std::int64_t>(index) % tiles_across_) * kTile;
  const auto tile_y = static_cast<int>(static_cast<std::int64_t>(index) / tiles_across_) * kTile;
  const int width = static_cast<int>(std::min<std::int64_t>(kTile, columns_ - tile_x));
  const int height = static_cast<int>(std::min<std::int64_t>(kTile, rows_ - tile_y));
  std::vector<float> pixels;
  const int x0 = tile_x * factor_, x1 = std::min((tile_x + width) * factor_, dataset_->GetRasterXSize());
  const int strip = factor_ == 1 ? height : 1;  // reduced rows in one read
  for (int row = 0; row < height; row += strip) {
    const int y0 = (tile_y + row) * factor_;
    const int y1 = std::min((tile_y + row + strip) * factor_, dataset_->GetRasterYSize());
    read_strip(x0, y0, x1 - x0, y1 - y0, pixels);
    const auto across = static_cast<std::size_t>(x1 - x0);
    if (factor_ == 1) {
      for (int r = 0; r < height; ++r)
        std::copy_n(pixels.data() + r * across * channels, across * channels, out + r * kTile * channels);
      continue;
    }
    for (int column = 0; column < width; ++column)
      for (std::size_t c = 0; c < channels; ++c) {
        double sum = 0;
        int count = 0;
        std::map<float, int> votes;
        for (int y = 0; y < y1 - y0; ++y)
          for (int x = column * factor_; x < std::min((column + 1) * factor_, x1 - x0); ++x) {
            const float v = pixels[(y * across + x) * channels + c];
            if (std::isnan(v)) continue;
            sum += v;
            ++count;
            if (use_ == Use::land_cover) ++votes[v];
          }
        if (count == 0) continue;
        float& target = out[(static_cast<std::size_t>(row) * kTile + column) * channels + c];
        target = static_cast<float>(sum / count);
        if (use_ == Use::land_cover)
          target = std::max_element(votes.begin(), votes.end(), [](const auto& a, const auto& b) {
                     return a.second < b.second;
                   })->first;
      }
  }
  ready_[index].store(out, std::memory_order_release);
  return out;
}

const float* Raster::pixel(std::int64_t column, std::int64_t row) {
  if (around_) column = ((column % columns_) + columns_) % columns_;
  if (column < 0 || row < 0 || column >= columns_ || row >= rows_) return nullptr;
  const auto index = static_cast<std::size_t>(row / kTile * tiles_across_ + column / kTile);
  const float* t = ready_[index].load(std::memory_order_acquire);
  if (!t) t = load(index);
  return t + ((row % kTile) * kTile + column % kTile) * channels_;
}

void Raster::bilinear(double column, double row, int channels, bool whole, float* out) {
  std::fill_n(out, channels, kNone);
  if (!(column >= -1 && column <= static_cast<double>(columns_) + 1 && row >= -1 &&
        row <= static_cast<double>(rows_) + 1))
    return;
  const auto nearest_column = static_cast<std::int64_t>(std::floor(column));
  const auto nearest_row = static_cast<std::int64_t>(std::floor(row));
  const float* nearest = pixel(nearest_column, nearest_row);
  if (!nearest || std::isnan(nearest[0])) return;
  const double u = column - 0.5, v = row - 0.5;
  const double fu = std::floor(u), fv = std::floor(v), au = u - fu, av = v - fv;
  const auto c0 = static_cast<std::int64_t>(fu), r0 = static_cast<std::int64_t>(fv);
  double sum[3] = {0, 0, 0}, weights = 0;
  for (int k = 0; k < 4; ++k) {
    const double w = ((k & 1) ? au : 1 - au) * ((k & 2) ? av : 1 - av);
    if (w <= 0) continue;
    const float* p = pixel(c0 + (k & 1), r0 + (k >> 1));
    if (!p || std::isnan(p[0])) {
      if (whole) return;
      continue;
    }
    weights += w;
    for (int c = 0; c < channels; ++c) sum[c] += w * p[c];
  }
  for (int c = 0; c < channels; ++c) out[c] = static_cast<float>(sum[c] / weights);
}

Raster::Probe::Probe(Raster& raster) : r_(raster) {
  to_raster_.reset(raster.to_raster_->Clone());
  if (raster.geoid_) geoid_.reset(raster.geoid_->Clone());
}

void Raster::Probe::to_pixels(std::span<const double> latitude_deg, std::span<const double> longitude_deg) {
  const std::size_t n = latitude_deg.size();
  x_.assign(longitude_deg.begin(), longitude_deg.end());
  y_.assign(latitude_deg.begin(), latitude_deg.end());
  if (!r_.same_as_wgs84_) {
    ok_.resize(n);
    to_raster_->Transform(static_cast<int>(n), x_.data(), y_.data(), nullptr, ok_.data());
    for (std::size_t i = 0; i < n; ++i)
      if (!ok_[i]) x_[i] = y_[i] = std::numeric_limits<double>::quiet_NaN();
  }
  const auto& g = r_.from_crs_;
  const double shrink = 1.0 / r_.factor_;
  for (std::size_t i = 0; i < n; ++i) {
    double x = x_[i];
    if (r_.wrap_ > 0) x -= r_.wrap_ * std::round((x - r_.wrap_centre_) / r_.wrap_);
    const double column = g[0] + x * g[1] + y_[i] * g[2], row = g[3] + x * g[4] + y_[i] * g[5];
    x_[i] = column * shrink;
    y_[i] = row * shrink;
  }
}

void Raster::Probe::heights(std::span<const double> latitude_deg, std::span<const double> longitude_deg,
                            std::span<double> out, bool whole) {
  const GdalMessages messages;
  const std::size_t n = out.size();
  to_pixels(latitude_deg, longitude_deg);
  for (std::size_t i = 0; i < n; ++i) {
    float v = kNone;
    r_.bilinear(x_[i], y_[i], 1, whole, &v);
    out[i] = v;
  }
  if (!geoid_) return;
  x_.assign(longitude_deg.begin(), longitude_deg.end());
  y_.assign(latitude_deg.begin(), latitude_deg.end());
  z_.assign(n, 0);
  ok_.resize(n);
  geoid_->Transform(static_cast<int>(n), x_.data(), y_.data(), z_.data(), ok_.data());
  for (std::size_t i = 0; i < n; ++i) out[i] += ok_[i] ? z_[i] : std::numeric_limits<double>::quiet_NaN();
}

void Raster::Probe::values(std::span<const double> latitude_deg, std::span<const double> longitude_deg,
                           std::span<float> out) {
  const GdalMessages messages;
  to_pixels(latitude_deg, longitude_deg);
  for (std::size_t i = 0; i < latitude_deg.size(); ++i) {
    if (r_.use_ == Use::imagery) {
      r_.bilinear(x_[i], y_[i], 3, false, out.data() + i * 3);
      continue;
    }
    out[i] = kNone;
    const double column = std::floor(x_[i]), row = std::floor(y_[i]);
    if (!(std::abs(column) < 1e15 && std::abs(row) < 1e15)) continue;
    if (const float* p = r_.pixel(static_cast<std::int64_t>(column), static_cast<std::int64_t>(row)))
      out[i] = *p;
  }
}

}  // namespace rigor::gis
