// Tree lists, weather, and plans.
#include <GeographicLib/LocalCartesian.hpp>

#include "sim/gis/csv.h"
#include "sim/gis/tree_list.h"
#include "sim/world/store/world_file.h"
#include "tests/sim/gis/gis_test_support.h"

namespace rigor::gis::test {
namespace {

using Kind = ImportSource::Kind;

ImportPlan plan_of(const std::string& file, std::string crs = "") {
  ImportPlan plan;
  plan.anchor = Anchor{46.8, 8.2, 500};
  plan.sources = {source(Kind::trees, file)};
  plan.sources[0].crs = std::move(crs);
  return plan;
}

TEST(Trees, ZeroMissingAndGiantDiametersAreWhatTheyAre) {
  const Folder f;
  f.write("t.csv", "tree_id,species,dbh_cm,x,y\n1,TSHE,0,0,0\n2,,55,3,4\n3,PSME,300,10,0\n4,NA,NA,12,0\n");
  const Imported w = import(plan_of(f / "t.csv", "local"));
  ASSERT_TRUE(w.report) << w.complaint();
  const auto s = w.world();
  const world::types::Tree t(s.schema());
  const auto n = w.nodes("Tree");
  ASSERT_EQ(n.size(), 4u);
  EXPECT_EQ(*s.get(n[0], t.dbh_m), 0) << "unknown: from the allometry";
  EXPECT_EQ(*s.get(n[1], t.species), "");
  EXPECT_DOUBLE_EQ(*s.get(n[1], t.dbh_m), 0.55);
  EXPECT_DOUBLE_EQ(*s.get(n[2], t.dbh_m), 3.0) << "a giant is no error";
  EXPECT_EQ(*s.get(n[3], t.species), "");
  EXPECT_EQ(*s.get(n[3], t.dbh_m), 0);
  EXPECT_NE(w.warnings().find("2 trees without a diameter"), std::string::npos) << w.warnings();
  EXPECT_NE(w.warnings().find("2 trees without a species"), std::string::npos) << w.warnings();
}

TEST(Trees, OfADuplicateIdTheFirstIsKept) {
  const Folder f;
  f.write("t.csv", "tree_id;species;dbh_m;x_m;y_m\n7;ABAM;0.3;1;1\n8;ABAM;0.4;2;2\n7;TSHE;0.5;3;3\n");
  const Imported w = import(plan_of(f / "t.csv", "local"));
  ASSERT_TRUE(w.report) << w.complaint();
  ASSERT_EQ(w.nodes("Tree").size(), 2u);
  EXPECT_NE(w.warnings().find("t.csv:4"), std::string::npos) << w.warnings();
}

TEST(Trees, AWrongUnitIsSeenAndAnUnnamedOneAskedFor) {
  const Folder f;
  f.write("cm.csv", "x,y,dbh_m\n0,0,35\n1,1,42\n2,2,18\n");
  EXPECT_NE(import(plan_of(f / "cm.csv", "local")).complaint().find("unit"), std::string::npos);
  f.write("dbh.csv", "x,y,dbh\n0,0,35\n");
  auto plan = plan_of(f / "dbh.csv", "local");
  EXPECT_NE(import(plan).complaint().find("dbh*0.01"), std::string::npos) << import(plan).complaint();
  plan.sources[0].columns = {{"dbh_m", "dbh*0.01"}};
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_DOUBLE_EQ(*w.world().get(w.nodes("Tree")[0], world::types::Tree(w.world().schema()).dbh_m), 0.35);
}

TEST(Trees, EveryColumnCanHaveAnotherName) {
  const Folder f;
  f.write("t.csv",
          "nr,sp,E (cm),N "
          "(cm),d1_cm,d2_cm,h_dm\n1,PIAB,100,200,30,40,250\n1,PIAB,0,0,1,1,1\n2,PIAB,300,400,NA,40,100\n");
  auto plan = plan_of(f / "t.csv", "local");
  plan.sources[0].columns = {{"id", "nr"},
                             {"species", "sp"},
                             {"x", "[E (cm)] * 0.01"},
                             {"y", "[N (cm)] / 100"},
                             {"dbh_m", "(d1_cm + d2_cm) / 200"},
                             {"height_m", "h_dm * 0.1"}};
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const auto s = w.world();
  const world::types::Tree t(s.schema());
  const auto n = w.nodes("Tree");
  ASSERT_EQ(n.size(), 2u) << "of nr 1 the first is kept";
  EXPECT_DOUBLE_EQ(s.get(n[0], t.position)->x(), 1);
  EXPECT_DOUBLE_EQ(s.get(n[0], t.position)->y(), 2);
  EXPECT_DOUBLE_EQ(*s.get(n[0], t.dbh_m), 0.35);
  EXPECT_DOUBLE_EQ(*s.get(n[0], t.height_m), 25);
  EXPECT_EQ(*s.get(n[0], t.species), "PIAB");
  EXPECT_EQ(*s.get(n[1], t.dbh_m), 0) << "one of two diameters is missing: unknown";

  plan.sources[0].columns[2].second = "[E (dm)] * 0.01";
  EXPECT_NE(import(plan).complaint().find("columns: x: expected one of the columns nr, sp, E (cm)"),
            std::string::npos)
      << import(plan).complaint();
  plan.sources[0].columns[2].second = "[E (cm)] *";
  EXPECT_NE(import(plan).complaint().find("columns: x: expected a number, the name of a column"),
            std::string::npos);
  plan.sources[0].columns[2].second = "[E (cm)]";
  plan.sources[0].columns[1].second = "sp * 2";
  EXPECT_NE(import(plan).complaint().find("columns: species: expected the name of a column"),
            std::string::npos);
}

TEST(Trees, PlotsAndTheirColumnsCanHaveOtherNames) {
  const Folder f;
  f.write("t.csv", "stand,x,y,dbh_m\nA,0,0,0.3\nB,0,0,0.4\n");
  f.write("p.csv", "code,LAT_E7,LON_E7,north_rad\nA,468000000,82000000,0\nB,468100000,82000000,0\n");
  const auto plan =
      load_import_plan(f.write("plan.import.yaml",
                               "anchor: { latitude_deg: 46.8, longitude_deg: 8.2, height_m: 0 }\nsources:\n"
                               "  - trees: t.csv\n    columns: { plot: stand }\n"
                               "    plots: { file: p.csv, columns: { plot: code, latitude_deg: LAT_E7 / 1e7, "
                               "longitude_deg: LON_E7 / 1e7, "
                               "y_axis_azimuth_deg: north_rad * 57.29578 } }\n"));
  ASSERT_TRUE(plan) << plan.error().text();
  const Imported w = import(*plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const auto s = w.world();
  const world::types::Tree t(s.schema());
  ASSERT_EQ(w.nodes("Tree").size(), 2u);
  EXPECT_LT(s.get(w.nodes("Tree")[0], t.position)->head<2>().norm(), 1e-3);
  EXPECT_NEAR(s.get(w.nodes("Tree")[1], t.position)->y(), 1111.8, 1.5);

  f.write("plan.import.yaml",
          "sources:\n  - trees: t.csv\n    plots: { file: p.csv, columns: { lat: LAT_E7 } }\n");
  const auto wrong = load_import_plan(f / "plan.import.yaml");
  ASSERT_FALSE(wrong);
  EXPECT_NE(wrong.error().text().find("plots.columns.lat: unknown key"), std::string::npos)
      << wrong.error().text();
}

TEST(Trees, PlacesAreReadFromLongitudeAndLatitudeOrAReferenceSystem) {
  const Folder f;
  f.write("ll.csv", "lon,lat,dbh_m,foot_height_m\n8.2,46.8,0.3,612.5\n8.21,46.8,0.3,NA\n");
  auto plan = plan_of(f / "ll.csv");
  plan.sources[0].columns = {{"foot_height_m", "foot_height_m"}};
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const auto s = w.world();
  const world::types::Tree t(s.schema());
  const auto first = *s.get(w.nodes("Tree")[0], t.position);
  EXPECT_LT((first - world::Vector3(0, 0, 112.5)).norm(), 1e-6);
  world::Vector3 v;
  GeographicLib::LocalCartesian(46.8, 8.2, 500).Forward(46.8, 8.21, 500, v.x(), v.y(), v.z());
  EXPECT_LT((*s.get(w.nodes("Tree")[1], t.position) - v).norm(), 1e-4)
      << "no terrain: at the anchor's height";
  f.write("xy.csv", "easting,northing,dbh_m\n460000,5183000,0.3\n");
  EXPECT_NE(import(plan_of(f / "xy.csv")).complaint().find("crs"), std::string::npos) << "never guessed";
  EXPECT_TRUE(import(plan_of(f / "xy.csv", "EPSG:32632")).report);
  f.write("bad.csv", "lon,lat,dbh_m\n8.2,146.8,0.3\n");
  EXPECT_NE(import(plan_of(f / "bad.csv")).complaint().find("bad.csv:2"), std::string::npos);
  f.write("none.csv", "a,b\n1,2\n");
  EXPECT_FALSE(import(plan_of(f / "none.csv")).report);
}

TEST(Trees, AListCutShortLeavesTheWorldAsItWas) {
  const Folder f;
  f.write("t.csv", "x,y,species,dbh_m\n0,0,TSHE,0.3\n1,1,TS");
  Imported w = import(plan_of(f / "t.csv", "local"));
  ASSERT_FALSE(w.report);
  EXPECT_NE(w.complaint().find("t.csv:3"), std::string::npos) << w.complaint();
  EXPECT_NE(w.complaint().find("cut short"), std::string::npos) << w.complaint();
  EXPECT_EQ(w.world().node_count(), 0u);
  f.write("t.csv", "x,y,species,dbh_m\n0,0,TSHE,0.3\n1,1,\"TS");
  EXPECT_NE(import(plan_of(f / "t.csv", "local")).complaint().find("cut short"), std::string::npos);
  f.write("t.csv", "");
  EXPECT_FALSE(import(plan_of(f / "t.csv", "local")).report);
  f.write("t.csv", "x,y,species,dbh_m\n0,zero,TSHE,0.3\n");
  EXPECT_NE(import(plan_of(f / "t.csv", "local")).complaint().find("'zero'"), std::string::npos);
}

TEST(Trees, AllEightRealStandsAreImported) {
  const std::string folder = shared_data("forest_stands");
  if (folder.empty()) GTEST_SKIP() << "no test data: forest_stands";
  const std::pair<const char*, std::size_t> stands[] = {{"AB08", 401},  {"AE10", 695}, {"AG05", 746},
                                                        {"AM16", 643},  {"AO03", 487}, {"AR07", 454},
                                                        {"AV02", 1388}, {"AV06", 872}};
  ImportPlan all;
  all.sources = {source(Kind::trees, folder + "/trees.csv")};
  all.sources[0].plots = folder + "/stands.csv";
  std::size_t sum = 0;
  for (const auto& [stand, trees] : stands) {
    ImportPlan plan = all;
    plan.sources[0].where = std::string("stand_id=") + stand;
    const Imported w = import(plan);
    ASSERT_TRUE(w.report) << stand << w.complaint();
    EXPECT_EQ(w.nodes("Tree").size(), trees) << stand;
    sum += trees;
    // One hectare around its own middle.
    const auto s = w.world();
    const world::types::Tree t(s.schema());
    for (const auto n : w.nodes("Tree")) EXPECT_LT(s.get(n, t.position)->head<2>().norm(), 80) << stand;
  }
  const Imported w = import(all);
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_EQ(w.nodes("Tree").size(), sum);
  all.sources[0].where = "stand_id=XX99";
  EXPECT_FALSE(import(all).report) << "no tree, no place, no anchor";
}

TEST(Import, TheSameImportTwiceGivesTheSameBytes) {
  const Folder f;
  f.write("t.csv", "x,y,species,dbh_m\n0,0,TSHE,0.3\n1,1,ABAM,0.5\n");
  RasterSpec r;
  r.width = r.height = 60;
  r.geotransform = {8.19, 0.0005, 0, 46.81, 0, -0.0005};
  r.value = [](int c, int row, int) { return 500 + c * 0.37 + row * 0.11; };
  write_raster(f / "dem.tif", r);
  auto plan = plan_of(f / "t.csv", "local");
  plan.sources.push_back(source(Kind::elevation, f / "dem.tif"));
  plan.half_extent_m = 300;
  plan.spacing_m = 5;
  const std::string a = world::world_yaml(import(plan).world()), b = world::world_yaml(import(plan).world());
  EXPECT_GT(a.size(), 1000u);
  EXPECT_EQ(a, b);
}

TEST(Import, ASecondImportKeepsTheAnchorOfTheWorld) {
  const Folder f;
  f.write("t.csv", "x,y,species,dbh_m\n0,0,TSHE,0.3\n");
  Imported w = import(plan_of(f / "t.csv", "local"));
  ASSERT_TRUE(w.report) << w.complaint();
  auto again = plan_of(f / "t.csv", "local");
  again.anchor.reset();
  const auto second = import_into(*w.db, again);
  ASSERT_TRUE(second) << second.error().text();
  EXPECT_EQ(second->anchor.latitude_deg, 46.8);
  EXPECT_EQ(w.nodes("Place").size(), 1u);
  EXPECT_EQ(w.nodes("Atmosphere").size(), 1u);
  EXPECT_EQ(w.nodes("Tree").size(), 2u);
  again.anchor = Anchor{1, 2, 3};
  EXPECT_FALSE(import_into(*w.db, again));
  EXPECT_EQ(w.nodes("Tree").size(), 2u);
  ASSERT_TRUE(w.db->undo());
  EXPECT_EQ(w.nodes("Tree").size(), 1u) << "an import is one step";
}

TEST(Import, AnErrorInTheLastSourceLeavesTheWorldAsItWas) {
  const Folder f;
  f.write("t.csv", "x,y,species,dbh_m\n0,0,TSHE,0.3\n");
  auto plan = plan_of(f / "t.csv", "local");
  plan.sources.push_back(source(Kind::weather, f / "none.csv"));
  const Imported w = import(plan);
  ASSERT_FALSE(w.report);
  EXPECT_EQ(w.report.error().code, ErrorCode::not_found);
  EXPECT_EQ(w.world().node_count(), 0u);
}

TEST(Weather, RowsBecomeASeriesAndTheFirstOneTheAtmosphere) {
  const Folder f;
  f.write("w.csv",
          "time,temperature_c,cloud_cover,wind\n2024-03-01T06:00:00Z,2.5,0.4,3\n2024-03-01T08:00+01:00,NA,0."
          "6,4\n");
  ImportPlan plan;
  plan.anchor = Anchor{46.8, 8.2, 0};
  plan.sources = {source(Kind::weather, f / "w.csv")};
  plan.sources[0].columns = {{"wind_speed_m_per_s", "wind"}};
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const auto s = w.world();
  const world::types::WeatherSeries series(s.schema());
  const auto n = w.nodes("WeatherSeries");
  ASSERT_EQ(n.size(), 1u);
  EXPECT_EQ(*s.get(n[0], series.columns), "wind_speed_m_per_s cloud_cover temperature_c");
  const auto table = s.get(n[0], series.table)->span();
  const std::vector<double> expected = {1709272800, 3, 0.4, 2.5, 1709276400, 4, 0.6, 2.5};
  EXPECT_EQ(std::vector<double>(table.begin(), table.end()), expected);
  const world::types::Atmosphere air(s.schema());
  EXPECT_EQ(*s.get(w.nodes("Atmosphere")[0], air.utc_s), 1709272800);
  EXPECT_EQ(*s.get(w.nodes("Atmosphere")[0], air.temperature_c), 2.5);
  for (const char* bad :
       {"time,temperature_c\n2024-03-01T06:00:00,1\n", "time,temperature_c\n2024-13-01T06:00:00Z,1\n",
        "time,temperature_c\n2024-03-01T06:00:00Z,1\n2024-03-01T06:00:00Z,1\n",
        "time\n2024-03-01T06:00:00Z\n", "time,temperature_c\n", "temperature_c\n1\n"}) {
    plan.sources[0].columns.clear();
    f.write("w.csv", bad);
    EXPECT_FALSE(import(plan).report) << bad;
  }
}

TEST(Plan, IsReadWithPathsFromItsFolder) {
  const Folder f;
  f.write("p/plan.yaml", R"(anchor: { latitude_deg: 46.8, longitude_deg: 8.2 }
half_extent_m: 500
spacing_m: 2
utc: 2024-06-21T10:00:00Z
sources:
  - elevation: dem.asc
    crs: EPSG:25832
    heights_above_geoid: true
  - land_cover: lc.tif
    classes: { 1: grass, 2: forest_floor }
  - land_cover: esa.tif
    classes: worldcover
  - vector: roads.gpkg
    layer: roads
    becomes: road
    columns: { width_m: WIDTH }
  - trees: t.csv
    plot: { latitude_deg: 46.8, longitude_deg: 8.2, y_axis_azimuth_deg: 12 }
  - imagery: "WMS:http://127.0.0.1/x"
    layer: img
)");
  const auto plan =
      load_import_plan(f / "p/plan.yaml", {*ConfigOverride::parse("sources.4.trees=/abs/t.csv")});
  ASSERT_TRUE(plan) << plan.error().text();
  EXPECT_TRUE(std::isnan(plan->anchor->height_m));
  EXPECT_EQ(plan->utc_s, 1718964000);
  ASSERT_EQ(plan->sources.size(), 6u);
  EXPECT_EQ(plan->sources[0].location, f / "p/dem.asc");
  EXPECT_TRUE(plan->sources[0].heights_above_geoid);
  EXPECT_EQ(plan->sources[1].classes.size(), 2u);
  EXPECT_EQ(plan->sources[2].classes, *class_set("worldcover"));
  EXPECT_EQ(plan->sources[3].columns[0].second, "WIDTH");
  EXPECT_EQ(plan->sources[4].location, "/abs/t.csv");
  EXPECT_EQ(plan->sources[4].plot->y_axis_azimuth_deg, 12);
  EXPECT_EQ(plan->sources[5].location, "WMS:http://127.0.0.1/x");
}

TEST(Plan, MistakesAreNamedWithLineAndColumn) {
  const Folder f;
  const std::pair<const char*, const char*> cases[] = {
      {"sources:\n  - elevatoin: dem.asc\n", ":2:"},
      {"sources: []\n", "at least one source"},
      {"sources:\n  - elevation: a\n    imagery: b\n", "got elevation too"},
      {"sources:\n  - elevation: a\n    becomes: road\n", ":3:"},
      {"half_extent_m: -1\nsources:\n  - elevation: a\n", ":1:"},
      {"half_extend_m: 1\nsources:\n  - elevation: a\n", "half_extent_m"},
      {"anchor: { latitude_deg: 95, longitude_deg: 0 }\nsources:\n  - elevation: a\n", ":1:"},
      {"sources:\n  - land_cover: a\n    classes: corrine\n", "corine"},
      {"utc: yesterday\nsources:\n  - elevation: a\n", ":1:"},
      {"utc: 2024-06-21T24:30:00Z\nsources:\n  - elevation: a\n", ":1:"},
      {"sources:\n  - trees: a\n    where: stand\n", ":3:"}};
  for (const auto& [text, expected] : cases) {
    f.write("plan.yaml", text);
    const auto plan = load_import_plan(f / "plan.yaml");
    ASSERT_FALSE(plan) << text;
    EXPECT_EQ(plan.error().code, ErrorCode::bad_input);
    EXPECT_NE(plan.error().text().find(expected), std::string::npos) << plan.error().text();
  }
  EXPECT_EQ(load_import_plan(f / "none.yaml").error().code, ErrorCode::not_found);
}

}  // namespace
}  // namespace rigor::gis::test
