// What a user gets from `rigor calibrate …` for input that is wrong: where, what was expected, what came and
// what to do; exit status 2, and no file that was not there.
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "tests/cli/calibrate_fixture.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;

class CalibrateBadInput : public Calibrate {
 protected:
  /// A chessboard of 9x6 inner corners that fills most of the picture, a little turned.
  void draw_board(const std::string& name, int width, int height, double turn_deg = 5) const {
    cv::Mat board(9 * 40, 12 * 40, CV_8UC1, cv::Scalar(230));
    for (int r = 0; r < 7; ++r)
      for (int c = 0; c < 10; ++c)
        if ((r + c) % 2 == 0) board(cv::Rect(40 + 40 * c, 40 + 40 * r, 40, 40)) = 20;
    const double scale = 0.8 * std::min(width / 480.0, height / 360.0);
    cv::Mat turn = cv::getRotationMatrix2D({240, 180}, turn_deg, scale);
    turn.at<double>(0, 2) += width / 2.0 - 240;
    turn.at<double>(1, 2) += height / 2.0 - 180;
    cv::Mat picture;
    cv::warpAffine(board, picture, turn, {width, height}, cv::INTER_AREA, cv::BORDER_CONSTANT,
                   cv::Scalar(230));
    cv::imwrite((dir / name).string(), picture);
  }
  static std::string head_of(const std::string& file, std::size_t bytes) {
    return read_file(file).substr(0, bytes);
  }
};

TEST_F(CalibrateBadInput, NoBoardIsFoundAndTheOneThatWasLookedForIsDrawn) {
  cv::imwrite((dir / "wall.png").string(), cv::Mat(240, 320, CV_8UC1, cv::Scalar(90)));
  expect_refused({"camera", "wall.png", "--target", kBoard},
                 {"wall.png", "chessboard:9x6:0.1", "--target", "--report"});
  const Said said = run({"camera", "wall.png", "--target", kBoard, "--report", "report", "-o", "x.yaml"});
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, HasSubstr("report/looked_for.png"));
  const cv::Mat drawn = cv::imread((dir / "report/looked_for.png").string(), cv::IMREAD_GRAYSCALE);
  ASSERT_FALSE(drawn.empty());
  double dark = 0, light = 0;
  cv::minMaxLoc(drawn, &dark, &light);
  EXPECT_GT(light - dark, 200);
  EXPECT_GT(drawn.cols, 12 * 40);  // the picture stands beside the board
  EXPECT_FALSE(std::filesystem::exists(dir / "x.yaml"));
}

TEST_F(CalibrateBadInput, BoardsOfAnotherSizeAndNoBoardsAtAll) {
  draw_board("board.png", 480, 360);
  expect_refused({"camera", "board.png", "--target", "chessboard:7x5:0.1"}, {"board.png", "7x5", "--target"});
  expect_refused({"camera", "board.png", "--target", "chessboard:9x0:0.1"}, {"chessboard:9x0:0.1"});
  expect_refused({"camera", "board.png", "--target", "chessboard:9x6:nan"}, {"chessboard:9x6:nan"});
  expect_refused({"camera", "board.png", "--target", "checkers:9x6:0.1"}, {"checkers:9x6:0.1", "chessboard"});
  expect_refused({"camera", "board.png"}, {"--target"});
  expect_refused({"camera", "board.png", "--target", kBoard, "--model", "pinhole"}, {"pinhole", "opencv4"});
}

TEST_F(CalibrateBadInput, PicturesOfSeveralSizes) {
  draw_board("a.png", 480, 360);
  draw_board("b.png", 640, 480, -10);
  expect_refused({"camera", "a.png", "b.png", "--target", kBoard, "-o", "x.yaml"},
                 {"b.png", "640x480", "480x360"});
}

TEST_F(CalibrateBadInput, ColourWhereGreyIsExpected) {
  cv::Mat colour(48, 64, CV_8UC3, cv::Scalar(30, 90, 200));
  cv::randn(colour, cv::Scalar(30, 90, 200), cv::Scalar(5, 5, 5));
  cv::imwrite((dir / "flat_10ms_1.png").string(), colour);
  cv::imwrite((dir / "flat_20ms_1.png").string(), colour);
  expect_refused({"photon", "flat_10ms_1.png", "flat_20ms_1.png"}, {"flat_10ms_1.png", "grey", "colour"});
  expect_refused({"shading", "flat_10ms_1.png", "--base", sensor("demo-camera")},
                 {"flat_10ms_1.png", "grey", "colour"});
}

