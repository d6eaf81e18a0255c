// Rasters to grids of the world: each hard case by its name.
#include <GeographicLib/Geocentric.hpp>
#include <chrono>
#include <cstdlib>
#include <fstream>

#include "sim/gis/frame.h"
#include "tests/sim/gis/gis_test_support.h"

namespace rigor::gis::test {
namespace {

using Kind = ImportSource::Kind;
using world::Vector3;

ImportPlan plan_of(const std::string& file, Anchor anchor, double half_extent_m, double spacing_m,
                   Kind kind = Kind::elevation) {
  ImportPlan plan;
  plan.anchor = anchor;
  plan.half_extent_m = half_extent_m;
  plan.spacing_m = spacing_m;
  plan.sources = {source(kind, file)};
  return plan;
}

// A smooth hill over the ellipsoid, as a function of latitude and longitude.
double hill_m(double latitude_deg, double longitude_deg, double lat0, double lon0) {
  const double u = (latitude_deg - lat0) * 60, v = std::remainder(longitude_deg - lon0, 360) * 60;
  return 400 + 100 * std::sin(u * 0.7) + 80 * std::cos(v * 0.9);
}

// Every cell of the terrain lies on the hill, to what bilinear sampling of the raster allows.
void expect_on_hill(const Imported& w, double lat0, double lon0, double tolerance_m) {
  ASSERT_TRUE(w.report) << w.complaint();
  const LocalFrame frame(w.report->anchor);
  const auto t = terrain_of(w.world());
  ASSERT_GT(t.z.size(), 0u);
  double worst = 0;
  for (std::int64_t r = 0; r < t.rows; ++r)
    for (std::int64_t c = 0; c < t.columns; ++c) {
      const GeoPoint p = frame.to_geo({t.x_m + static_cast<double>(c) * t.spacing_m,
                                       t.y_m - static_cast<double>(r) * t.spacing_m, t.at(c, r)});
      worst = std::max(worst, std::abs(p.height_m - hill_m(p.latitude_deg, p.longitude_deg, lat0, lon0)));
    }
  EXPECT_LT(worst, tolerance_m);
}

RasterSpec geographic_hill(double lat0, double lon0, double span_deg, int pixels) {
  RasterSpec s;
  s.width = s.height = pixels;
  const double d = span_deg / pixels;
  s.geotransform = {lon0 - span_deg / 2, d, 0, lat0 + span_deg / 2, 0, -d};
  s.type = GDT_Float64;
  s.value = [=](int c, int r, int) {
    return hill_m(lat0 + span_deg / 2 - (r + 0.5) * d, lon0 - span_deg / 2 + (c + 0.5) * d, lat0, lon0);
  };
  return s;
}

TEST(Elevation, EveryCellLiesOnTheSurfaceOfTheSource) {
  const Folder f;
  write_raster(f / "hill.tif", geographic_hill(46.8, 8.2, 0.2, 2000));
  expect_on_hill(import(plan_of(f / "hill.tif", {46.8, 8.2, kNaN}, 1000, 10)), 46.8, 8.2, 0.01);
}

TEST(Elevation, FarFromTheAnchorThePlumbLineLeansAndTheSurfaceStillFits) {
  const Folder f;
  // A plane in latitude and longitude, steep, so that bilinear sampling is exact and a wrong place shows at
  // once.
  const auto plane_m = [](double lat, double lon) {
    return 2500 + 20'000 * (lat - 46.8) + 12'000 * (lon - 8.2);
  };
  RasterSpec s;
  s.width = s.height = 20;
  s.geotransform = {8.1, 0.01, 0, 46.9, 0, -0.01};
  s.type = GDT_Float64;
  s.value = [&](int c, int r, int) { return plane_m(46.9 - (r + 0.5) * 0.01, 8.1 + (c + 0.5) * 0.01); };
  write_raster(f / "plane.tif", s);
  // The anchor is 100 km away.
  const Imported w = import(plan_of(f / "plane.tif", {46.8, 8.2 - 1.31, 0}, 112'000, 500));
  ASSERT_TRUE(w.report) << w.complaint();
  const LocalFrame frame(w.report->anchor);
  const auto t = terrain_of(w.world());
  int seen = 0;
  double worst = 0;
  for (std::int64_t r = 0; r < t.rows; ++r)
    for (std::int64_t c = 0; c < t.columns; ++c) {
      if (std::isnan(t.at(c, r))) continue;
      const GeoPoint p = frame.to_geo({t.x_m + static_cast<double>(c) * t.spacing_m,
                                       t.y_m - static_cast<double>(r) * t.spacing_m, t.at(c, r)});
      if (std::abs(p.latitude_deg - 46.8) > 0.094 || std::abs(p.longitude_deg - 8.2) > 0.094) continue;
      ++seen;
      worst = std::max(worst, std::abs(p.height_m - plane_m(p.latitude_deg, p.longitude_deg)));
    }
  EXPECT_GT(seen, 500);
  EXPECT_LT(worst, 2e-3) << "of which float32 heights, here about -1000 m, leave 6e-5";
}

TEST(Elevation, TheAntimeridianIsNoEdge) {
  const Folder f;
  // One raster that runs from 179.9 over 180 to 180.1, and the same as two that end and begin there.
  write_raster(f / "over.tif", geographic_hill(10, 180, 0.2, 1000));
  expect_on_hill(import(plan_of(f / "over.tif", {10, -179.999, kNaN}, 1500, 20)), 10, 180, 0.05);
  auto west = geographic_hill(10, 180, 0.2, 1000), east = west;
  west.width = east.width = 500;
  east.geotransform[0] = -180;
  east.value = [v = west.value](int c, int r, int b) { return v(c + 500, r, b); };
  write_raster(f / "west.tif", west);
  write_raster(f / "east.tif", east);
  auto plan = plan_of(f / "west.tif", {10, 180, kNaN}, 1500, 20);
  plan.sources.push_back(source(Kind::elevation, f / "east.tif"));
  const Imported w = import(plan);
  for (const float z : terrain_of(w.world()).z) EXPECT_FALSE(std::isnan(z));
  // At the seam the nearest pixel stands for the missing neighbour: half a pixel of slope.
  expect_on_hill(w, 10, 180, 1.0);
}

TEST(Elevation, ThePoleLiesInsideAGlobalRaster) {
  const Folder f;
  RasterSpec s;
  s.width = 720, s.height = 20;
  s.geotransform = {-180, 0.5, 0, 90, 0, -0.5};
  s.value = [](int, int r, int) { return 100 + r; };
  write_raster(f / "cap.tif", s);
  const Imported w = import(plan_of(f / "cap.tif", {90, 0, kNaN}, 200'000, 5000));
  ASSERT_TRUE(w.report) << w.complaint();
  const LocalFrame frame(w.report->anchor);
  const auto t = terrain_of(w.world());
  for (std::int64_t r = 0; r < t.rows; ++r)
    for (std::int64_t c = 0; c < t.columns; ++c) {
      ASSERT_FALSE(std::isnan(t.at(c, r))) << "around the pole too, and over the seam at 180 degrees";
      const GeoPoint p = frame.to_geo({t.x_m + static_cast<double>(c) * t.spacing_m,
                                       t.y_m - static_cast<double>(r) * t.spacing_m, t.at(c, r)});
      EXPECT_NEAR(p.height_m, 100 + std::max(0.0, (90 - p.latitude_deg) / 0.5 - 0.5), 0.01);
    }
}

TEST(Elevation, AnEdgeOfAUtmZoneIsCrossedByTheZonesOwnFormula) {
  const Folder f;
  // Tiles of zones 32 and 33 that overlap at 12 degrees east: both give one surface.
  const auto tile = [&](const std::string& name, const std::string& crs, double lon0) {
    OGRSpatialReference utm, geo;
    utm.SetFromUserInput(crs.c_str());
    geo.importFromEPSG(4326);
    geo.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    auto* to = OGRCreateCoordinateTransformation(&geo, &utm);
    auto* from = OGRCreateCoordinateTransformation(&utm, &geo);
    double x = lon0, y = 47;
    to->Transform(1, &x, &y);
    RasterSpec s;
    s.width = s.height = 800;
    s.crs = crs;
    s.type = GDT_Float64;
    x = std::floor(x) - 4000, y = std::floor(y) + 4000;
    s.geotransform = {x, 10, 0, y, 0, -10};
    s.value = [=](int c, int r, int) {
      double px = x + (c + 0.5) * 10, py = y - (r + 0.5) * 10;
      from->Transform(1, &px, &py);
      return hill_m(py, px, 47, 12);
    };
    write_raster(f / name, s);
    OCTDestroyCoordinateTransformation(OGRCoordinateTransformation::ToHandle(to));
    OCTDestroyCoordinateTransformation(OGRCoordinateTransformation::ToHandle(from));
  };
  tile("32.tif", "EPSG:25832", 11.97);
  tile("33.tif", "EPSG:25833", 12.03);
  auto plan = plan_of(f / "32.tif", {47, 12, kNaN}, 3000, 50);
  plan.sources.push_back(source(Kind::elevation, f / "33.tif"));
  expect_on_hill(import(plan), 47, 12, 0.05);
}

TEST(Elevation, ARotatedRasterIsNotTakenForAStraightOne) {
  const Folder f;
  RasterSpec s;
  s.width = s.height = 600;
  s.crs = "EPSG:32632";
  const double a = 0.5;  // rad
  s.geotransform = {500'000,   10 * std::cos(a), 10 * std::sin(a),
                    5'200'000, 10 * std::sin(a), -10 * std::cos(a)};
  // Height is the easting: only the right inverse gives it back.
  s.value = [&](int c, int r, int) {
    return (s.geotransform[1] * (c + 0.5) + s.geotransform[2] * (r + 0.5)) * 0.1;
  };
  s.type = GDT_Float64;
  write_raster(f / "rotated.tif", s);
  ImportPlan plan;
  plan.sources = {source(Kind::elevation, f / "rotated.tif")};
  plan.half_extent_m = 1000;
  plan.spacing_m = 50;
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const auto t = terrain_of(w.world());
  const double slope = (t.near(1000, 0) - t.near(-1000, 0)) / 2000,
               across = (t.near(0, 1000) - t.near(0, -1000)) / 2000;
  // The scale of UTM at its central meridian, and the meridian convergence near it (0.02 rad at most).
  EXPECT_NEAR(slope, 0.1 * 0.9996, 1e-4);
  EXPECT_NEAR(across, 0, 1e-3);
}

TEST(Elevation, NanAndNodataAreHolesAndNotHeights) {
  const Folder f;
  RasterSpec s;
  s.width = s.height = 100;
  s.crs = "EPSG:32632";
  s.geotransform = {500'000, 10, 0, 5'200'000, 0, -10};
  s.has_nodata = true;
  s.nodata = -9999;
  s.value = [](int c, int r, int) { return c >= 40 && c < 50 ? -9999 : r >= 40 && r < 50 ? kNaN : 500; };
  write_raster(f / "holes.tif", s);
  ImportPlan plan;
  plan.sources = {source(Kind::elevation, f / "holes.tif")};
  plan.spacing_m = 10;
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const LocalFrame frame(w.report->anchor);
  std::size_t holes = 0;
  const auto t = terrain_of(w.world());
  for (std::int64_t r = 0; r < t.rows; ++r)
    for (std::int64_t c = 0; c < t.columns; ++c) {
      if (std::isnan(t.at(c, r))) {
        ++holes;
        continue;
      }
      const double x = t.x_m + static_cast<double>(c) * 10, y = t.y_m - static_cast<double>(r) * 10;
      EXPECT_NEAR(frame.to_geo({x, y, t.at(c, r)}).height_m, 500, 0.01)
          << "a hole bleeds into its neighbours";
    }
  EXPECT_NEAR(static_cast<double>(holes), 1900, 150) << "and a rim where the raster ends";
  EXPECT_NE(w.warnings().find("are holes"), std::string::npos) << w.warnings();
}

TEST(Elevation, ScaleOffsetAndFeetAreApplied) {
  const Folder f;
  RasterSpec s;
  s.geotransform = {8, 0.01, 0, 47, 0, -0.01};
  s.type = GDT_Int16;
  s.scale = 0.1;
  s.offset = 50;
  s.unit = "ft";
  s.value = [](int, int, int) { return 1000; };
  write_raster(f / "feet.tif", s);
  ImportPlan plan;
  plan.sources = {source(Kind::elevation, f / "feet.tif")};
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_NEAR(w.report->anchor.height_m, 150 * 0.3048, 0.01);
  s.unit = "furlong";
  write_raster(f / "furlong.tif", s);
  plan.sources[0].location = f / "furlong.tif";
  EXPECT_NE(import(plan).complaint().find("furlong"), std::string::npos);
}

TEST(Elevation, OfOverlappingTilesTheFirstWinsWhereItHasData) {
  const Folder f;
  RasterSpec s;
  s.width = s.height = 100;
  s.crs = "EPSG:32632";
  s.geotransform = {500'000, 10, 0, 5'200'000, 0, -10};
  s.has_nodata = true;
  s.nodata = -1;
  s.value = [](int c, int, int) { return c < 50 ? 100 : -1; };
  write_raster(f / "a.tif", s);
  s.value = [](int, int, int) { return 200; };
  write_raster(f / "b.tif", s);
  ImportPlan plan;
  plan.half_extent_m = 400;
  plan.spacing_m = 10;
  plan.sources = {source(Kind::elevation, f / "a.tif"), source(Kind::elevation, f / "b.tif")};
  plan.anchor = import(plan).report->anchor;
  plan.anchor->height_m = 0;
  const auto t = terrain_of(import(plan).world());
  EXPECT_NEAR(t.near(-300, 0), 100, 0.1);
  EXPECT_NEAR(t.near(300, 0), 200, 0.1);
  std::swap(plan.sources[0], plan.sources[1]);
  EXPECT_NEAR(terrain_of(import(plan).world()).near(-300, 0), 200, 0.1);
}

TEST(Elevation, AxesThatTheAuthorityNamesTheOtherWayRoundAreNotSwapped) {
  const Folder f;
  // EPSG:31468 and 2193 say northing first; a GeoTIFF holds easting first all the same.
  RasterSpec s;
  s.width = s.height = 50;
  s.crs = "EPSG:2193";
  s.geotransform = {1'570'000, 20, 0, 5'180'000, 0, -20};  // Christchurch
  s.value = [](int, int, int) { return 10; };
  write_raster(f / "nz.tif", s);
  ImportPlan plan;
  plan.sources = {source(Kind::elevation, f / "nz.tif")};
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_NEAR(w.report->anchor.latitude_deg, -43.5, 0.2);
  EXPECT_NEAR(w.report->anchor.longitude_deg, 172.6, 0.2);
}

TEST(Elevation, HeightsAboveTheGeoidBecomeHeightsAboveTheEllipsoid) {
  const Folder f;
  RasterSpec s;
  s.geotransform = {8.1, 0.1, 0, 46.9, 0, -0.1};
  s.value = [](int, int, int) { return 0; };
  write_raster(f / "sea.tif", s);
  ImportPlan plan;
  plan.anchor = Anchor{46.8, 8.2, kNaN};
  plan.half_extent_m = 1000;
  plan.spacing_m = 500;
  plan.sources = {source(Kind::elevation, f / "sea.tif")};
  EXPECT_NEAR(import(plan).report->anchor.height_m, 0, 1e-9);
  plan.sources[0].heights_above_geoid = true;
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  // Undulations of EGM96 as NGA's calculator gives them; the 15' grid of PROJ follows it to a metre.
  EXPECT_NEAR(w.report->anchor.height_m, 49.5, 2.5);
  plan.anchor = Anchor{0, 80, kNaN};  // south of India: the deepest
  s.geotransform = {79.9, 0.1, 0, 0.1, 0, -0.1};
  write_raster(f / "india.tif", s);
  plan.sources[0].location = f / "india.tif";
  EXPECT_NEAR(import(plan).report->anchor.height_m, -102.7, 1.5);
}

TEST(Raster, WithoutAReferenceSystemItIsAskedForAndNotGuessed) {
  const Folder f;
  RasterSpec s;
  s.crs = "";
  s.geotransform = {8, 0.01, 0, 47, 0, -0.01};
  write_raster(f / "bare.tif", s);
  ImportPlan plan;
  plan.sources = {source(Kind::elevation, f / "bare.tif")};
  const Imported w = import(plan);
  ASSERT_FALSE(w.report);
  EXPECT_EQ(w.report.error().code, ErrorCode::bad_input);
  EXPECT_NE(w.complaint().find("reference system"), std::string::npos);
  plan.sources[0].crs = "EPSG:4326";
  EXPECT_TRUE(import(plan).report);
  plan.sources[0].crs = "EPSG:99999999";
  EXPECT_FALSE(import(plan).report);
}

TEST(Raster, AFileCutShortLeavesTheWorldAsItWas) {
  const Folder f;
  RasterSpec s;
  s.width = s.height = 300;
  s.geotransform = {8, 0.001, 0, 47, 0, -0.001};
  s.value = [](int c, int r, int) { return c * 3 + r; };
  write_raster(f / "whole.tif", s);
  std::ifstream in(f / "whole.tif", std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), {});
  ImportPlan plan;
  plan.sources = {source(Kind::elevation, f / "cut.tif")};
  for (const double share : {0.0, 0.001, 0.3, 0.6, 0.99}) {
    f.write("cut.tif", bytes.substr(0, static_cast<std::size_t>(static_cast<double>(bytes.size()) * share)));
    const Imported w = import(plan);
    ASSERT_FALSE(w.report) << share;
    EXPECT_EQ(w.report.error().code, ErrorCode::bad_input) << w.complaint();
    EXPECT_EQ(w.world().node_count(), 0u);
    EXPECT_EQ(w.world().revision(), fresh_world()->snapshot().revision());
  }
  plan.sources[0].location = f / "none.tif";
  EXPECT_EQ(import(plan).report.error().code, ErrorCode::not_found);
}

TEST(LandCover, ValuesBecomeWordsAndUnknownOnesAreCounted) {
  const Folder f;
  RasterSpec s;
  s.width = s.height = 60;
  s.crs = "EPSG:32632";
  s.geotransform = {500'000, 10, 0, 5'200'000, 0, -10};
  s.type = GDT_Byte;
  s.value = [](int c, int, int) { return c < 20 ? 10 : c < 40 ? 80 : 77; };
  write_raster(f / "lc.tif", s);
  ImportPlan plan;
  plan.sources = {source(Kind::land_cover, f / "lc.tif")};
  plan.spacing_m = 10;
  EXPECT_NE(import(plan).complaint().find("classes"), std::string::npos) << "classes are asked for";
  plan.sources[0].classes = *class_set("worldcover");
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const world::types::LandCover cover(w.world().schema());
  const auto n = w.nodes("LandCover");
  ASSERT_EQ(n.size(), 1u);
  EXPECT_EQ(*w.world().get(n[0], cover.classes), "water forest_floor");
  const auto snapshot = w.world();
  const auto cells = snapshot.get(n[0], cover.cells)->as<std::uint8_t>();
  const auto columns = static_cast<std::size_t>(*snapshot.get(n[0], cover.columns));
  ASSERT_EQ(cells.size(), columns * static_cast<std::size_t>(*snapshot.get(n[0], cover.rows)));
  EXPECT_EQ(cells[30 * columns + 10], 1);
  EXPECT_EQ(cells[30 * columns + 30], 0);
  EXPECT_EQ(cells[30 * columns + 50], 255);
  EXPECT_NE(w.warnings().find("value 77 has no class"), std::string::npos) << w.warnings();
  EXPECT_EQ(w.nodes("GroundVegetation").size(), 1u) << "on the forest floor; none in water";
  plan.sources[0].classes = {{"10", "forest"}};
  EXPECT_NE(import(plan).complaint().find("forest_floor"), std::string::npos)
      << "the nearest word is offered";
  EXPECT_FALSE(class_set("corinne"));
  for (const char* set : {"corine", "words"}) EXPECT_TRUE(class_set(set));
}

TEST(LandCover, ACoarserGridTakesTheMostFrequentValue) {
  const Folder f;
  RasterSpec s;
  s.width = s.height = 90;
  s.crs = "EPSG:32632";
  s.geotransform = {500'000, 1, 0, 5'200'000, 0, -1};
  s.type = GDT_Byte;
  s.value = [](int c, int r, int) {
    return c % 3 == 1 && r % 3 == 1 ? 80 : 10;
  };  // every ninth pixel, each block's middle
  write_raster(f / "lc.tif", s);
  ImportPlan plan;
  plan.sources = {source(Kind::land_cover, f / "lc.tif")};
  plan.sources[0].classes = *class_set("worldcover");
  plan.spacing_m = 3;
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const world::types::LandCover cover(w.world().schema());
  EXPECT_EQ(*w.world().get(w.nodes("LandCover")[0], cover.classes), "forest_floor");
}

TEST(Imagery, IsDrapedWithItsColoursAndBlackIsKeptApartFromNothing) {
  const Folder f;
  RasterSpec s;
  s.width = s.height = 64;
  s.bands = 3;
  s.crs = "EPSG:32632";
  s.geotransform = {500'000, 2, 0, 5'200'000, 0, -2};
  s.type = GDT_Byte;
  s.value = [](int c, int, int b) { return c < 32 ? (b == 1 ? 200 : 30) : 0; };
  write_raster(f / "img.tif", s);
  ImportPlan plan;
  plan.sources = {source(Kind::imagery, f / "img.tif")};
  plan.half_extent_m = 100;
  plan.spacing_m = 2;
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const world::types::Imagery image(w.world().schema());
  const auto snapshot = w.world();
  const auto n = w.nodes("Imagery")[0];
  const auto rgb = snapshot.get(n, image.rgb)->as<std::uint8_t>();
  const auto columns = static_cast<std::size_t>(*snapshot.get(n, image.columns));
  const auto pixel = [&](double x, double y) {
    const auto at = static_cast<std::size_t>(std::lround((100 - y) / 2)) * columns +
                    static_cast<std::size_t>(std::lround((x + 100) / 2));
    return std::array<int, 3>{rgb[at * 3], rgb[at * 3 + 1], rgb[at * 3 + 2]};
  };
  EXPECT_EQ(pixel(-30, 0), (std::array<int, 3>{200, 30, 30}));
  EXPECT_EQ(pixel(30, 0), (std::array<int, 3>{1, 1, 1}));
  EXPECT_EQ(pixel(90, 0), (std::array<int, 3>{0, 0, 0}));
  s.type = GDT_UInt16;
  write_raster(f / "16.tif", s);
  plan.sources[0].location = f / "16.tif";
  EXPECT_NE(import(plan).complaint().find("8 bits"), std::string::npos);
}

TEST(Grid, AMillionCellsTakeAboutASecond) {
  const Folder f;
  RasterSpec s;
  s.width = s.height = 1200;
  s.crs = "EPSG:32632";
  s.geotransform = {500'000, 1, 0, 5'200'000, 0, -1};
  s.value = [](int c, int r, int) { return 300 + 20 * std::sin(c * 0.01) + 10 * std::cos(r * 0.013); };
  write_raster(f / "dem.tif", s);
  ImportPlan plan;
  plan.sources = {source(Kind::elevation, f / "dem.tif")};
  plan.half_extent_m = 500;
  plan.spacing_m = 1;
  const auto t0 = std::chrono::steady_clock::now();
  const Imported w = import(plan);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - t0).count();
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_EQ(terrain_of(w.world()).columns, 1001);
  RecordProperty("seconds", std::to_string(seconds));
  std::printf("1001 x 1001 cells in %.2f s\n", seconds);
}

TEST(Grid, TooManyCellsAreRefusedWithWhatToDo) {
  const Folder f;
  RasterSpec s;
  s.geotransform = {8, 0.1, 0, 47, 0, -0.1};
  write_raster(f / "big.tif", s);
  auto plan = plan_of(f / "big.tif", {46.9, 8.1, 0}, 20'000, 0.5);
  EXPECT_NE(import(plan).complaint().find("spacing_m"), std::string::npos);
}

TEST(Elevation, ARasterThatSpansNothingIsRefused) {
  const Folder f;
  RasterSpec r;
  r.width = r.height = 1;
  r.geotransform = {8.2, 0.001, 0, 46.8, 0, -0.001};
  r.value = [](int, int, int) { return 500.0; };
  write_raster(f / "one.tif", r);
  ImportPlan plan;
  plan.sources = {source(ImportSource::Kind::elevation, f / "one.tif")};
  const Imported one = import(plan);
  ASSERT_FALSE(one.report);
  EXPECT_EQ(one.report.error().code, ErrorCode::bad_input);
  EXPECT_NE(one.complaint().find("expected elevation that makes a terrain of at least 2 x 2 points"),
            std::string::npos)
      << one.complaint();
  EXPECT_NE(one.complaint().find("the raster's cells are"), std::string::npos) << one.complaint();

  // Many cells, of which the wanted extent holds one.
  r.width = r.height = 50;
  write_raster(f / "many.tif", r);
  plan.sources = {source(ImportSource::Kind::elevation, f / "many.tif")};
  plan.half_extent_m = 5;
  const Imported narrow = import(plan);
  ASSERT_FALSE(narrow.report);
  EXPECT_NE(narrow.complaint().find("the wanted extent is 5 m on each side"), std::string::npos)
      << narrow.complaint();
  EXPECT_EQ(narrow.world().node_count(), 0u);
  plan.half_extent_m = 500;
  EXPECT_TRUE(import(plan).report) << import(plan).complaint();
}

TEST(RealRasters, EachOfTheCollectionIsImportedOrRefusedWithItsReason) {
  const std::string folder = shared_data("gis_rasters");
  if (folder.empty()) GTEST_SKIP() << "no test data: gis_rasters";
  ImportPlan plan;
  plan.spacing_m = 1000;
  plan.sources = {source(Kind::imagery, folder + "/RGB.byte.tif")};
  Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_NEAR(w.report->anchor.latitude_deg, 24.56, 0.05);
  EXPECT_NEAR(w.report->anchor.longitude_deg, -77.76, 0.05);
  EXPECT_NE(w.warnings().find("no picture"), std::string::npos) << "its edges have none";

  plan.spacing_m = 0;
  plan.sources = {source(Kind::elevation, folder + "/shade.tif")};
  w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  // 9.55 m of Web Mercator are 9.55·cos(39.6°) m on the ground.
  EXPECT_NEAR(terrain_of(w.world()).spacing_m, 9.5546 * std::cos(39.608 * M_PI / 180), 0.03);

  plan.sources = {source(Kind::elevation, folder + "/float_raster_with_nodata.tif")};
  w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  for (const float z : terrain_of(w.world()).z) EXPECT_FALSE(z < -1e4) << "nodata is no height";

  for (const char* name : {"/rotated.tif", "/float_nan.tif"}) {
    plan.sources = {source(Kind::elevation, folder + name)};
    EXPECT_NE(import(plan).complaint().find("reference system"), std::string::npos) << name;
    plan.sources[0].crs = "EPSG:32618";
    plan.half_extent_m = std::nullopt;
    w = import(plan);
    ASSERT_TRUE(w.report) << name << w.complaint();
  }
  std::size_t holes = 0;
  const auto z = terrain_of(w.world()).z;
  for (const float v : z) holes += std::isnan(v);
  EXPECT_GT(holes, 0u);
  EXPECT_LT(holes, z.size());
}

TEST(RealRasters, SrtmOfTheRockyMountainsBecomesTerrain) {
  const std::string file = shared_data("dem_srtm/srtmgl3_n40_w105.asc");
  if (file.empty()) GTEST_SKIP() << "no test data: dem_srtm";
  ImportPlan plan;
  plan.sources = {source(Kind::elevation, file)};
  EXPECT_NE(import(plan).complaint().find("reference system"), std::string::npos);
  plan.sources[0].crs = "EPSG:4326";
  plan.sources[0].heights_above_geoid = true;
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_NEAR(w.report->anchor.latitude_deg, 40.15, 0.01);
  EXPECT_GT(w.report->anchor.height_m, 2000);
  const auto t = terrain_of(w.world());
  EXPECT_GT(t.columns, 130);
  std::size_t holes = 0;
  for (const float v : t.z) holes += std::isnan(v);
  EXPECT_LT(static_cast<double>(holes), 0.02 * static_cast<double>(t.z.size()))
      << "only where the ENU rectangle leaves the tile";
}

}  // namespace
}  // namespace rigor::gis::test
