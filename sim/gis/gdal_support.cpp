#include "sim/gis/gdal_support.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <mutex>

namespace rigor::gis {
namespace {

std::string one_line(std::string s) {
  std::replace(s.begin(), s.end(), '\n', ' ');
  while (!s.empty() && (s.back() == ' ' || s.back() == '.')) s.pop_back();
  return s;
}

}  // namespace

void register_gdal() {
  static std::once_flag once;
  std::call_once(once, [] { GDALAllRegister(); });
}

GdalMessages::GdalMessages() { CPLPushErrorHandlerEx(&GdalMessages::on_message, this); }
GdalMessages::~GdalMessages() { CPLPopErrorHandler(); }

void GdalMessages::clear() {
  failures_.clear();
  warnings_.clear();
}

void CPL_STDCALL GdalMessages::on_message(CPLErr level, CPLErrorNum, const char* text) {
  auto* self = static_cast<GdalMessages*>(CPLGetErrorHandlerUserData());
  auto& list = level >= CE_Failure ? self->failures_ : self->warnings_;
  if (level >= CE_Warning && list.size() < 100) list.push_back(one_line(text));
}

std::string GdalMessages::text() const {
  if (!failures_.empty()) return failures_.front();
  if (!warnings_.empty()) return warnings_.front();
  return "no reason given";
}

Result<DatasetPtr> open_dataset(const std::string& file, unsigned flags) {
  register_gdal();
  std::error_code ec;
  if (!std::filesystem::exists(file, ec))
    return fail(ErrorCode::not_found, file, "expected a file or folder of geographic data, there is none");
  GdalMessages messages;
  DatasetPtr d(GDALDataset::Open(file.c_str(), flags | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR));
  if (!d)
    return fail(ErrorCode::bad_input, file,
                fmt::format("expected a {} that GDAL reads, got: {}",
                            flags & GDAL_OF_RASTER ? "raster" : "vector file", messages.text()));
  return d;
}

Result<OGRSpatialReference> parse_crs(std::string_view text, const std::string& where) {
  register_gdal();
  GdalMessages messages;
  OGRSpatialReference crs;
  // Only definitions: SetFromUserInput would otherwise read files and fetch addresses.
  if (crs.SetFromUserInput(std::string(text).c_str(),
                           OGRSpatialReference::SET_FROM_USER_INPUT_LIMITATIONS_get()) != OGRERR_NONE)
    return fail(
        ErrorCode::bad_input, where,
        fmt::format("expected a reference system such as EPSG:25832, got '{}' ({})", text, messages.text()));
  crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return crs;
}

OGRSpatialReference wgs84() {
  OGRSpatialReference crs;
  crs.importFromEPSG(4326);
  crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return crs;
}

Result<TransformationPtr> transformation(OGRSpatialReference from, OGRSpatialReference to,
                                         const std::string& where) {
  GdalMessages messages;
  for (OGRSpatialReference* crs : {&from, &to}) {
    if (crs->IsCompound()) crs->StripVertical();
    if (crs->GetAxesCount() == 3 && !crs->IsGeocentric()) crs->DemoteTo2D(nullptr);
    crs->SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  }
  TransformationPtr t(OGRCreateCoordinateTransformation(&from, &to));
  if (!t)
    return fail(ErrorCode::bad_input, where,
                fmt::format("expected a reference system that leads to WGS84, got {} ({})",
                            from.GetName() ? from.GetName() : "one without a name", messages.text()));
  return t;
}

Result<TransformationPtr> geoid_transformation() {
  register_gdal();
  GdalMessages messages;
  const char* const kMissing =
      "expected PROJ's grid of the EGM96 geoid (egm96_15.gtx), found none: install the package proj-data, or "
      "give "
      "heights above the ellipsoid";
  OGRSpatialReference above_geoid, above_ellipsoid;
  if (above_geoid.SetFromUserInput("EPSG:4326+5773") != OGRERR_NONE ||
      above_ellipsoid.importFromEPSG(4979) != OGRERR_NONE)
    return fail(ErrorCode::unavailable, "PROJ",
                "expected EPSG:4326+5773 and EPSG:4979 in its database, got: " + messages.text());
  above_geoid.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  above_ellipsoid.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  OGRCoordinateTransformationOptions options;
  options.SetBallparkAllowed(false);
  TransformationPtr t(OGRCreateCoordinateTransformation(&above_geoid, &above_ellipsoid, options));
  // Without its grid PROJ may hand out a transformation that does nothing: the geoid is 17 m above the
  // ellipsoid where the equator meets Greenwich.
  double x = 0, y = 0, z = 0;
  if (!t || !t->Transform(1, &x, &y, &z) || std::abs(z - 17.16) > 1)
    return fail(ErrorCode::unavailable, "EGM96", kMissing);
  return t;
}

}  // namespace rigor::gis
