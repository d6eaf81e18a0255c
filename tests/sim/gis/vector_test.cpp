// Vector layers to buildings, roads, fences, poles, waters, trees and covers: each hard case by its name.
#include <ogrsf_frmts.h>

#include <GeographicLib/LocalCartesian.hpp>
#include <cstdlib>
#include <fstream>

#include "sim/gis/osm.h"
#include "tests/sim/gis/gis_test_support.h"

namespace rigor::gis::test {
namespace {

using Kind = ImportSource::Kind;
using world::Vector3;

// Features in metres around 46.8, 8.2, as GeoJSON on WGS84.
std::string lonlat(double x, double y) {
  const GeographicLib::LocalCartesian frame(46.8, 8.2, 0);
  double lat = 0, lon = 0, h = 0;
  frame.Reverse(x, y, -(x * x + y * y) / 2 / 6371e3, lat, lon, h);
  char text[64];
  std::snprintf(text, sizeof text, "[%.12f,%.12f]", lon, lat);
  return text;
}
std::string ring(const std::vector<std::pair<double, double>>& points) {
  std::string all;
  for (const auto& [x, y] : points) all += (all.empty() ? "[" : ",") + lonlat(x, y);
  return all + "," + lonlat(points[0].first, points[0].second) + "]";
}
std::string feature(const std::string& type, const std::string& coordinates,
                    const std::string& properties = "") {
  return R"({"type":"Feature","properties":{)" + properties + R"(},"geometry":{"type":")" + type +
         R"(","coordinates":)" + coordinates + "}}";
}
std::string collection(const std::vector<std::string>& features) {
  std::string all;
  for (const auto& f : features) all += (all.empty() ? "" : ",\n") + f;
  return R"({"type":"FeatureCollection","features":[)" + all + "]}";
}

ImportPlan plan_of(const std::string& file, const std::string& becomes) {
  ImportPlan plan;
  plan.anchor = Anchor{46.8, 8.2, 0};
  plan.sources = {source(Kind::vector, file)};
  plan.sources[0].becomes = becomes;
  return plan;
}

double area_of(std::span<const double> ring) {
  double twice = 0;
  for (std::size_t i = 0; i < ring.size(); i += 2) {
    const std::size_t j = (i + 2) % ring.size();
    twice += ring[i] * ring[j + 1] - ring[j] * ring[i + 1];
  }
  return twice / 2;
}

TEST(Vectors, AFootprintKeepsItsShapeHolesAndColumns) {
  const Folder f;
  // Clockwise outside: GeoJSON's writers do as they like; the world has it anticlockwise.
  f.write("b.geojson", collection({feature("Polygon",
                                           "[" + ring({{0, 0}, {0, 20}, {30, 20}, {30, 0}}) + "," +
                                               ring({{10, 5}, {20, 5}, {20, 15}, {10, 15}}) + "]",
                                           R"("HEIGHT":9.5,"ROOF":"gabled","N":"town hall")")}));
  auto plan = plan_of(f / "b.geojson", "building");
  plan.sources[0].columns = {{"height_m", "HEIGHT"}, {"roof_shape", "ROOF"}, {"name", "N"}};
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const world::types::Building b(w.world().schema());
  const auto n = w.nodes("Building");
  ASSERT_EQ(n.size(), 1u);
  const auto snapshot = w.world();
  const auto outer = snapshot.get(n[0], b.footprint)->span();
  ASSERT_EQ(outer.size(), 8u) << "not closed";
  EXPECT_NEAR(area_of(outer), 600, 0.01);
  const auto holes = snapshot.get(n[0], b.holes)->span();
  ASSERT_EQ(holes.size(), 9u);
  EXPECT_EQ(holes[0], 8);
  EXPECT_NEAR(area_of(holes.subspan(1)), -100, 0.01);
  EXPECT_EQ(*snapshot.get(n[0], b.height_m), 9.5);
  EXPECT_EQ(*snapshot.get(n[0], b.roof_shape), "gabled");
  EXPECT_EQ(*snapshot.get(n[0], b.name), "town hall");
}

