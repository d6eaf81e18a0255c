// Pictures that `rigor world render` makes of worlds, small ones.
#include <gmock/gmock.h>

#include <cstdlib>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "tests/cli/world_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;

class WorldRender : public World {
 protected:
  WorldRender() { setenv("OPENCV_IO_ENABLE_OPENEXR", "1", 1); }
  /// 160x120 of `what`; empty where the command fails, which is a failure of the test.
  [[nodiscard]] cv::Mat picture(const std::string& what, const std::string& name,
                                std::vector<std::string> more = {}) const {
    std::vector<std::string> words{"render", what,       "-o",  name,     "--width",
                                   "160",    "--height", "120", "--force"};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = world(std::move(words));
    EXPECT_EQ(said.status, 0) << said.err;
    return cv::imread((dir / name).string(), cv::IMREAD_UNCHANGED);
  }
  static double mean_of(const cv::Mat& m) {
    const cv::Scalar s = cv::mean(m);
    return (s[0] + s[1] + s[2]) / 3;
  }
  /// Standard deviation over mean of the green channel.
  static double contrast_of(const cv::Mat& m) {
    cv::Scalar mean, deviation;
    cv::meanStdDev(m, mean, deviation);
    return deviation[1] / mean[1];
  }
  const std::vector<std::string> from_the_road{"--eye", "0,0,1.7", "--target", "0,100,1.7", "--above-ground"};
};

