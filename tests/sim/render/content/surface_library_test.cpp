// The materials that come with Rigor, and those that somebody writes.
#include "sim/render/content/surface_library.h"
#include "tests/paths.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace rigor::render {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

constexpr int kRed = 0, kGreen = 1, kBlue = 2, k850 = 3, k905 = 4, k1550 = 5;

struct Folder {
  fs::path path = fs::temp_directory_path() /
                  ("rigor_materials_" + std::to_string(::getpid()) + "_" + std::to_string(next_serial()));
  Folder() { fs::create_directories(path); }
  ~Folder() { fs::remove_all(path); }
  void write(const std::string& name, const std::string& text) const { std::ofstream(path / name) << text; }
};

std::string material(const std::string& name, const std::string& rest = "") {
  return name +
         ":\n  source: a test\n"
         "  reflectance: {620_nm: 0.1, 550_nm: 0.2, 460_nm: 0.3, 850_nm: 0.4, 905_nm: 0.5, 1550_nm: 0.6}\n"
         "  roughness: 0.5\n  porosity: 0.25\n" +
         rest;
}
std::string error_of(const std::string& text) {
  const Folder f;
  f.write("m.yaml", text);
  const auto l = SurfaceLibrary::load(f.path);
  return l ? "" : l.error().text();
}

TEST(SurfaceLibrary, ComesWithEveryMaterialThatItsHeaderNames) {
  const std::vector<std::string> all = {"asphalt",      "bare_metal",    "bark",        "brick",
                                        "broad_leaves", "concrete",      "fern",        "glass",
                                        "grass",        "gravel",        "leaf_litter", "lichen_bark",
                                        "needles",      "painted_metal", "plaster",     "retro_reflector",
                                        "road_marking", "rock",          "roof_tiles",  "sand",
                                        "snow",         "soil",          "water",       "wood"};
  EXPECT_EQ(SurfaceLibrary::builtin().names(), all);
}

TEST(SurfaceLibrary, BuiltinIsWhatTheFilesSay) {
  const auto files = SurfaceLibrary::load(rigor::test::source_dir() + "/configs/materials");
  ASSERT_TRUE(files) << files.error().text();
  const auto& builtin = SurfaceLibrary::builtin();
  ASSERT_EQ(files->names(), builtin.names());
  for (const auto& name : builtin.names()) {
    const auto a = files->find(name), b = builtin.find(name);
    EXPECT_EQ(a->reflectance, b->reflectance) << name;
    EXPECT_EQ(a->transmittance, b->transmittance) << name;
    EXPECT_EQ(a->roughness, b->roughness) << name;
  }
}

TEST(SurfaceLibrary, NoMaterialGivesMoreLightThanItGets) {
  for (const auto& name : SurfaceLibrary::builtin().names()) {
    const auto s = SurfaceLibrary::builtin().find(name);
    EXPECT_EQ(s->name, name);
    for (int b = 0; b < kBandCount; ++b) {
      EXPECT_GE(s->reflectance[b], 0) << name << " band " << b;
      EXPECT_LE(s->reflectance[b] + s->transmittance[b] + s->retro_reflection, 1) << name << " band " << b;
    }
  }
}

TEST(SurfaceLibrary, LivingLeavesAreBrightInTheNearInfrared) {
  for (const auto* name : {"needles", "broad_leaves", "grass", "fern"}) {
    const auto s = SurfaceLibrary::builtin().find(name);
    const float nir = s->reflectance[k850], red = s->reflectance[kRed];
    EXPECT_GT(nir / red, 4) << name;
    EXPECT_GT((nir - red) / (nir + red), 0.6F) << name;
    EXPECT_GT(s->reflectance[kGreen], s->reflectance[kRed]) << name;
    EXPECT_GT(s->reflectance[kRed], s->reflectance[kBlue]) << name;
    EXPECT_LT(s->reflectance[k1550], 0.7F * s->reflectance[k905]) << name << ": leaf water absorbs";
    // A leaf keeps about a tenth of the near infrared and most of the blue.
    EXPECT_NEAR(s->reflectance[k850] + s->transmittance[k850], 0.88F, 0.08F) << name;
    EXPECT_LT(s->reflectance[kBlue] + s->transmittance[kBlue], 0.1F) << name;
    EXPECT_TRUE(s->two_sided) << name;
  }
}

TEST(SurfaceLibrary, DeadPlantsHaveNoGreenPeakAndNoRedEdge) {
  for (const auto* name : {"leaf_litter", "bark", "soil", "wood"}) {
    const auto s = SurfaceLibrary::builtin().find(name);
    EXPECT_GT(s->reflectance[kRed], s->reflectance[kGreen]) << name;
    EXPECT_GT(s->reflectance[kGreen], s->reflectance[kBlue]) << name;
    EXPECT_LT(s->reflectance[k850] / s->reflectance[kRed], 4) << name;
  }
}