TEST(Vectors, AFootprintThatCrossesItselfIsMendedAndOneWithoutAreaLeftOut) {
  const Folder f;
  f.write("b.geojson", collection({feature("Polygon", "[" + ring({{0, 0}, {20, 20}, {20, 0}, {0, 20}}) + "]"),
                                   feature("Polygon", "[" + ring({{50, 0}, {60, 0}, {70, 0}}) + "]"),
                                   feature("Polygon", "[" + ring({{90, 0}, {90, 0}, {90, 0}}) + "]")}));
  const Imported w = import(plan_of(f / "b.geojson", "building"));
  ASSERT_TRUE(w.report) << w.complaint();
  const world::types::Building b(w.world().schema());
  double area = 0;
  const auto snapshot = w.world();
  for (const auto n : w.nodes("Building")) area += area_of(snapshot.get(n, b.footprint)->span());
  EXPECT_EQ(w.nodes("Building").size(), 2u) << "a bow tie is two triangles";
  EXPECT_NEAR(area, 200, 0.01);
  EXPECT_NE(w.warnings().find("mended"), std::string::npos) << w.warnings();
  EXPECT_NE(w.warnings().find("without an area"), std::string::npos) << w.warnings();
}

TEST(Vectors, VerticesAreExactFarFromTheAnchorInAnyReferenceSystem) {
  const Folder f;
  // The same line in UTM and on WGS84, 100 km away; vertices against the formula, not against each other.
  const auto at_place = [](double lat, double lon) {
    Vector3 v;
    GeographicLib::LocalCartesian(46.8, 8.2, 0).Forward(lat, lon, 0, v.x(), v.y(), v.z());
    return v;
  };
  OGRSpatialReference utm, geo;
  utm.SetFromUserInput("EPSG:32632");
  geo.importFromEPSG(4326);
  geo.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  auto* t = OGRCreateCoordinateTransformation(&geo, &utm);
  double x[2] = {9.4, 9.5}, y[2] = {47.2, 47.25};
  const double lon[2] = {x[0], x[1]}, lat[2] = {y[0], y[1]};
  t->Transform(2, x, y);
  delete t;
  char text[300];
  std::snprintf(text, sizeof text, "[[%.6f,%.6f],[%.6f,%.6f]]", x[0], y[0], x[1], y[1]);
  std::string utm_json = collection({feature("LineString", text)});
  utm_json.insert(1, R"("crs":{"type":"name","properties":{"name":"urn:ogc:def:crs:EPSG::32632"}},)");
  f.write("utm.geojson", utm_json);
  const Imported w = import(plan_of(f / "utm.geojson", "road"));
  ASSERT_TRUE(w.report) << w.complaint();
  const world::types::Road road(w.world().schema());
  const auto snapshot = w.world();
  const auto line = snapshot.get(w.nodes("Road")[0], road.line)->span();
  ASSERT_EQ(line.size(), 4u);
  for (int i = 0; i < 2; ++i) {
    const Vector3 v = at_place(lat[i], lon[i]);
    EXPECT_GT(v.norm(), 1e5);
    EXPECT_NEAR(line[static_cast<std::size_t>(2 * i)], v.x(), 1e-3);
    EXPECT_NEAR(line[static_cast<std::size_t>(2 * i + 1)], v.y(), 1e-3);
  }
}

TEST(Vectors, OverTheAntimeridianALineStaysShort) {
  const Folder f;
  f.write("r.geojson",
          collection({feature("MultiLineString", "[[[179.999,10],[180,10]],[[-180,10],[-179.999,10]]]")}));
  auto plan = plan_of(f / "r.geojson", "road");
  plan.anchor.reset();
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_NEAR(std::abs(w.report->anchor.longitude_deg), 180, 1e-6);
  const world::types::Road road(w.world().schema());
  const auto snapshot = w.world();
  double length = 0;
  for (const auto n : w.nodes("Road")) {
    const auto l = snapshot.get(n, road.line)->span();
    length += std::hypot(l[2] - l[0], l[3] - l[1]);
  }
  EXPECT_NEAR(length, 0.002 * M_PI / 180 * 6378137 * std::cos(10 * M_PI / 180), 1);
}

TEST(Vectors, WhatLiesOutsideIsLeftOutAndLinesAreCut) {
  const Folder f;
  f.write("r.geojson",
          collection({feature("LineString", "[" + lonlat(-500, 0) + "," + lonlat(500, 0) + "]"),
                      feature("LineString", "[" + lonlat(500, 0) + "," + lonlat(600, 0) + "]"),
                      feature("LineString", "[[-171.8,-46.8],[-171.7,-46.8]]")}));  // the antipodes
  auto plan = plan_of(f / "r.geojson", "fence");
  plan.half_extent_m = 100;
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const auto n = w.nodes("Fence");
  ASSERT_EQ(n.size(), 1u);
  const auto snapshot = w.world();
  const auto line = snapshot.get(n[0], world::types::Fence(snapshot.schema()).line)->span();
  EXPECT_NEAR(line[0], -100, 1e-6);
  EXPECT_NEAR(line[2], 100, 1e-6);
}