TEST_F(CalibrateBadInput, RecordingsThatAreNoneOrEmptyOrCutShort) {
  const std::string whole = CalibrationRecordings::get().board();
  write_file(dir / "empty.mcap", "");
  write_file(dir / "words.mcap", "this is no recording");
  write_file(dir / "start.mcap", head_of(whole, 400));
  for (const char* file : {"nowhere.mcap", "empty.mcap", "words.mcap", "start.mcap"}) {
    expect_refused({"camera", file, "--channel", "left/real", "--target", kBoard}, {file});
    expect_refused({"lidar", file, "--base", sensor("velodyne-vlp16")}, {file});
    expect_refused({"tof", file}, {file});
    expect_refused({"photon", file}, {file});
    expect_refused({"twin", file, "--channel", "left"}, {file});
    expect_refused({"delay", file, "--first", "turntable:0", "--second", "top"}, {file});
    expect_refused(
        {"extrinsics", file, "--camera-model", sensor("demo-camera"), "--target", kBoard, "--rough", "0,0,0"},
        {file});
  }
  expect_refused({"stereo", "nowhere.mcap", "--right-channel", "b", "--target", kBoard}, {"nowhere.mcap"});
  expect_refused({"shading", "nowhere.png", "--base", sensor("demo-camera")}, {"nowhere.png"});
}

TEST_F(CalibrateBadInput, ARecordingThatIsCutInTheMiddleIsReadAsFarAsItGoes) {
  const std::string whole = read_file(CalibrationRecordings::get().board());
  write_file(dir / "half.mcap", whole.substr(0, whole.size() / 2));
  const auto j = answer({"twin", "half.mcap", "--channel", "left"});
  EXPECT_GT(j["samples"].get<int>(), 5);
  ASSERT_FALSE(j["warnings"].empty());
  EXPECT_THAT(j["warnings"].dump(), HasSubstr("half.mcap"));
}

TEST_F(CalibrateBadInput, ChannelsThatAreNotThereListThoseThatAre) {
  const std::string board = CalibrationRecordings::get().board(), wall = CalibrationRecordings::get().wall();
  const std::string sensor_model = sensor("demo-camera");
  expect_refused({"camera", board, "--channel", "middle", "--target", kBoard},
                 {"middle", "left/real", "right"});
  expect_refused({"camera", board, "--target", kBoard}, {"--channel", "left/real", "right"});
  expect_refused({"camera", wall, "--channel", "tof", "--target", kBoard}, {"tof", "/tof/range"});
  expect_refused({"lidar", board, "--channel", "bottom", "--base", sensor("velodyne-vlp16")},
                 {"bottom", "top"});
  expect_refused({"lidar", wall, "--base", sensor("velodyne-vlp16")}, {"PointCloud2", "/tof/range"});
  expect_refused({"tof", board, "--channel", "tof"}, {"tof", "/top/points"});
  expect_refused({"photon", board, "--channel", "middle"}, {"middle", "left/real", "right"});
  expect_refused({"twin", board, "--channel", "right"}, {"right/real", "left/real", "left/simulated"});
  expect_refused({"twin", board}, {"--channel"});
  expect_refused({"delay", board, "--first", "table:0", "--second", "top"}, {"table", "turntable", "top"});
  expect_refused({"delay", board, "--first", "turntable:9", "--second", "top"},
                 {"turntable:9", "index below"});
  expect_refused({"delay", board, "--first", "turntable:x", "--second", "top"}, {"turntable:x"});
  expect_refused({"delay", board, "--first", "turntable:0", "--second", "right"}, {"right", "--target"});
  const std::vector<std::string> mount{"--target", kBoard, "--rough", "0.2,0.2,0"};
  const auto extrinsics = [&](std::vector<std::string> more) {
    more.insert(more.begin(), {"extrinsics", board, "--target", kBoard, "--camera-model", sensor_model});
    return more;
  };
  expect_refused(extrinsics({"--camera", "right", "--second", "bottom", "--rough", "0,0,0"}),
                 {"bottom", "top"});
  expect_refused(extrinsics({"--camera", "right", "--second", "top", "--rough", "0,0"}), {"--rough", "0,0"});
  expect_refused(extrinsics({"--camera", "right", "--second", "top", "--rough", "50,0,0"}),
                 {"--rough", "--margin"});
}