TEST(SurfaceLibrary, SnowIsWhiteInTheVisibleAndBlackAt1550) {
  const auto s = SurfaceLibrary::builtin().find("snow");
  for (const int b : {kRed, kGreen, kBlue}) EXPECT_GT(s->reflectance[b], 0.9F);
  EXPECT_GT(s->reflectance[k850], s->reflectance[k905]);
  EXPECT_GT(s->reflectance[k905], 0.7F);
  EXPECT_LT(s->reflectance[k1550], 0.15F);
}

TEST(SurfaceLibrary, WaterSendsNothingBackInTheInfrared) {
  const auto s = SurfaceLibrary::builtin().find("water");
  EXPECT_TRUE(s->water);
  EXPECT_FALSE(s->takes_snow);
  for (const int b : {k850, k905, k1550}) EXPECT_LT(s->reflectance[b], 0.005F);
  EXPECT_GT(s->reflectance[kGreen], s->reflectance[kRed]);
}

TEST(SurfaceLibrary, UnknownNamesAreMattGrey) {
  const SurfaceLibrary& l = SurfaceLibrary::builtin();
  EXPECT_EQ(l.find("unobtainium"), nullptr);
  EXPECT_EQ(l.find("unknown"), nullptr);
  const auto s = l.get("unobtainium");
  ASSERT_NE(s, nullptr);
  EXPECT_EQ(s->name, "unknown");
  EXPECT_EQ(s, l.get(""));  // one object: engines keep what they made of it
  EXPECT_EQ(l.get("bark"), l.find("bark"));
}

TEST(SurfaceLibrary, PutReplaces) {
  SurfaceLibrary l = SurfaceLibrary::builtin();
  auto s = std::make_shared<Surface>();
  s->name = "bark";
  l.put(s);
  l.put(nullptr);
  EXPECT_EQ(l.get("bark"), s);
  EXPECT_NE(SurfaceLibrary::builtin().get("bark"), s);
}

TEST(SurfaceLibrary, ReadsAFolder) {
  const Folder f;
  f.write("b.yaml", material("second", "  takes_snow: false\n  water: true\n  metallic: 0.5\n"));
  f.write("a.yaml", material("first",
                             "  transmittance: {620_nm: 0.4, 550_nm: 0.4, 460_nm: 0.4, 850_nm: 0.4, "
                             "905_nm: 0.4, 1550_nm: 0.4}\n"));
  f.write("notes.txt", "not a material");
  const auto l = SurfaceLibrary::load(f.path);
  ASSERT_TRUE(l) << l.error().text();
  EXPECT_EQ(l->names(), (std::vector<std::string>{"first", "second"}));
  const auto first = l->find("first"), second = l->find("second");
  EXPECT_EQ(first->reflectance, (Spectrum{0.1F, 0.2F, 0.3F, 0.4F, 0.5F, 0.6F}));
  EXPECT_EQ(first->transmittance[5], 0.4F);
  EXPECT_TRUE(first->two_sided && first->takes_snow);
  EXPECT_EQ(first->porosity, 0.25F);
  EXPECT_FALSE(second->two_sided || second->takes_snow);
  EXPECT_TRUE(second->water);
  EXPECT_EQ(second->metallic, 0.5F);
}

TEST(SurfaceLibrary, AnEmptyFolderHasNoMaterialsAndAMissingOneIsAnError) {
  const Folder f;
  const auto l = SurfaceLibrary::load(f.path);
  ASSERT_TRUE(l);
  EXPECT_TRUE(l->names().empty());
  const auto none = SurfaceLibrary::load(f.path / "none");
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::not_found);
}

TEST(SurfaceLibrary, ErrorsNameFileLineAndKey) {
  EXPECT_THAT(error_of(material("m", "  colour: red\n")), HasSubstr("m.yaml:6:3: m.colour: unknown key"));
  EXPECT_THAT(error_of(material("m", "  metallic: 2\n")), HasSubstr("m.yaml:6:13: m.metallic"));
  EXPECT_THAT(error_of(material("Bark")), HasSubstr("lower case"));
  EXPECT_THAT(error_of(material("unknown")), HasSubstr("unknown"));
  EXPECT_THAT(error_of("m: {}\n"), HasSubstr("m.source"));
  EXPECT_THAT(error_of("m: 3\n"), HasSubstr("m.yaml:1"));
  EXPECT_THAT(error_of(material("m") + material("m")), HasSubstr("m.yaml:6"));
  std::string text = material("m");
  text.replace(text.find("550_nm: 0.2"), 11, "550_nm: -.2");
  EXPECT_THAT(error_of(text), HasSubstr("m.reflectance.550_nm"));
  text = material("m");
  text.replace(text.find("460_nm: 0.3, "), 13, "");
  EXPECT_THAT(error_of(text), HasSubstr("m.reflectance.460_nm"));
  text = material("m");
  text.replace(text.find("460_nm: 0.3"), 11, "460_nm: .nan");
  EXPECT_THAT(error_of(text), HasSubstr("m.reflectance.460_nm"));
}