TEST(Vectors, AnEmptyLayerIsNoError) {
  const Folder f;
  f.write("none.geojson", collection({}));
  const Imported w = import(plan_of(f / "none.geojson", "road"));
  ASSERT_TRUE(w.report) << w.complaint();
  EXPECT_NE(w.warnings().find("no features"), std::string::npos);
  auto plan = plan_of(f / "none.geojson", "road");
  plan.anchor.reset();
  EXPECT_NE(import(plan).complaint().find("anchor"), std::string::npos);
}

void write_layer(const std::string& file, const char* driver, const char* name, const char* crs_text,
                 int count) {
  GDALAllRegister();
  auto* d =
      GetGDALDriverManager()->GetDriverByName(driver)->Create(file.c_str(), 0, 0, 0, GDT_Unknown, nullptr);
  OGRSpatialReference crs;
  if (crs_text) crs.SetFromUserInput(crs_text);
  OGRLayer* layer = d->CreateLayer(name, crs_text ? &crs : nullptr, wkbPoint);
  OGRFieldDefn height("HOEHE", OFTReal);
  layer->CreateField(&height);
  ASSERT_EQ(layer->StartTransaction(), OGRERR_NONE);
  for (int i = 0; i < count; ++i) {
    OGRFeature feature(layer->GetLayerDefn());
    feature.SetField("HOEHE", 5.0 + i % 7);
    OGRPoint p(500'000 + i, 5'183'000);
    feature.SetGeometry(&p);
    ASSERT_EQ(layer->CreateFeature(&feature), OGRERR_NONE);
  }
  ASSERT_EQ(layer->CommitTransaction(), OGRERR_NONE);
  GDALClose(d);
}

TEST(Vectors, ALayerWithoutAReferenceSystemIsAskedForAndNotGuessed) {
  const Folder f;
  write_layer(f / "bare.shp", "ESRI Shapefile", "bare", nullptr, 3);
  auto plan = plan_of(f / "bare.shp", "pole");
  plan.anchor.reset();
  const Imported w = import(plan);
  ASSERT_FALSE(w.report);
  EXPECT_NE(w.complaint().find("reference system"), std::string::npos) << w.complaint();
  EXPECT_NE(w.complaint().find("layer bare"), std::string::npos) << w.complaint();
  plan.sources[0].crs = "EPSG:32632";
  plan.sources[0].columns = {{"height_m", "HOEHE"}};
  const Imported good = import(plan);
  ASSERT_TRUE(good.report) << good.complaint();
  EXPECT_NEAR(good.report->anchor.longitude_deg, 9, 0.01);
  const auto snapshot = good.world();
  const world::types::Pole pole(snapshot.schema());
  EXPECT_EQ(*snapshot.get(good.nodes("Pole")[1], pole.height_m), 6);
}

TEST(Vectors, AGeoPackageCutShortLeavesTheWorldAsItWas) {
  const Folder f;
  write_layer(f / "whole.gpkg", "GPKG", "poles", "EPSG:32632", 5000);
  auto plan = plan_of(f / "whole.gpkg", "pole");
  plan.anchor.reset();
  ASSERT_EQ(import(plan).nodes("Pole").size(), 5000u);
  std::ifstream in(f / "whole.gpkg", std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), {});
  plan.sources[0].location = f / "cut.gpkg";
  for (const double share : {0.0, 0.1, 0.4, 0.7, 0.9}) {
    f.write("cut.gpkg", bytes.substr(0, static_cast<std::size_t>(static_cast<double>(bytes.size()) * share)));
    const Imported w = import(plan);
    ASSERT_FALSE(w.report) << share << " gave " << w.nodes("Pole").size();
    EXPECT_EQ(w.report.error().code, ErrorCode::bad_input) << w.complaint();
    EXPECT_EQ(w.world().node_count(), 0u);
  }
  const std::string json = collection({feature("Point", lonlat(0, 0)), feature("Point", lonlat(5, 0))});
  f.write("cut.geojson", json.substr(0, json.size() * 2 / 3));
  EXPECT_EQ(import(plan_of(f / "cut.geojson", "pole")).report.error().code, ErrorCode::bad_input);
}