TEST_F(CalibrateBadInput, OutputsThatCannotBeWritten) {
  const std::string board = CalibrationRecordings::get().board();
  write_file(dir / "file", "");
  expect_refused({"twin", board, "--channel", "left", "-o", "file/x.yaml"}, {"file/x.yaml"});
  expect_refused({"twin", board, "--channel", "left", "--report", "file/report"}, {"file/report"});
  expect_refused({"camera", board, "--target", kBoard, "-o", "x.yaml", "--base", "nowhere.yaml"},
                 {"nowhere.yaml"});
}

TEST_F(CalibrateBadInput, SensorModelsThatAreNone) {
  const std::string board = CalibrationRecordings::get().board();
  write_file(dir / "broken.yaml", "width_px: [");
  write_file(dir / "camera.yaml", "width_px: 480\nheight_px: many\n");
  expect_refused({"lidar", board, "--channel", "top", "--base", "broken.yaml"}, {"broken.yaml:"});
  expect_refused({"extrinsics", board, "--camera", "right", "--second", "top", "--target", kBoard, "--rough",
                  "0,0,0", "--camera-model", "camera.yaml"},
                 {"camera.yaml:2", "expected"});
}

TEST_F(CalibrateBadInput, TablesOfNonsense) {
  write_file(dir / "words.csv", "time,reading\nnoon,far\n");
  write_file(dir / "nan.csv", "0.1\n0.2\nnan\n0.3\n");
  write_file(dir / "none.csv", "");
  for (const char* file : {"words.csv", "none.csv"})
    expect_refused({"tof", file, "--period", "0.02"}, {file});
  expect_refused({"tof", "nan.csv", "--period", "0.02"}, {"nan.csv"});
  cv::imwrite((dir / "a.png").string(), cv::Mat(48, 64, CV_8UC1, cv::Scalar(90)));
  write_file(dir / "list.csv", "file,exposure_ms,kind\na.png,often,light\n");
  expect_refused({"photon", "list.csv"}, {"list.csv:2", "exposure_ms"});
  write_file(dir / "list.csv", "a.png,nan,light\n");
  expect_refused({"photon", "list.csv"}, {"a.png", "nan"});
  write_file(dir / "list.csv", "a.png,10,twilight\n");
  expect_refused({"photon", "list.csv"}, {"list.csv:1", "twilight"});
  write_file(dir / "list.csv", "b.png,10,light\n");
  expect_refused({"photon", "list.csv"}, {"b.png"});
  write_file(dir / "gains.csv", "1,2,x\n");
  expect_refused({"shading", "gains.csv", "--base", sensor("demo-camera")}, {"gains.csv"});
}

TEST_F(CalibrateBadInput, PacketsThatAreCutOff) {
  const std::string header(
      "\xd4\xc3\xb2\xa1\x02\x00\x04\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x04\x00\x01\x00\x00\x00", 24);
  write_file(dir / "words.pcap", "this is no capture of packets, though it is long enough");
  write_file(dir / "head.pcap", header.substr(0, 13));
  write_file(dir / "empty.pcap", header);
  // A packet that claims 1248 bytes, of which three came.
  write_file(dir / "cut.pcap",
             header + std::string("\x01\0\0\0\0\0\0\0\xe0\x04\0\0\xe0\x04\0\0", 16) + "abc");
  write_file(dir / "cut.json", "{ \"tcp.payload\": \"02:02:02");
  for (const char* file : {"words.pcap", "head.pcap", "empty.pcap", "cut.pcap", "cut.json", "nowhere.pcap"})
    expect_refused({"lidar", file, "--base", sensor("velodyne-vlp16")}, {file});
}

}  // namespace
}  // namespace rigor::test
