// A world's own materials.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <functional>
#include <opencv2/imgcodecs.hpp>

#include "sim/render/content/surface_library.h"
#include "sim/world/graph/database.h"
#include "sim/world/semantic_types.h"

namespace rigor::render {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using world::Numbers;

std::unique_ptr<world::Database> new_world() {
  auto db = world::Database::create();
  EXPECT_TRUE(world::define_semantic_types(*db));
  return db;
}

struct SurfaceOf : testing::Test {
  std::unique_ptr<world::Database> db = new_world();
  world::types::Material material{db->schema()};

  NodeId make(const std::vector<std::pair<std::string, world::Value>>& values,
              const std::string& type = "Material") {
    auto tx = db->begin("test");
    const NodeId n = *tx.create(type);
    for (const auto& [name, value] : values) EXPECT_TRUE(tx.set(n, name, value)) << name;
    EXPECT_TRUE(tx.commit());
    return n;
  }
  Result<std::shared_ptr<const Surface>> surface(NodeId n, const fs::path& base_dir = "/") {
    return surface_of(db->snapshot(), n, base_dir);
  }
};

TEST_F(SurfaceOf, TakesEveryAttribute) {
  const auto s = surface(make({{"name", std::string("own")},
                               {"reflectance", Numbers{0.1, 0.2, 0.3, 0.4, 0.5, 0.6}},
                               {"transmittance", Numbers{0, 0, 0, 0.1, 0, 0}},
                               {"roughness", 0.25},
                               {"retro_reflection", 0.125},
                               {"metallic", 0.75}}));
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ((*s)->name, "own");
  EXPECT_EQ((*s)->reflectance, (Spectrum{0.1F, 0.2F, 0.3F, 0.4F, 0.5F, 0.6F}));
  EXPECT_EQ((*s)->transmittance[3], 0.1F);
  EXPECT_TRUE((*s)->two_sided);
  EXPECT_EQ((*s)->roughness, 0.25F);
  EXPECT_EQ((*s)->retro_reflection, 0.125F);
  EXPECT_EQ((*s)->metallic, 0.75F);
  EXPECT_EQ((*s)->colour_map, nullptr);
}

TEST_F(SurfaceOf, HasTheDefaultsOfTheSchema) {
  const auto s = surface(make({}));
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ((*s)->reflectance, Surface{}.reflectance);
  EXPECT_FALSE((*s)->two_sided);
  EXPECT_TRUE((*s)->takes_snow);
}

TEST_F(SurfaceOf, WhatANodeCannotSayComesFromTheBuiltinOfItsName) {
  const auto s = surface(make({{"name", std::string("water")}}));
  ASSERT_TRUE(s);
  EXPECT_TRUE((*s)->water);
  EXPECT_FALSE((*s)->takes_snow);
  EXPECT_EQ((*s)->reflectance[0], 0.5F);
}

TEST_F(SurfaceOf, SaysWhatIsWrong) {
  EXPECT_EQ(surface(NodeId{99}).error().code, ErrorCode::not_found);
  EXPECT_EQ(surface(NodeId{}).error().code, ErrorCode::not_found);
  EXPECT_THAT(surface(make({}, "Place")).error().text(), HasSubstr("got a Place"));
  EXPECT_THAT(surface(make({{"reflectance", Numbers{0.5, 0.5, 0.5, 0.5}}})).error().text(),
              HasSubstr("got 4"));
  EXPECT_THAT(surface(make({{"reflectance", Numbers{}}})).error().text(), HasSubstr("got 0"));
  const auto bright =
      surface(make({{"name", std::string("sun")}, {"transmittance", Numbers{0, 0, 0, 0, 0, 0.6}}}));
  ASSERT_FALSE(bright);
  EXPECT_THAT(bright.error().text(), HasSubstr("(sun)"));
  EXPECT_THAT(bright.error().text(), HasSubstr("1550_nm"));
}

TEST_F(SurfaceOf, LoadsMapsRelativeToTheWorld) {
  const auto folder = fs::temp_directory_path() / ("rigor_surface_of_" + std::to_string(::getpid()));
  fs::create_directories(folder / "maps");
  ASSERT_TRUE(cv::imwrite((folder / "maps/m.png").string(), cv::Mat(2, 4, CV_8UC3, cv::Scalar(1, 2, 3))));
  const std::string file = "maps/m.png";
  const NodeId n = make({{"colour_map", file}, {"normal_map", file}, {"gloss_map", file}});
  const auto s = surface(n, folder);
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ((*s)->colour_map->width, 4U);
  EXPECT_TRUE((*s)->colour_map->srgb);
  EXPECT_FALSE((*s)->normal_map->srgb);
  EXPECT_FALSE((*s)->gloss_map->srgb);
  const auto absent = surface(n, folder / "elsewhere");
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().code, ErrorCode::not_found);
  EXPECT_THAT(absent.error().text(), HasSubstr("elsewhere/maps/m.png"));
  fs::remove_all(folder);
}

}  // namespace
}  // namespace rigor::render