TEST(Vectors, ALayerOfSeveralMustBeNamed) {
  const Folder f;
  write_layer(f / "two.gpkg", "GPKG", "poles", "EPSG:32632", 2);
  {
    GDALDataset* d = GDALDataset::Open((f / "two.gpkg").c_str(), GDAL_OF_VECTOR | GDAL_OF_UPDATE);
    OGRSpatialReference crs;
    crs.importFromEPSG(32632);
    d->CreateLayer("masts", &crs, wkbPoint);
    GDALClose(d);
  }
  auto plan = plan_of(f / "two.gpkg", "pole");
  EXPECT_NE(import(plan).complaint().find("poles, masts"), std::string::npos) << import(plan).complaint();
  plan.sources[0].layer = "poles";
  EXPECT_TRUE(import(plan).report);
  plan.sources[0].layer = "pole";
  EXPECT_FALSE(import(plan).report);
  plan.sources[0].layer = "poles";
  plan.sources[0].columns = {{"height_m", "HOHE"}};
  EXPECT_NE(import(plan).complaint().find("HOEHE"), std::string::npos) << "the nearest column is offered";
  plan.sources[0].columns = {{"hight_m", "HOEHE"}};
  EXPECT_NE(import(plan).complaint().find("did you mean height_m"), std::string::npos)
      << import(plan).complaint();
  plan.sources[0].columns.clear();
  plan.sources[0].becomes = "mast";
  EXPECT_NE(import(plan).complaint().find("becomes"), std::string::npos);
}

TEST(Vectors, AreasOfCoverAreBurntWithHolesAndTheSmallerWins) {
  const Folder f;
  f.write("wood.geojson",
          collection({feature("Polygon", "[" + ring({{-50, -50}, {50, -50}, {50, 50}, {-50, 50}}) + "," +
                                             ring({{-10, -10}, {10, -10}, {10, 10}, {-10, 10}}) + "]")}));
  f.write("rock.geojson",
          collection(
              {feature("Polygon", "[" + ring({{-100, -100}, {100, -100}, {100, 100}, {-100, 100}}) + "]")}));
  auto plan = plan_of(f / "wood.geojson", "forest_floor");
  plan.sources.push_back(source(Kind::vector, f / "rock.geojson"));
  plan.sources[1].becomes = "rock";
  plan.half_extent_m = 120;
  plan.spacing_m = 1;
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const auto snapshot = w.world();
  const world::types::LandCover cover(snapshot.schema());
  const auto n = w.nodes("LandCover")[0];
  EXPECT_EQ(*snapshot.get(n, cover.classes), "forest_floor rock");
  const auto cells = snapshot.get(n, cover.cells)->as<std::uint8_t>();
  const auto at = [&](double x, double y) {
    return int{cells[static_cast<std::size_t>(std::lround(120 - y) * 241 + std::lround(x + 120))]};
  };
  EXPECT_EQ(at(30, 30), 0);
  EXPECT_EQ(at(0, 0), 1);
  EXPECT_EQ(at(80, -80), 1);
  EXPECT_EQ(at(110, 0), 255);
}

