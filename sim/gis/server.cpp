#include "sim/gis/server.h"

#include <cpl_string.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <ogrsf_frmts.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstdlib>

namespace rigor::gis {
namespace {

namespace fs = std::filesystem;

constexpr int kCacheVersion = 1;
constexpr double kMostPixels = 64e6;

std::uint64_t fnv(std::string_view text, std::uint64_t h) {
  for (const char c : text) h = (h ^ static_cast<unsigned char>(c)) * 0x100000001B3ULL;
  return h;
}

fs::path cache_folder(const fs::path& given) {
  if (!given.empty()) return given;
  if (const char* xdg = std::getenv("XDG_CACHE_HOME"); xdg && *xdg) return fs::path(xdg) / "rigor" / "gis";
  if (const char* home = std::getenv("HOME"); home && *home)
    return fs::path(home) / ".cache" / "rigor" / "gis";
  return fs::temp_directory_path() / "rigor-gis-cache";
}

// Options of GDAL for this thread while it lives.
class ThreadOptions {
 public:
  ThreadOptions(std::initializer_list<std::pair<const char*, std::string>> options) {
    for (const auto& [key, value] : options) {
      const char* before = CPLGetThreadLocalConfigOption(key, nullptr);
      before_.emplace_back(key, before ? std::optional<std::string>(before) : std::nullopt);
      CPLSetThreadLocalConfigOption(key, value.c_str());
    }
  }
  ~ThreadOptions() {
    for (const auto& [key, value] : before_)
      CPLSetThreadLocalConfigOption(key.c_str(), value ? value->c_str() : nullptr);
  }
  ThreadOptions(const ThreadOptions&) = delete;
  ThreadOptions& operator=(const ThreadOptions&) = delete;

