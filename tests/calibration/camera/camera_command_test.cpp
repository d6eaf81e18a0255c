// `rigor calibrate camera` and `stereo` as a user runs them: pictures of boards of every kind, colours,
// moving boards, pairs; and the sensor models, read back by the simulator's loader.
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "sensor-hal/models/camera_yaml.h"
#include "tests/calibration/camera/board_scene.h"
#include "tests/calibration/camera/moving_board.h"
#include "tests/cli/command.h"

namespace rigor::calibration {
namespace {

using namespace test;
using nlohmann::json;
using rigor::test::rigor;
using rigor::test::Said;
using rigor::test::TempDir;

/// A pinhole camera before a printed sheet: the sheet warped by the plane's homography.
struct Pinhole {
  int width = 480, height = 360;
  double f = 430, cx = 243.5, cy = 176;
  [[nodiscard]] cv::Mat picture(const cv::Mat& sheet, double px_per_m, double left_m, double top_m,
                                const Eigen::Isometry3d& T, double magnification = 1) const {
    const Eigen::Matrix3d r = T.linear();
    const Eigen::Vector3d t = T.translation();
    Eigen::Matrix3d k;
    k << f * magnification, 0, cx, 0, f * magnification, cy, 0, 0, 1;
    Eigen::Matrix3d plane, of_pixel;
    plane << r.col(0), r.col(1), t;
    of_pixel << 1 / px_per_m, 0, left_m, 0, 1 / px_per_m, top_m, 0, 0, 1;
    const Eigen::Matrix3d h = k * plane * of_pixel;
    cv::Mat homography(3, 3, CV_64F);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) homography.at<double>(i, j) = h(i, j);
    // Four pixels for one, so that edges are where they are: pixel centres at integers on both scales.
    const cv::Mat fine = (cv::Mat_<double>(3, 3) << 4, 0, 1.5, 0, 4, 1.5, 0, 0, 1);
    cv::Mat large, out;
    cv::warpPerspective(sheet, large, fine * homography, {4 * width, 4 * height}, cv::INTER_LINEAR,
                        cv::BORDER_CONSTANT, cv::Scalar(230));
    cv::resize(large, out, {width, height}, 0, 0, cv::INTER_AREA);
    cv::GaussianBlur(out, out, {}, 0.6);
    return out;
  }
};

std::vector<Eigen::Isometry3d> poses(double width_m, double height_m, int count) {
  std::vector<Eigen::Isometry3d> all;
  for (int i = 0; i < count; ++i) {
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    const double about = 2 * std::numbers::pi * i / count, tilt = 0.35 + 0.1 * (i % 3);
    t.linear() = (Eigen::AngleAxisd(tilt, Eigen::Vector3d(std::cos(about), std::sin(about), 0)) *
                  Eigen::AngleAxisd(0.1 * (i % 3 - 1), Eigen::Vector3d::UnitZ()))
                     .toRotationMatrix();
    const Eigen::Vector3d middle(0.05 * width_m * std::cos(2 * about), 0.05 * height_m * std::sin(3 * about),
                                 width_m * (1.35 + 0.12 * (i % 4)));
    t.translation() = middle - t.linear() * Eigen::Vector3d(width_m / 2, height_m / 2, 0);
    all.push_back(t);
  }
  return all;
}

constexpr double kPxPerM = 2500;
/// A printed board with a white rim of 40 mm, its origin at the first point.
cv::Mat printed(const Board& board, double& left_m, double& top_m) {
  left_m = top_m = -0.04 - board.spacing_m;
  const double w = (board.columns + 1) * board.spacing_m + 0.08,
               h = (board.rows + 1) * board.spacing_m + 0.08;
  cv::Mat sheet(static_cast<int>(h * kPxPerM), static_cast<int>(w * kPxPerM), CV_8U);
  for (int v = 0; v < sheet.rows; ++v)
    for (int u = 0; u < sheet.cols; ++u)
      sheet.at<std::uint8_t>(v, u) = static_cast<std::uint8_t>(
          30 + 200 * board_brightness(board, left_m + u / kPxPerM, top_m + v / kPxPerM));
  return sheet;
}

json answer_of(const Said& said) {
  EXPECT_EQ(said.status, 0) << said.err << said.out;
  return json::parse(said.out, nullptr, false);
}
void expect_pinhole(const json& answer, const Pinhole& truth) {
  ASSERT_TRUE(answer.contains("parameters")) << answer.dump(1);
  const json& fx = answer["parameters"]["fx_px"];
  const double sigma = fx["sigma"];
  EXPECT_LT(sigma, 0.01 * truth.f);
  EXPECT_LT(std::abs(fx["value"].get<double>() - truth.f), 5 * sigma + 0.002 * truth.f) << fx.dump();
  EXPECT_LT(answer["rms_per_corner_px"].get<double>(), 0.15);
}

TEST(CalibrateCameraCommand, FindsCirclesAndCharucoBoards) {
  const Pinhole camera;
  for (const std::string target : {"circles:7x5:0.03", "charuco:7x5:0.04:0.03"}) {
    const TempDir folder;
    const auto board = parse_board(target);
    ASSERT_TRUE(board);
    double left = 0, top = 0;
    cv::Mat sheet;
    if (board->kind == BoardKind::charuco) {
      const auto charuco = cv::aruco::CharucoBoard::create(
          7, 5, 0.04F, 0.03F, cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50));
      const int rim = static_cast<int>(0.02 * kPxPerM), square = static_cast<int>(0.04 * kPxPerM);
      charuco->draw({7 * square + 2 * rim, 5 * square + 2 * rim}, sheet, rim, 1);
      left = top = -0.02;
    } else {
      sheet = printed(*board, left, top);
    }
    int i = 0;
    for (const auto& T : poses(board->columns * board->spacing_m, board->rows * board->spacing_m, 9))
      cv::imwrite((folder / ("view" + std::to_string(i++) + ".png")).string(),
                  camera.picture(sheet, kPxPerM, left, top, T));
    const Said said = rigor(
        {"calibrate", "camera", folder.path().string(), "--target", target, "--model", "opencv0", "--json"});
    expect_pinhole(answer_of(said), camera);
  }
}