TEST(Osm, TagsBecomeNodesWithTheirSizes) {
  const Folder f;
  std::string nodes, ways;
  int next = 1;
  const auto node = [&](double x, double y, const std::string& tags = "") {
    const std::string p = lonlat(x, y);
    const auto comma = p.find(',');
    nodes += "<node id='" + std::to_string(next) + "' version='1' lon='" + p.substr(1, comma - 1) +
             "' lat='" + p.substr(comma + 1, p.size() - comma - 2) + "'>" + tags + "</node>\n";
    return next++;
  };
  const auto tag = [](const char* k, const char* v) {
    return "<tag k='" + std::string(k) + "' v='" + v + "'/>";
  };
  const auto way = [&](int id, const std::vector<std::pair<double, double>>& points, bool closed,
                       const std::string& tags) {
    std::string refs;
    int first = 0;
    for (const auto& [x, y] : points) {
      const int n = node(x, y);
      if (!first) first = n;
      refs += "<nd ref='" + std::to_string(n) + "'/>";
    }
    if (closed) refs += "<nd ref='" + std::to_string(first) + "'/>";
    ways += "<way id='" + std::to_string(id) + "' version='1'>" + refs + tags + "</way>\n";
  };
  way(1, {{0, 0}, {20, 0}, {20, 10}, {0, 10}}, true,
      tag("building", "house") + tag("building:levels", "2") + tag("name", "Mill"));
  way(2, {{40, 0}, {60, 0}, {60, 10}, {40, 10}}, true,
      tag("building", "yes") + tag("height", "12 m") + tag("roof:shape", "hipped") + tag("roof:height", "4"));
  way(3, {{0, 30}, {100, 30}}, false, tag("highway", "residential"));
  way(4, {{0, 40}, {100, 40}}, false, tag("highway", "track") + tag("width", "2.5"));
  way(5, {{0, 50}, {100, 50}}, false, tag("highway", "primary") + tag("tunnel", "yes"));
  way(6, {{0, 60}, {100, 60}}, false,
      tag("barrier", "fence") + tag("fence_type", "wood") + tag("height", "1.8"));
  way(7, {{0, 80}, {30, 80}, {30, 100}, {0, 100}}, true, tag("natural", "water"));
  way(8, {{-100, -100}, {-50, -100}, {-50, -50}, {-100, -50}}, true, tag("landuse", "forest"));
  node(5, -20,
       tag("natural", "tree") + tag("species", "Quercus robur") + tag("circumference", "3.1416") +
           tag("height", "21"));
  node(15, -20, tag("power", "pole"));
  node(25, -20, tag("highway", "street_lamp") + tag("height", "5"));
  node(35, -20, tag("amenity", "bench"));
  f.write("town.osm", "<?xml version='1.0'?><osm version='0.6'>\n" + nodes + ways + "</osm>\n");
  auto plan = plan_of(f / "town.osm", "");
  plan.half_extent_m = 200;
  const Imported w = import(plan);
  ASSERT_TRUE(w.report) << w.complaint();
  const auto s = w.world();
  const world::types::Building b(s.schema());
  ASSERT_EQ(w.nodes("Building").size(), 2u);
  for (const auto n : w.nodes("Building")) {
    if (*s.get(n, b.name) == "Mill") {
      EXPECT_EQ(*s.get(n, b.height_m), 6);
      EXPECT_EQ(*s.get(n, b.roof_shape), "gabled");
    } else {
      EXPECT_EQ(*s.get(n, b.height_m), 8) << "the eaves: 12 m to the ridge, 4 m of roof";
      EXPECT_EQ(*s.get(n, b.roof_shape), "hipped");
      EXPECT_EQ(*s.get(n, b.roof_height_m), 4);
    }
  }
  const world::types::Road road(s.schema());
  ASSERT_EQ(w.nodes("Road").size(), 2u) << "no tunnel";
  EXPECT_EQ(*s.get(w.nodes("Road")[0], road.width_m), 5.5);
  EXPECT_EQ(*s.get(w.nodes("Road")[1], road.width_m), 2.5);
  EXPECT_EQ(*s.get(w.nodes("Road")[1], road.surface), "gravel");
  const world::types::Fence fence(s.schema());
  ASSERT_EQ(w.nodes("Fence").size(), 1u);
  EXPECT_EQ(*s.get(w.nodes("Fence")[0], fence.style), "boards");
  EXPECT_EQ(*s.get(w.nodes("Fence")[0], fence.height_m), 1.8);
  const world::types::Tree tree(s.schema());
  ASSERT_EQ(w.nodes("Tree").size(), 1u);
  EXPECT_NEAR(*s.get(w.nodes("Tree")[0], tree.dbh_m), 1, 1e-4);
  EXPECT_EQ(*s.get(w.nodes("Tree")[0], tree.height_m), 21);
  EXPECT_EQ(w.nodes("Pole").size(), 2u);
  EXPECT_EQ(w.nodes("Water").size(), 1u);
  EXPECT_EQ(*s.get(w.nodes("LandCover")[0], world::types::LandCover(s.schema()).classes),
            "water forest_floor");
}

TEST(Osm, LengthsAndTagsAreReadAsPeopleWriteThem) {
  EXPECT_EQ(osm_length_m("12"), 12);
  EXPECT_EQ(osm_length_m("12.5 m"), 12.5);
  EXPECT_EQ(osm_length_m("2 km"), 2000);
  EXPECT_NEAR(*osm_length_m("40 ft"), 12.192, 1e-9);
  EXPECT_NEAR(*osm_length_m("7'6\""), 2.286, 1e-9);
  for (const char* bad : {"", "tall", "12;13", "-3", "m"}) EXPECT_FALSE(osm_length_m(bad)) << bad;
  const Tags tags = parse_hstore(R"("a"=>"b","quote \" and \\"=>"x, y","empty"=>"")");
  ASSERT_EQ(tags.size(), 3u);
  EXPECT_EQ(tags[1].first, "quote \" and \\");
  EXPECT_EQ(tags[1].second, "x, y");
  EXPECT_TRUE(parse_hstore(R"("a"=>"b)").empty()) << "cut short";
}

}  // namespace
}  // namespace rigor::gis::test
