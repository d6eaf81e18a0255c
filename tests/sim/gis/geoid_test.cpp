// A program of its own: GDAL remembers transformations that it has once made, with the grids they had then.
#include <ogr_srs_api.h>

#include "tests/sim/gis/gis_test_support.h"

namespace rigor::gis::test {
namespace {

using Kind = ImportSource::Kind;

TEST(Elevation, WithoutTheGridOfTheGeoidItSaysWhatToInstall) {
  const Folder f, proj;
  RasterSpec s;
  write_raster(f / "sea.tif", s);
  std::string database;
  char** paths = OSRGetPROJSearchPaths();
  for (char** p = paths; p && *p; ++p)
    if (std::filesystem::exists(std::string(*p) + "/proj.db")) database = std::string(*p) + "/proj.db";
  if (database.empty() && std::filesystem::exists("/usr/share/proj/proj.db"))
    database = "/usr/share/proj/proj.db";
  ASSERT_FALSE(database.empty());
  std::filesystem::create_symlink(database, proj / "proj.db");
  const char* const only[] = {proj.path().c_str(), nullptr};
  OSRSetPROJSearchPaths(only);
  ImportPlan plan;
  plan.sources = {source(Kind::elevation, f / "sea.tif")};
  plan.half_extent_m = 1000;
  plan.spacing_m = 500;
  plan.anchor = Anchor{-1, 1, kNaN};
  EXPECT_TRUE(import(plan).report) << "heights above the ellipsoid need no grid";
  plan.sources[0].heights_above_geoid = true;
  const Imported w = import(plan);
  OSRSetPROJSearchPaths(paths);
  CSLDestroy(paths);
  ASSERT_FALSE(w.report);
  EXPECT_EQ(w.report.error().code, ErrorCode::unavailable);
  EXPECT_NE(w.complaint().find("proj-data"), std::string::npos) << w.complaint();
  EXPECT_EQ(w.world().node_count(), 0u);
}

}  // namespace
}  // namespace rigor::gis::test