TEST(CalibrateCameraCommand, MagnificationOfColoursGoesIntoASensorModelThatTheSimulatorReads) {
  const Pinhole camera;
  const TempDir folder, grey;
  const Board board{BoardKind::chessboard, 8, 5, 0.03};
  double left = 0, top = 0;
  const cv::Mat sheet = printed(board, left, top);
  int i = 0;
  for (const auto& T : poses(0.24, 0.15, 8)) {
    cv::Mat planes[3], colour;
    const double by[3] = {0.997, 1, 1.004};  // blue, green, red as OpenCV has them
    for (int c = 0; c < 3; ++c) planes[c] = camera.picture(sheet, kPxPerM, left, top, T, by[c]);
    cv::merge(planes, 3, colour);
    const std::string name = "view" + std::to_string(i++) + ".png";
    cv::imwrite((folder / name).string(), colour);
    cv::imwrite((grey / name).string(), planes[1]);
  }
  const auto output = grey / "out.yaml";
  const json answer =
      answer_of(rigor({"calibrate", "camera", folder.path().string(), "--target", "chessboard:8x5:0.03",
                       "--model", "opencv0", "--chromatic", "--twin", "-o", output.string(), "--json"}));
  expect_pinhole(answer, camera);
  const auto model = load_camera(output);
  ASSERT_TRUE(model) << model.error().text();
  EXPECT_NEAR(model->model.chromatic.magnification[0], 1.004, 3e-4);
  EXPECT_EQ(model->model.chromatic.magnification[1], 1);
  EXPECT_NEAR(model->model.chromatic.magnification[2], 0.997, 3e-4);
  const auto other = load_camera(output, 5);
  ASSERT_TRUE(other) << other.error().text();
  EXPECT_NE(other->model.chromatic.magnification[0], model->model.chromatic.magnification[0]);
  EXPECT_EQ(answer["twin"]["views"], 8);
  // The data are drawn themselves: a little sharper or softer than the twin's, and nothing else is in them.
  const double ratio =
      answer["twin"]["rms_per_corner_px"].get<double>() / answer["rms_per_corner_px"].get<double>();
  EXPECT_GT(ratio, 0.5);
  EXPECT_LT(ratio, 2);
  EXPECT_NEAR(answer["twin"]["white_dn"].get<double>(), 230, 3);

  const Said refused = rigor({"calibrate", "camera", grey.path().string(), "--target", "chessboard:8x5:0.03",
                              "--chromatic", "--json"});
  EXPECT_EQ(refused.status, 2);
  EXPECT_NE((refused.err + refused.out).find("expected a colour picture"), std::string::npos)
      << refused.err << refused.out;
}

void write_corners(const std::filesystem::path& file, const std::vector<BoardView>& views,
                   const Board& board) {
  std::ofstream out(file);
  out.precision(10);
  for (const BoardView& v : views) {
    ASSERT_EQ(v.points.size(), board.points());
    for (const BoardPoint& p : v.points) out << v.name << ' ' << p.u_px << ' ' << p.v_px << " 0\n";
  }
}