std::vector<std::string> operator+(std::vector<std::string> a, const std::vector<std::string>& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

TEST_F(WorldRender, PicturesHaveTheSizeThatWasAskedFor) {
  const cv::Mat png = picture("plan.import.yaml", "a.png", from_the_road);
  EXPECT_EQ(png.size(), cv::Size(160, 120));
  EXPECT_EQ(png.type(), CV_8UC3);
  const cv::Mat exr = picture("plan.import.yaml", "a.exr", from_the_road);
  EXPECT_EQ(exr.size(), cv::Size(160, 120));
  EXPECT_EQ(exr.type(), CV_32FC3);
  EXPECT_TRUE(cv::checkRange(exr, true, nullptr, 0, 1e4));
  EXPECT_GT(contrast_of(exr), 0.1);
}

TEST_F(WorldRender, TheFileShowsWhatThePlanShows) {
  ASSERT_EQ(import("w.rigor").status, 0);
  const std::string bytes = read_file(dir / "w.rigor");
  const cv::Mat plan = picture("plan.import.yaml", "a.png", from_the_road);
  const cv::Mat file = picture("w.rigor", "b.png", from_the_road);
  EXPECT_EQ(cv::norm(plan, file, cv::NORM_INF), 0);
  EXPECT_EQ(read_file(dir / "w.rigor"), bytes);
}

TEST_F(WorldRender, NoonIsBrighterThanDuskAtTheSameExposure) {
  const auto at = [&](const char* name, const char* time) {
    return mean_of(picture("plan.import.yaml", name,
                           from_the_road + std::vector<std::string>{"--white", "60", "--time", time}));
  };
  const double noon = at("noon.png", "2024-06-21T11:30:00Z"), dusk = at("dusk.png", "2024-06-21T19:30:00Z");
  EXPECT_GT(noon, 40);
  EXPECT_LT(dusk, noon / 2);
  EXPECT_NEAR(at("summer.png", "2024-06-21T13:30:00+02:00"), noon, 1e-9);
}

TEST_F(WorldRender, FogTakesTheContrastOfWhatIsFar) {
  const cv::Rect far(0, 30, 160, 30), near(0, 100, 160, 20);
  const cv::Mat clear = picture("plan.import.yaml", "clear.exr", from_the_road);
  const cv::Mat fog =
      picture("plan.import.yaml", "fog.exr",
              from_the_road + std::vector<std::string>{"--set", "Atmosphere.fog_visibility_m=50"});
  EXPECT_GT(contrast_of(clear(far)), 0.2);
  EXPECT_LT(contrast_of(fog(far)), contrast_of(clear(far)) / 4);
  EXPECT_GT(contrast_of(fog(near)), contrast_of(fog(far)));
}

TEST_F(WorldRender, LeavesAreBrighterInTheNearInfraredThanInRed) {
  const std::vector<std::string> from_above{"--eye", "0,0,120", "--target", "0,1,0", "--fov", "30"};
  const std::string forest = config("worlds/forest.import.yaml");
  const cv::Mat rgb = picture(forest, "rgb.exr", from_above);
  const cv::Mat nir = picture(forest, "nir.exr", from_above + std::vector<std::string>{"--bands", "nir"});
  ASSERT_EQ(nir.type(), CV_32FC3);
  EXPECT_EQ(cv::mean(nir)[0], cv::mean(nir)[2]);
  EXPECT_GT(cv::mean(nir)[2], 2 * cv::mean(rgb)[2]);
}

TEST_F(WorldRender, FalseColourShowsTheNearInfraredAsRed) {
  const std::string scene = config("worlds/turntable.yaml");
  const cv::Mat rgb = picture(scene, "rgb.exr"), nir = picture(scene, "nir.exr", {"--bands", "nir"}),
                film = picture(scene, "film.exr", {"--bands", "false-colour"});
  for (const cv::Point p : {cv::Point(10, 100), cv::Point(80, 60), cv::Point(80, 5)}) {
    const auto colours = rgb.at<cv::Vec3f>(p), shown = film.at<cv::Vec3f>(p);
    EXPECT_EQ(shown[2], nir.at<cv::Vec3f>(p)[2]);
    EXPECT_EQ(shown[1], colours[2]);
    EXPECT_EQ(shown[0], colours[1]);
  }
}

TEST_F(WorldRender, ASceneOfBoxesIsAWorldToo) {
  const cv::Mat png = picture(config("worlds/turntable.yaml"), "scene.png");
  EXPECT_EQ(png.size(), cv::Size(160, 120));
  EXPECT_GT(contrast_of(png), 0.1);
}

TEST_F(WorldRender, WithoutAnEyeAllTreesAreInThePicture) {
  // One tree on a plain: the overview stands back far enough for the whole of it, so that its edges are sky.
  write_file(dir / "one.csv", "species,dbh_cm,lat,lon\nPicea,60,46.95,9.0\n");
  ASSERT_EQ(world({"import", "--trees", "one.csv", "-o", "one.rigor"}).status, 0);
  const cv::Mat with = picture("one.rigor", "one.exr", {"--white", "50"});
  const cv::Mat without =
      picture("one.rigor", "none.exr", {"--set", "Tree.dbh_m=0.01", "--set", "Tree.height_m=0.1"});
  cv::Mat difference;
  cv::absdiff(with, without, difference);
  std::vector<cv::Mat> planes;
  cv::split(difference, planes);
  const cv::Mat changed = planes[1] > 0.02 * cv::mean(without)[1];
  EXPECT_GT(cv::countNonZero(changed(cv::Rect(60, 30, 40, 60))), 200);
  EXPECT_EQ(cv::countNonZero(changed.row(0)), 0);
}

TEST_F(WorldRender, BothEnginesMeasureTheSameLight) {
  // A road, trees beyond it, and the sky; and without shadows.
  for (const std::vector<std::string>& more : {std::vector<std::string>{}, {"--off", "shadows"}}) {
    const cv::Mat drawn = picture("plan.import.yaml", "vulkan.exr", from_the_road + more);
    const cv::Mat traced = picture("plan.import.yaml", "rays.exr",
                                   from_the_road + more + std::vector<std::string>{"--renderer", "rays"});
    ASSERT_EQ(traced.size(), drawn.size());
    EXPECT_NEAR(mean_of(traced), mean_of(drawn), 0.1 * mean_of(drawn));
    EXPECT_GT(cv::norm(traced, drawn, cv::NORM_INF), 0) << "two engines";
    cv::Mat a, b;
    cv::resize(drawn, a, {8, 6}, 0, 0, cv::INTER_AREA);
    cv::resize(traced, b, {8, 6}, 0, 0, cv::INTER_AREA);
    EXPECT_LT(cv::norm(a, b) / cv::norm(a), 0.15) << "in the same places";
  }
  EXPECT_EQ(
      world({"render", "plan.import.yaml", "-o", "x.png", "--renderer", "rays", "--off", "impostors"}).status,
      2);
}

TEST_F(WorldRender, JsonTellsWhatWasDrawn) {
  const Said said = world({"render", "plan.import.yaml", "-o", "a.png", "--width", "160", "--height", "120",
                           "--eye", "10,-20,3", "--target", "0,100,1", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json drawn = json::parse(said.out);
  EXPECT_EQ(drawn["width_px"], 160);
  EXPECT_EQ(drawn["height_px"], 120);
  EXPECT_EQ(drawn["eye_m"], json({10.0, -20.0, 3.0}));
  EXPECT_GT(drawn["triangles_drawn"], 100);
  EXPECT_TRUE(drawn["warnings"].is_array());
}

}  // namespace
}  // namespace rigor::test