 private:
  std::vector<std::pair<std::string, std::optional<std::string>>> before_;
};

std::string xml_escaped(std::string_view text) {
  std::string out;
  for (const char c : text) switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += c;
    }
  return out;
}

// An address to which parameters can be added.
std::string open_ended(std::string url) {
  if (url.find('?') == std::string::npos)
    url += '?';
  else if (url.back() != '?' && url.back() != '&')
    url += '&';
  return url;
}
std::string with_parameter(const std::string& url, const std::string& key, const std::string& value) {
  return open_ended(url) + key + "=" + value;
}

Status synced(const fs::path& file) {
  const int fd = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  const bool good = fd >= 0 && ::fsync(fd) == 0;
  if (fd >= 0) ::close(fd);
  if (!good)
    return fail(ErrorCode::io, file.string(),
                "expected to write an answer to the cache, got an error of the disk");
  return {};
}

struct Job {
  const ImportSource& source;
  const std::optional<Domain>& domain;
  const ServerOptions& options;
  fs::path target;   // to be written; not yet the name under which it is found
  fs::path scratch;  // a folder of its own
};

tl::unexpected<Error> no_answer(const Job& job, const std::string& what) {
  return fail(ErrorCode::unavailable, job.source.location,
              fmt::format("expected the server's whole answer, got: {}; nothing was imported", what));
}

// Copies a window of an open raster, strip by strip, to a GeoTIFF.
Status copy_window(const Job& job, GDALDataset& from, int x, int y, int width, int height, int bands) {
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
  const GDALDataType type = from.GetRasterBand(1)->GetRasterDataType();
  GdalMessages messages;
  DatasetPtr to(driver->Create(job.target.c_str(), width, height, bands, type, nullptr));
  if (!to) return fail(ErrorCode::not_writable, job.target.string(), messages.text());
  std::array<double, 6> t{};
  from.GetGeoTransform(t.data());
  t[0] += x * t[1] + y * t[2];
  t[3] += x * t[4] + y * t[5];
  to->SetGeoTransform(t.data());
  if (from.GetSpatialRef()) to->SetSpatialRef(from.GetSpatialRef());
  for (int b = 1; b <= bands; ++b) {
    int has = 0;
    const double nodata = from.GetRasterBand(b)->GetNoDataValue(&has);
    if (has) to->GetRasterBand(b)->SetNoDataValue(nodata);
    to->GetRasterBand(b)->SetScale(from.GetRasterBand(b)->GetScale());
    to->GetRasterBand(b)->SetOffset(from.GetRasterBand(b)->GetOffset());
  }
  messages.clear();
  constexpr int kBlock = 1024;
  std::vector<std::byte> pixels(std::size_t{kBlock} * kBlock * bands * GDALGetDataTypeSizeBytes(type));
  for (int row = 0; row < height; row += kBlock)
    for (int column = 0; column < width; column += kBlock) {
      const int w = std::min(kBlock, width - column), h = std::min(kBlock, height - row);
      if (from.RasterIO(GF_Read, x + column, y + row, w, h, pixels.data(), w, h, type, bands, nullptr, 0, 0,
                        0, nullptr) != CE_None ||
          messages.failed())
        return no_answer(job, messages.text());
      if (to->RasterIO(GF_Write, column, row, w, h, pixels.data(), w, h, type, bands, nullptr, 0, 0, 0,
                       nullptr) != CE_None)
        return fail(ErrorCode::disk_full, job.target.string(), messages.text());
    }
  to->FlushCache();
  if (messages.failed()) return fail(ErrorCode::disk_full, job.target.string(), messages.text());
  return {};
}

Result<DatasetPtr> open_server(const Job& job, const std::string& name, unsigned flags,
                               const CPLStringList& options) {
  GdalMessages messages;
  DatasetPtr d(GDALDataset::Open(name.c_str(), flags | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR, nullptr,
                                 options.List()));
  if (!d || messages.failed()) return no_answer(job, messages.text());
  return d;
}

Status fetch_coverage(const Job& job) {
  std::string url = job.source.location;
  if (url.find("version=") == std::string::npos && url.find("VERSION=") == std::string::npos)
    url = with_parameter(url, "version", "2.0.1");
  if (!job.source.layer.empty()) url = with_parameter(url, "coverage", job.source.layer);
  CPLStringList options;
  options.SetNameValue("CACHE", job.scratch.c_str());
  auto from = open_server(job, url, GDAL_OF_RASTER, options);
  if (!from) return tl::unexpected(from.error());
  GDALDataset& d = **from;
  if (d.GetRasterCount() < 1)
    return fail(ErrorCode::bad_input, job.source.location,
                "expected the name of a coverage: give it as layer");
  int x0 = 0, y0 = 0, x1 = d.GetRasterXSize(), y1 = d.GetRasterYSize();
  std::array<double, 6> t{}, inverse{};
  if (d.GetGeoTransform(t.data()) != CE_None || !GDALInvGeoTransform(t.data(), inverse.data()) ||
      !d.GetSpatialRef())
    return no_answer(job, "a coverage without a place");
  if (job.domain && job.domain->half_extent_m > 0)
    if (const auto box = rectangle_of(*job.domain, *d.GetSpatialRef())) {
      double left = 1e300, right = -1e300, top = 1e300, bottom = -1e300;
      for (const double x : {box->MinX, box->MaxX})
        for (const double y : {box->MinY, box->MaxY}) {
          const double column = inverse[0] + x * inverse[1] + y * inverse[2],
                       row = inverse[3] + x * inverse[4] + y * inverse[5];
          left = std::min(left, column), right = std::max(right, column);
          top = std::min(top, row), bottom = std::max(bottom, row);
        }
      x0 = static_cast<int>(std::clamp(std::floor(left) - 1, 0.0, static_cast<double>(x1)));
      y0 = static_cast<int>(std::clamp(std::floor(top) - 1, 0.0, static_cast<double>(y1)));
      x1 = static_cast<int>(std::clamp(std::ceil(right) + 1, 0.0, static_cast<double>(x1)));
      y1 = static_cast<int>(std::clamp(std::ceil(bottom) + 1, 0.0, static_cast<double>(y1)));
    }
  if (x1 <= x0 || y1 <= y0)
    return fail(ErrorCode::bad_input, job.source.location,
                "expected a coverage that reaches into the extent, got one that lies outside");
  if (static_cast<double>(x1 - x0) * (y1 - y0) > kMostPixels)
    return fail(
        ErrorCode::bad_input, job.source.location,
        fmt::format(
            "expected at most 64 million pixels, the extent has {} x {}: give a smaller half_extent_m",
            x1 - x0, y1 - y0));
  return copy_window(job, d, x0, y0, x1 - x0, y1 - y0, d.GetRasterCount());
}

Status fetch_picture(const Job& job) {
  if (!job.domain || !(job.domain->half_extent_m > 0))
    return fail(ErrorCode::bad_input, job.source.location,
                "expected half_extent_m for a picture from a server, got none");
  if (job.source.layer.empty())
    return fail(ErrorCode::bad_input, job.source.location, "expected the name of a layer, got none");
  const std::string crs_name = job.source.crs.empty() ? "EPSG:4326" : job.source.crs;
  auto crs = parse_crs(crs_name, job.source.location + ": crs");
  if (!crs) return tl::unexpected(crs.error());
  const auto box = rectangle_of(*job.domain, *crs);
  if (!box)
    return fail(
        ErrorCode::bad_input, job.source.location,
        fmt::format("expected a reference system in which the extent is a rectangle, got {}", crs_name));
  double step = job.options.spacing_m > 0 ? job.options.spacing_m : 1;
  step /= crs->IsGeographic() ? 111'320.0 : crs->GetLinearUnits();
  const double west = std::floor(box->MinX / step) * step, north = std::ceil(box->MaxY / step) * step;
  const double columns = std::ceil((box->MaxX - west) / step), rows = std::ceil((north - box->MinY) / step);
  if (columns * rows > kMostPixels)
    return fail(
        ErrorCode::bad_input, job.source.location,
        fmt::format(
            "expected at most 64 million pixels, the extent has {:.0f} x {:.0f}: give a coarser spacing_m",
            columns, rows));
  const std::string xml = fmt::format(
      "<GDAL_WMS><Service name=\"WMS\"><Version>1.1.1</Version><ServerUrl>{}</ServerUrl><SRS>{}</SRS>"
      "<ImageFormat>image/png</ImageFormat><Transparent>FALSE</Transparent><Layers>{}</Layers><Styles></"
      "Styles>"
      "<BBoxOrder>xyXY</BBoxOrder></Service><DataWindow><UpperLeftX>{:.17g}</UpperLeftX><UpperLeftY>{:.17g}</"
      "UpperLeftY>"
      "<LowerRightX>{:.17g}</LowerRightX><LowerRightY>{:.17g}</LowerRightY><SizeX>{:.0f}</"
      "SizeX><SizeY>{:.0f}</SizeY>"
      "</DataWindow><Projection>{}</Projection><BandsCount>3</BandsCount><BlockSizeX>{:.0f}</BlockSizeX>"
      "<BlockSizeY>{:.0f}</BlockSizeY><OverviewCount>0</OverviewCount><MaxConnections>1</MaxConnections>"
      "<Timeout>{:.0f}</Timeout></GDAL_WMS>",
      xml_escaped(open_ended(job.source.location.substr(4))), xml_escaped(crs_name),
      xml_escaped(job.source.layer), west, north, west + columns * step, north - rows * step, columns, rows,
      xml_escaped(crs_name), std::min(columns, 1024.0), std::min(rows, 1024.0),
      std::max(1.0, std::ceil(job.options.timeout_s)));
  auto from = open_server(job, xml, GDAL_OF_RASTER, {});
  if (!from) return tl::unexpected(from.error());
  return copy_window(job, **from, 0, 0, static_cast<int>(columns), static_cast<int>(rows), 3);
}

Status fetch_features(const Job& job) {
  auto from = open_server(job, job.source.location, GDAL_OF_VECTOR, {});
  if (!from) return tl::unexpected(from.error());
  OGRLayer* layer = nullptr;
  if (!job.source.layer.empty())
    layer = (*from)->GetLayerByName(job.source.layer.c_str());
  else if ((*from)->GetLayerCount() == 1)
    layer = (*from)->GetLayer(0);
  if (!layer) {
    std::string names;
    for (int i = 0; i < (*from)->GetLayerCount(); ++i)
      names += (i ? ", " : "") + std::string((*from)->GetLayer(i)->GetName());
    return fail(ErrorCode::bad_input, job.source.location,
                fmt::format("expected one of the layers {}, got '{}'", names.empty() ? "(none)" : names,
                            job.source.layer));
  }
  GdalMessages messages;
  if (job.domain && job.domain->half_extent_m > 0 && layer->GetSpatialRef())
    if (const auto box = rectangle_of(*job.domain, *layer->GetSpatialRef()))
      layer->SetSpatialFilterRect(box->MinX, box->MinY, box->MaxX, box->MaxY);
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GPKG");
  DatasetPtr to(driver->Create(job.target.c_str(), 0, 0, 0, GDT_Unknown, nullptr));
  if (!to) return fail(ErrorCode::not_writable, job.target.string(), messages.text());
  OGRFeatureDefn& from_fields = *layer->GetLayerDefn();
  CPLStringList options;
  options.SetNameValue("GEOMETRY_NAME", "rigor_geometry");
  options.SetNameValue("FID", "rigor_fid");
  OGRLayer* copy = to->CreateLayer(layer->GetName(), layer->GetSpatialRef(), wkbUnknown, options.List());
  bool written = copy != nullptr;
  for (int i = 0; written && i < from_fields.GetFieldCount(); ++i) {
    OGRFieldDefn field(from_fields.GetFieldDefn(i));
    field.SetNullable(TRUE);  // servers do not always keep what their schema promises
    field.SetUnique(FALSE);
    written = copy->CreateField(&field) == OGRERR_NONE;
  }
  if (!written || copy->StartTransaction() != OGRERR_NONE)
    return fail(ErrorCode::not_writable, job.target.string(), messages.text());
  messages.clear();
  layer->ResetReading();
  while (OGRFeature* raw = layer->GetNextFeature()) {
    const OGRFeatureUniquePtr feature(raw);
    if (messages.failed()) break;
    OGRFeature out(copy->GetLayerDefn());
    out.SetFrom(feature.get());
    if (copy->CreateFeature(&out) != OGRERR_NONE)
      return fail(ErrorCode::disk_full, job.target.string(), messages.text());
  }
  if (messages.failed()) return no_answer(job, messages.text());
  if (copy->CommitTransaction() != OGRERR_NONE)
    return fail(ErrorCode::disk_full, job.target.string(), messages.text());
  to->FlushCache();
  if (messages.failed()) return fail(ErrorCode::disk_full, job.target.string(), messages.text());
  return {};
}

}  // namespace