TEST(CalibrateCameraCommand, LineTimeGoesIntoTheShutterOfTheSensorModel) {
  const TempDir folder;
  CameraModel truth = true_camera(LensModel::opencv2);
  truth.shutter.line_time_s = 30e-6;
  auto views = moving_board_views(truth, 3, 0.6, 0.05, 40);
  for (BoardView& v : views)
    for (char& c : v.name)
      if (c == ' ') c = '_';
  write_corners(folder / "corners.vnl", views, kMovingBoard);
  const auto output = folder / "out.yaml";
  const std::vector<std::string> words{"calibrate",
                                       "camera",
                                       (folder / "corners.vnl").string(),
                                       "--size",
                                       "640x480",
                                       "--target",
                                       "chessboard:6x5:0.035",
                                       "--model",
                                       "opencv2",
                                       "--rolling-shutter"};
  auto timed = words;
  for (const char* w : {"--rate", "30", "--json", "-o"}) timed.emplace_back(w);
  timed.push_back(output.string());
  const json answer = answer_of(rigor(timed));
  const json& line = answer["parameters"]["line_time_s"];
  EXPECT_LT(std::abs(line["value"].get<double>() - 30e-6), 4 * line["sigma"].get<double>()) << line.dump();
  const auto model = load_camera(output);
  ASSERT_TRUE(model) << model.error().text();
  EXPECT_NEAR(model->model.shutter.line_time_s, line["value"].get<double>(), 1e-12);
  EXPECT_NE(load_camera(output, 2)->model.shutter.line_time_s, model->model.shutter.line_time_s);

  auto untimed = words;
  untimed.emplace_back("--json");
  const json without = answer_of(rigor(untimed));
  EXPECT_FALSE(without["parameters"].contains("line_time_s"));
  EXPECT_TRUE(without["not_identifiable"].contains("line_time_s"));
}

TEST(CalibrateStereoCommand, WritesASensorModelForEachCameraThatTheSimulatorReads) {
  const TempDir folder;
  CameraModel cameras[2] = {true_camera(LensModel::opencv4), true_camera(LensModel::opencv4)};
  cameras[1].fx_px = 541, cameras[1].fy_px = 540, cameras[1].lens.k1 = -0.3;
  Eigen::Isometry3d T_left_right = Eigen::Isometry3d::Identity();
  T_left_right.linear() = Eigen::AngleAxisd(0.05, Eigen::Vector3d(0, 1, 0)).toRotationMatrix();
  T_left_right.translation() = Eigen::Vector3d(0.08, 0.002, -0.003);
  Scene scene;
  scene.board.columns = 7, scene.board.rows = 5;
  scene.nearest_m = 0.5, scene.farthest_m = 0.9;
  std::mt19937 random(4);
  std::vector<BoardView> views[2];
  while (views[0].size() < 12) {
    const Eigen::Isometry3d T = random_pose(cameras[0], scene, random);
    const std::string name = "pair" + std::to_string(views[0].size());
    BoardView l = view_of(cameras[0], scene.board, T, name),
              r = view_of(cameras[1], scene.board, T_left_right.inverse() * T, name);
    if (l.points.size() < 35 || r.points.size() < 35) continue;
    add_noise(l, 0.1, random), add_noise(r, 0.1, random);
    views[0].push_back(l), views[1].push_back(r);
  }
  write_corners(folder / "left.vnl", views[0], scene.board);
  write_corners(folder / "right.vnl", views[1], scene.board);
  const std::vector<std::string> words{"calibrate",
                                       "stereo",
                                       (folder / "left.vnl").string(),
                                       "--right",
                                       (folder / "right.vnl").string(),
                                       "--size",
                                       "640x480",
                                       "--target",
                                       "chessboard:7x5:0.03",
                                       "--model",
                                       "opencv4",
                                       "--json",
                                       "-o",
                                       (folder / "rig.yaml").string()};
  const json answer = answer_of(rigor(words));
  EXPECT_NEAR(answer["baseline_m"].get<double>(), T_left_right.translation().norm(), 1e-3);
  for (int side = 0; side < 2; ++side) {
    const auto file = folder / (side == 0 ? "rig.left.yaml" : "rig.right.yaml");
    const auto sensor_model = load_camera(file);
    ASSERT_TRUE(sensor_model) << sensor_model.error().text();
    const auto drawn = load_camera(file, 7);
    ASSERT_TRUE(drawn) << drawn.error().text();
    EXPECT_NE(drawn->model.fx_px, sensor_model->model.fx_px);
    // Used: a ray through the sensor model falls where the camera saw it.
    for (const auto& [x, y] : {std::pair{0.0, 0.0}, {0.2, 0.1}, {-0.3, -0.2}}) {
      const auto seen = project_ray(cameras[side], {x, y, 1}),
                 again = project_ray(sensor_model->model, {x, y, 1});
      ASSERT_TRUE(seen && again);
      EXPECT_NEAR(again->u_px, seen->u_px, 3.0);
      EXPECT_NEAR(again->v_px, seen->v_px, 3.0);
    }
    const std::string prefix = side == 0 ? "left." : "right.";
    EXPECT_EQ(answer["parameters"][prefix + "fx_px"]["value"].get<double>(), sensor_model->model.fx_px);
  }
  EXPECT_EQ(rigor(words).status, 2) << "what is there is not written over";
}

TEST(CalibrateCameraCommand, TwoFitsAtOnceAreRefused) {
  const Said said = rigor(
      {"calibrate", "camera", ".", "--target", "chessboard:8x5:0.03", "--chromatic", "--rolling-shutter"});
  EXPECT_EQ(said.status, 2);
  EXPECT_NE(said.err.find("one of --rolling-shutter and --chromatic"), std::string::npos) << said.err;
}

}  // namespace
}  // namespace rigor::calibration