TEST(SurfaceLibrary, RefusesMoreLightThanComes) {
  EXPECT_THAT(error_of(material("m",
                                "  transmittance: {620_nm: 0.9, 550_nm: 0.8, 460_nm: 0.7, 850_nm: 0.6, "
                                "905_nm: 0.6, 1550_nm: 0.1}\n")),
              HasSubstr("905_nm"));
  EXPECT_THAT(error_of(material("m", "  retro_reflection: 0.5\n")), HasSubstr("1550_nm"));
}

TEST(SurfaceLibrary, RefusesAMaterialInTwoFiles) {
  const Folder f;
  f.write("a.yaml", material("m"));
  f.write("b.yaml", material("m"));
  const auto l = SurfaceLibrary::load(f.path);
  ASSERT_FALSE(l);
  EXPECT_THAT(l.error().text(), HasSubstr("b.yaml:2:3: m: this material"));
}

// ---------------------------------------------------------------- textures
fs::path picture(const Folder& f, const std::string& name, const cv::Mat& m) {
  const auto path = f.path / name;
  EXPECT_TRUE(cv::imwrite(path.string(), m));
  return path;
}
std::vector<int> texel(const Texture& t, std::uint32_t x, std::uint32_t y) {
  const auto* p = &t.rgba[4 * (y * t.width + x)];
  return {p[0], p[1], p[2], p[3]};
}

TEST(LoadTexture, RowsComeFromTheTopAndRedComesFirst) {
  const Folder f;
  cv::Mat m(2, 3, CV_8UC3, cv::Scalar(0, 0, 0));
  m.at<cv::Vec3b>(0, 2) = {10, 20, 30};  // blue, green, red
  const auto t = load_texture(picture(f, "c.png", m), true);
  ASSERT_TRUE(t) << t.error().text();
  EXPECT_EQ((*t)->width, 3U);
  EXPECT_EQ((*t)->height, 2U);
  EXPECT_TRUE((*t)->srgb);
  EXPECT_EQ((*t)->rgba.size(), 24U);
  EXPECT_EQ(texel(**t, 2, 0), (std::vector<int>{30, 20, 10, 255}));
  EXPECT_EQ(texel(**t, 2, 1), (std::vector<int>{0, 0, 0, 255}));
}

TEST(LoadTexture, GreyAlphaAndSixteenBits) {
  const Folder f;
  const auto grey = load_texture(picture(f, "g.png", cv::Mat(1, 1, CV_8UC1, cv::Scalar(77))), false);
  ASSERT_TRUE(grey);
  EXPECT_FALSE((*grey)->srgb);
  EXPECT_EQ(texel(**grey, 0, 0), (std::vector<int>{77, 77, 77, 255}));
  const auto rgba = load_texture(picture(f, "a.png", cv::Mat(1, 1, CV_8UC4, cv::Scalar(1, 2, 3, 4))), true);
  ASSERT_TRUE(rgba);
  EXPECT_EQ(texel(**rgba, 0, 0), (std::vector<int>{3, 2, 1, 4}));
  const auto deep =
      load_texture(picture(f, "d.png", cv::Mat(1, 1, CV_16UC3, cv::Scalar(65535, 257 * 128, 100))), true);
  ASSERT_TRUE(deep);
  EXPECT_EQ(texel(**deep, 0, 0), (std::vector<int>{0, 128, 255, 255}));
}

TEST(LoadTexture, SaysWhatIsWrong) {
  const Folder f;
  EXPECT_EQ(load_texture(f.path / "none.png", true).error().code, ErrorCode::not_found);
  EXPECT_EQ(load_texture(f.path, true).error().code, ErrorCode::not_found);
  f.write("empty.png", "");
  EXPECT_EQ(load_texture(f.path / "empty.png", true).error().code, ErrorCode::bad_input);
  f.write("text.png", "not a picture at all");
  EXPECT_EQ(load_texture(f.path / "text.png", true).error().code, ErrorCode::bad_input);
  const auto wide = load_texture(picture(f, "w.png", cv::Mat(1, 16385, CV_8UC1, cv::Scalar(0))), true);
  ASSERT_FALSE(wide);
  EXPECT_THAT(wide.error().message, HasSubstr("16385x1"));
  const auto real = load_texture(picture(f, "r.tiff", cv::Mat(2, 2, CV_32FC1, cv::Scalar(0.5))), true);
  ASSERT_FALSE(real);
  EXPECT_THAT(real.error().message, HasSubstr("8 or 16 bit"));
}

}  // namespace
}  // namespace rigor::render
