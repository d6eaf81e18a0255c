#include "tests/sim/gis/gis_test_support.h"
#include "tests/paths.h"

#include <ogr_spatialref.h>

#include <fstream>

namespace rigor::gis::test {

namespace fs = std::filesystem;

Folder::Folder() {
  std::string name = (fs::temp_directory_path() / "rigor-gis-XXXXXX").string();
  if (!mkdtemp(name.data())) throw std::runtime_error("no temporary folder");
  path_ = name;
}
Folder::~Folder() {
  std::error_code ec;
  fs::remove_all(path_, ec);
}

std::string Folder::write(const std::string& name, const std::string& text) const {
  fs::create_directories((path_ / name).parent_path());
  std::ofstream(path_ / name, std::ios::binary) << text;
  return (path_ / name).string();
}

void write_raster(const std::string& file, const RasterSpec& spec) {
  GDALAllRegister();
  auto* d = GetGDALDriverManager()->GetDriverByName("GTiff")->Create(file.c_str(), spec.width, spec.height,
                                                                     spec.bands, spec.type, nullptr);
  ASSERT_NE(d, nullptr) << file;
  auto t = spec.geotransform;
  d->SetGeoTransform(t.data());
  if (!spec.crs.empty()) {
    OGRSpatialReference crs;
    ASSERT_EQ(crs.SetFromUserInput(spec.crs.c_str()), OGRERR_NONE);
    d->SetSpatialRef(&crs);
  }
  for (int b = 1; b <= spec.bands; ++b) {
    GDALRasterBand& band = *d->GetRasterBand(b);
    if (spec.has_nodata) band.SetNoDataValue(spec.nodata);
    if (spec.scale != 1) band.SetScale(spec.scale);
    if (spec.offset != 0) band.SetOffset(spec.offset);
    if (!spec.unit.empty()) band.SetUnitType(spec.unit.c_str());
    std::vector<double> row(static_cast<std::size_t>(spec.width));
    for (int r = 0; r < spec.height; ++r) {
      for (int c = 0; c < spec.width; ++c) row[static_cast<std::size_t>(c)] = spec.value(c, r, b);
      ASSERT_EQ(
          band.RasterIO(GF_Write, 0, r, spec.width, 1, row.data(), spec.width, 1, GDT_Float64, 0, 0, nullptr),
          CE_None);
    }
  }
  GDALClose(d);
}

std::unique_ptr<world::Database> fresh_world() {
  auto db = world::Database::create();
  if (auto s = world::define_semantic_types(*db); !s) throw std::runtime_error(s.error().text());
  return db;
}

ImportSource source(ImportSource::Kind kind, std::string location) {
  ImportSource s;
  s.kind = kind;
  s.location = std::move(location);
  return s;
}

std::string Imported::warnings() const {
  std::string all;
  if (report)
    for (const auto& w : report->warnings) all += w + "\n";
  return all;
}

Imported import(const ImportPlan& plan) {
  Imported out;
  out.db = fresh_world();
  out.report = import_into(*out.db, plan);
  return out;
}

TerrainView terrain_of(const world::Snapshot& world) {
  const world::types::Terrain t(world.schema());
  const auto nodes = world.nodes(t.type);
  if (nodes.size() != 1) return {};
  const auto n = nodes[0];
  const auto z = world.get(n, t.heights_m)->as<float>();
  return {*world.get(n, t.columns), *world.get(n, t.rows),      *world.get(n, t.x_m),
          *world.get(n, t.y_m),     *world.get(n, t.spacing_m), {z.begin(), z.end()}};
}

std::string shared_data(const std::string& name) {
  const fs::path p = rigor::test::test_data(name);
  return fs::exists(p) ? p.string() : "";
}

}  // namespace rigor::gis::test
