#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "sim/render/content/surface_library.h"
#include "sim/render/content/world_view.h"
#include "sim/render/models/model_file.h"
#include "sim/render/models/providers.h"
#include "sim/world/semantic_types.h"
#include "tests/sim/nature/built/mesh_checks.h"

namespace rigor::render {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

std::string base64(const void* data, std::size_t size) {
  constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  const auto* p = static_cast<const unsigned char*>(data);
  std::string out;
  for (std::size_t i = 0; i < size; i += 3) {
    std::uint32_t v = static_cast<std::uint32_t>(p[i]) << 16;
    if (i + 1 < size) v |= static_cast<std::uint32_t>(p[i + 1]) << 8;
    if (i + 2 < size) v |= p[i + 2];
    out += kDigits[v >> 18 & 63];
    out += kDigits[v >> 12 & 63];
    out += i + 1 < size ? kDigits[v >> 6 & 63] : '=';
    out += i + 2 < size ? kDigits[v & 63] : '=';
  }
  return out;
}

class Models : public testing::Test {
 protected:
  void SetUp() override {
    folder = fs::path(testing::TempDir()) / testing::UnitTest::GetInstance()->current_test_info()->name();
    fs::remove_all(folder);
    fs::create_directories(folder);
  }
  void TearDown() override { fs::remove_all(folder); }
  fs::path write(const std::string& name, const std::string& text) {
    std::ofstream(folder / name, std::ios::binary) << text;
    return folder / name;
  }
  // A unit cube as OBJ, outside anticlockwise, of one material.
  fs::path cube(const std::string& material) {
    write("cube.mtl", material);
    return write("cube.obj",
                 "mtllib cube.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n"
                 "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl paint\n"
                 "f 1/1 4/4 3/3 2/2\nf 5/1 6/2 7/3 8/4\nf 1/1 2/2 6/3 5/4\nf 2/1 3/2 7/3 6/4\nf 3/1 4/2 8/3 "
                 "7/4\nf 4/1 1/2 5/3 8/4\n");
  }
  // A triangle (1,0,0) (0,1,0) (0,0,0) below a node that mirrors x and moves by (5, 0, 0).
  static nlohmann::json triangle() {
    const float data[] = {0, 0, 0, 1, 0, 0, 0, 1, 0, /* uv */ 0, 0, 1, 0, 0, 1};
    return {
        {"asset", {{"version", "2.0"}}},
        {"scene", 0},
        {"scenes", {{{"nodes", {0}}}}},
        {"nodes", {{{"translation", {5, 0, 0}}, {"children", {1}}}, {{"mesh", 0}, {"scale", {-1, 1, 1}}}}},
        {"meshes",
         {{{"primitives", {{{"attributes", {{"POSITION", 0}, {"TEXCOORD_0", 1}}}, {"material", 0}}}}}}},
        {"accessors",
         {{{"bufferView", 0},
           {"componentType", 5126},
           {"count", 3},
           {"type", "VEC3"},
           {"min", {0, 0, 0}},
           {"max", {1, 1, 0}}},
          {{"bufferView", 1}, {"componentType", 5126}, {"count", 3}, {"type", "VEC2"}}}},
        {"bufferViews",
         {{{"buffer", 0}, {"byteOffset", 0}, {"byteLength", 36}},
          {{"buffer", 0}, {"byteOffset", 36}, {"byteLength", 24}}}},
        {"buffers",
         {{{"byteLength", 60},
           {"uri", "data:application/octet-stream;base64," + base64(data, sizeof data)}}}},
        {"materials",
         {{{"name", "Wood.001"},
           {"pbrMetallicRoughness",
            {{"baseColorFactor", {0.5, 0.4, 0.3, 1}},
             {"metallicFactor", 0.25},
             {"roughnessFactor", 0.6}}}}}}};
  }
  static std::string picture_uri(const cv::Mat& picture) {
    std::vector<unsigned char> png;
    cv::imencode(".png", picture, png);
    return "data:image/png;base64," + base64(png.data(), png.size());
  }
  fs::path folder;
};

TEST_F(Models, ObjCubeIsClosedAndOfItsSize) {
  const auto model = load_model(cube("newmtl paint\nKd 0.2 0.4 0.6\nKs 0.5 0.5 0.5\nNs 98\n"));
  ASSERT_TRUE(model) << model.error().text();
  EXPECT_TRUE(model->warnings.empty());
  EXPECT_EQ(test::open_edge_count(*model->mesh), 0);
  EXPECT_NEAR(test::volume_m3(*model->mesh), 1, 1e-6);
  ASSERT_EQ(model->mesh->parts.size(), 1U);
  const Surface& s = *model->mesh->parts[0].surface;
  EXPECT_NEAR(s.reflectance[1], 0.4, 1e-6);
  EXPECT_NEAR(s.reflectance[4], 0.4, 1e-6) << "the mean of the visible bands";
  EXPECT_NEAR(s.roughness, std::sqrt(2 / 100.0), 1e-3);
}

TEST_F(Models, PicturesOfAnObjLieTheRightWayUp) {
  cv::Mat picture(2, 2, CV_8UC3, cv::Scalar(0, 0, 0));
  picture.at<cv::Vec3b>(0, 0) = {0, 0, 255};  // top left is red
  cv::imwrite((folder / "paint.png").string(), picture);
  const auto model = load_model(cube("newmtl paint\nKd 1 1 1\nmap_Kd paint.png\n"));
  ASSERT_TRUE(model);
  const Surface& s = *model->mesh->parts[0].surface;
  ASSERT_TRUE(s.colour_map);
  EXPECT_EQ(s.colour_map->rgba[0], 255);
  EXPECT_TRUE(s.colour_map->srgb);
  // The corner with `vt 0 1` (OBJ counts from the bottom) is at the picture's top left.
  bool seen = false;
  for (const auto& v : model->mesh->vertices)
    if (v.normal[2] > 0.9F && v.position[0] < 0.1F && v.position[1] > 0.9F) {
      EXPECT_NEAR(v.uv[0], 0, 1e-6);
      EXPECT_NEAR(v.uv[1], 0, 1e-6);
      seen = true;
    }
  EXPECT_TRUE(seen);
  EXPECT_GT(test::worst_normal(*model->mesh), 0.999) << "without normals of its own a cube keeps its edges";
}

TEST_F(Models, MissingPictureIsAWarning) {
  const auto model = load_model(cube("newmtl paint\nKd 1 1 1\nmap_Kd nowhere.png\n"));
  ASSERT_TRUE(model);
  ASSERT_EQ(model->warnings.size(), 1U);
  EXPECT_THAT(model->warnings[0], HasSubstr("nowhere.png"));
  EXPECT_FALSE(model->mesh->parts[0].surface->colour_map);
}

TEST_F(Models, GltfHierarchyIsBakedAndAMirrorKeepsTheOutside) {
  const auto model = load_model(write("t.gltf", triangle().dump()));
  ASSERT_TRUE(model) << model.error().text();
  const Mesh& m = *model->mesh;
  EXPECT_NEAR(m.bounds.min().x(), 4, 1e-6);
  EXPECT_NEAR(m.bounds.max().x(), 5, 1e-6);
  ASSERT_EQ(m.indices.size(), 3U);
  // The front looked to +z, and mirrored in x it still does; a mirror that forgets the winding shows its
  // back.
  EXPECT_GT(test::worst_normal(m), 0.99);
  EXPECT_NEAR(m.vertices[0].normal[2], 1, 1e-6);
}

TEST_F(Models, GltfMetallicRoughnessAndInfraredFromTheName) {
  const auto model = load_model(write("t.gltf", triangle().dump()));
  ASSERT_TRUE(model);
  const Surface& s = *model->mesh->parts[0].surface;
  EXPECT_NEAR(s.roughness, 0.6, 1e-6);
  EXPECT_NEAR(s.metallic, 0.25, 1e-6);
  EXPECT_NEAR(s.reflectance[0], 0.5, 1e-6);
  const auto wood = SurfaceLibrary::builtin().find("wood");
  ASSERT_TRUE(wood);
  EXPECT_NEAR(s.reflectance[5], wood->reflectance[5], 1e-6);
  EXPECT_NE(s.reflectance[5], s.reflectance[3]);
}

TEST_F(Models, GltfEmbeddedPicturesAreRead) {
  auto json = triangle();
  cv::Mat colour(4, 2, CV_8UC3, cv::Scalar(10, 20, 30)), rough(2, 2, CV_8UC3, cv::Scalar(128, 51, 0));
  json["images"] = {{{"uri", picture_uri(colour)}}, {{"uri", picture_uri(rough)}}};
  json["textures"] = {{{"source", 0}}, {{"source", 1}}};
  json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {{"index", 0}};
  json["materials"][0]["pbrMetallicRoughness"]["metallicRoughnessTexture"] = {{"index", 1}};
  json["materials"][0]["normalTexture"] = {{"index", 0}};
  json["materials"][0]["alphaMode"] = "MASK";
  json["materials"][0]["alphaCutoff"] = 0.3;
  json["materials"][0]["doubleSided"] = true;
  const auto model = load_model(write("t.gltf", json.dump()));
  ASSERT_TRUE(model) << model.error().text();
  EXPECT_TRUE(model->warnings.empty());
  const Surface& s = *model->mesh->parts[0].surface;
  ASSERT_TRUE(s.colour_map && s.normal_map && s.gloss_map);
  EXPECT_EQ(s.colour_map->width, 2U);
  EXPECT_EQ(s.colour_map->height, 4U);
  EXPECT_EQ(s.colour_map->rgba[0], 30);
  EXPECT_FALSE(s.normal_map->srgb);
  // Green 51 of 255 with the factor 0.6 is roughness 0.12; blue halves the metal.
  EXPECT_NEAR(1 - (1 - s.roughness) * static_cast<float>(s.gloss_map->rgba[0]) / 255, 0.12, 1e-3);
  EXPECT_NEAR(s.metallic, 0.25 * 128 / 255, 1e-3);
  EXPECT_NEAR(s.alpha_cutoff, 0.3, 1e-6);
  EXPECT_TRUE(s.two_sided);
}

TEST_F(Models, WhatIsNoModelIsRefused) {
  EXPECT_EQ(load_model(folder / "none.obj").error().code, ErrorCode::not_found);
  EXPECT_EQ(load_model(folder).error().code, ErrorCode::not_found) << "a folder";
  for (const auto& [name, text] : std::vector<std::pair<std::string, std::string>>{
           {"broken.gltf", "{ \"asset\": "},
           {"empty.obj", ""},
           {"empty.gltf", ""},
           {"points.obj", "v 0 0 0\nv 1 1 1\n"},
           {"unknown.xyzabc", "hello"},
           {"cut.glb", std::string("glTF\2\0\0\0\377\377\0\0", 12)},
           {"text.gltf", "no json at all"}}) {
    const auto model = load_model(write(name, text));
    ASSERT_FALSE(model) << name;
    EXPECT_EQ(model.error().code, ErrorCode::bad_input) << name;
    EXPECT_THAT(model.error().text(), HasSubstr(name));
  }
  auto json = triangle();
  json["buffers"][0]["uri"] = "gone.bin";
  EXPECT_FALSE(load_model(write("nobuffer.gltf", json.dump())));
  json = triangle();
  json["accessors"][0]["count"] = 1000000;
  EXPECT_FALSE(load_model(write("reach.gltf", json.dump()))) << "an accessor that reaches beyond its buffer";
}

class ModelNodes : public Models {
 protected:
  void SetUp() override {
    Models::SetUp();
    ASSERT_TRUE(world::define_semantic_types(*db));
  }
  void look() {
    std::vector<std::shared_ptr<ContentProvider>> providers;
    providers.push_back(make_model_provider(folder));
    view = std::make_unique<WorldView>(*db, std::move(providers));
  }
  std::unique_ptr<world::Database> db = world::Database::create();
  std::unique_ptr<WorldView> view;
};

TEST_F(ModelNodes, ScaleAxesAndPosePlaceAModel) {
  cube("newmtl paint\nKd 0.2 0.4 0.6\n");
  const world::types::Model t(db->schema());
  auto tx = db->begin();
  const NodeId up = *tx.create(t.type), flat = *tx.create(t.type), gone = *tx.create(t.type);
  for (const NodeId n : {up, flat}) ASSERT_TRUE(tx.set(n, t.file, std::string("cube.obj")));
  ASSERT_TRUE(tx.set(gone, t.file, std::string("gone.obj")));
  ASSERT_TRUE(tx.set(up, t.scale, 2.0));
  ASSERT_TRUE(tx.set(flat, t.y_up, false));
  world::Pose pose = world::Pose::Identity();
  pose.translation() = Eigen::Vector3d(100000.25, 10, 1);
  ASSERT_TRUE(tx.set(up, t.pose, pose));
  ASSERT_TRUE(tx.commit());
  look();
  const auto frame = view->collect({});
  ASSERT_EQ(frame.batches.size(), 2U);
  // y up: the cube's y (0 to 1) is height, its z (0 to 1, backwards) is −y.
  const auto& b = frame.batches[0]->bounds;
  EXPECT_LT((b.min() - Eigen::Vector3d(100000.25, 8, 1)).norm(), 1e-5);
  EXPECT_LT((b.max() - Eigen::Vector3d(100002.25, 10, 3)).norm(), 1e-5);
  EXPECT_LT((frame.batches[1]->bounds.max() - Eigen::Vector3d(1, 1, 1)).norm(), 1e-5);
  EXPECT_EQ(frame.batches[0]->prototype, frame.batches[1]->prototype) << "one file, read once";
  ASSERT_EQ(view->warnings().size(), 1U);
  EXPECT_THAT(view->warnings()[0], HasSubstr("gone.obj"));
}

TEST_F(ModelNodes, AFileThatWasWrittenAnewIsReadAnew) {
  const fs::path file = cube("newmtl paint\nKd 0.2 0.4 0.6\n");
  const world::types::Model t(db->schema());
  auto tx = db->begin();
  ASSERT_TRUE(tx.set(*tx.create(t.type), t.file, std::string("cube.obj")));
  ASSERT_TRUE(tx.commit());
  const auto provider = make_model_provider(folder);
  const auto seen = [&] {
    provider->rebuild(db->snapshot());
    ContentFrame frame;
    provider->collect({}, frame);
    return frame.batches.at(0)->prototype->levels[0].mesh;
  };
  const auto first = seen();
  EXPECT_EQ(seen(), first);
  fs::last_write_time(file, fs::last_write_time(file) + std::chrono::seconds(5));
  EXPECT_NE(seen(), first);
}

TEST_F(ModelNodes, MaterialNodeGivesTheInfrared) {
  cube("newmtl paint\nKd 0.2 0.4 0.6\n");
  const world::types::Model t(db->schema());
  const world::types::Material m(db->schema());
  auto tx = db->begin();
  const NodeId node = *tx.create(t.type), material = *tx.create(m.type);
  ASSERT_TRUE(tx.set(node, t.file, std::string("cube.obj")));
  ASSERT_TRUE(tx.set(material, m.reflectance, world::Numbers{0.1, 0.1, 0.1, 0.71, 0.72, 0.73}));
  ASSERT_TRUE(tx.connect(node, t.made_of, material));
  ASSERT_TRUE(tx.commit());
  look();
  const auto surface = [&] {
    return view->collect({}).batches.at(0)->prototype->levels[0].mesh->parts[0].surface;
  };
  EXPECT_NEAR(surface()->reflectance[2], 0.6, 1e-6);
  EXPECT_NEAR(surface()->reflectance[4], 0.72, 1e-6);
  auto change = db->begin();
  ASSERT_TRUE(change.set(material, m.reflectance, world::Numbers{0.1, 0.1, 0.1, 0.71, 0.11, 0.73}));
  ASSERT_TRUE(change.commit());
  EXPECT_NEAR(surface()->reflectance[4], 0.11, 1e-6);
}

}  // namespace
}  // namespace rigor::render