bool is_server(std::string_view location) {
  for (const std::string_view prefix : {"WCS:http", "WMS:http", "WFS:http"})
    if (location.starts_with(prefix)) return true;
  return false;
}

Result<Fetched> fetch(const ImportSource& source, const std::optional<Domain>& domain,
                      const ServerOptions& options) {
  register_gdal();
  const std::string_view service = std::string_view(source.location).substr(0, 3);
  using Kind = ImportSource::Kind;
  const bool fits = service == "WCS"   ? source.kind == Kind::elevation || source.kind == Kind::land_cover
                    : service == "WMS" ? source.kind == Kind::imagery
                                       : source.kind == Kind::vector;
  if (!fits)
    return fail(ErrorCode::bad_input, source.location,
                "expected WCS for elevation and land cover, WMS for imagery, WFS for vectors, got another");
  const fs::path folder = cache_folder(options.cache_dir);
  std::string request =
      fmt::format("{}\n{}\n{}\n{}\n", kCacheVersion, source.location, source.layer, source.crs);
  if (domain && domain->half_extent_m > 0) {
    const Anchor& a = domain->frame->anchor();
    request += fmt::format("{} {} {}\n", a.latitude_deg, a.longitude_deg, domain->half_extent_m);
  }
  if (service == "WMS") request += fmt::format("{}\n", options.spacing_m);
  const std::string name =
      fmt::format("{:016x}{:016x}", fnv(request, 0xCBF29CE484222325ULL), fnv(request, 0x84222325CBF29CE4ULL));
  const fs::path kept = folder / (name + (service == "WFS" ? ".gpkg" : ".tif"));
  std::error_code ec;
  if (fs::exists(kept, ec)) return Fetched{kept.string(), true};

  const fs::path scratch = folder / fmt::format("{}.{}.part", name, ::getpid());
  fs::remove_all(scratch, ec);
  fs::create_directories(scratch, ec);
  if (ec)
    return fail(
        ErrorCode::not_writable, folder.string(),
        "expected a folder for what servers answer: " + ec.message() + "; give another with cache_dir");
  const Job job{source, domain, options, scratch / kept.filename(), scratch};
  const ThreadOptions http{
      {"GDAL_HTTP_TIMEOUT", fmt::format("{:.0f}", std::max(1.0, std::ceil(options.timeout_s)))},
      {"GDAL_HTTP_CONNECTTIMEOUT", fmt::format("{:.0f}", std::max(1.0, std::ceil(options.timeout_s)))},
      {"GDAL_HTTP_MAX_RETRY", "0"},
      // An answer is taken whole before it is read, so that half of one is seen as that.
      {"OGR_WFS_USE_STREAMING", "NO"},
      {"OGR_WFS_PAGING_ALLOWED", "NO"},
      {"GDAL_DEFAULT_WMS_CACHE_PATH", scratch.string()}};
  Status done = service == "WCS"   ? fetch_coverage(job)
                : service == "WMS" ? fetch_picture(job)
                                   : fetch_features(job);
  if (done) done = synced(job.target);
  if (done) {
    fs::rename(job.target, kept, ec);
    if (ec)
      done =
          fail(ErrorCode::not_writable, kept.string(), "expected to keep the answer, got: " + ec.message());
  }
  fs::remove_all(scratch, ec);
  if (!done) return tl::unexpected(done.error());
  return Fetched{kept.string(), false};
}

}  // namespace rigor::gis
