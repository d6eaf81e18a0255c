// PCL's VLP grabber as a peer: it reads the recording in the test data and what the emulator sends, and has
// the same returns as our decoder, in the same order.
#include <gtest/gtest.h>
#include <pcl/io/vlp_grabber.h>

#include <chrono>
#include <cmath>
#include <memory>
#include <mutex>
#include <thread>

#include "drivers/network/pcap_file.h"
#include "drivers/velodyne/packet_decoder.h"
#include "drivers/velodyne/velodyne_emulator.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/drivers/velodyne/formula_lidar.h"
#include "tests/paths.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::velodyne {
namespace {

struct Collected {
  std::mutex mutex;
  std::vector<pcl::PointXYZI> points;
  std::size_t sweeps = 0;
};

void collect(pcl::Grabber& grabber, Collected& to) {
  std::function<pcl::VLPGrabber::sig_cb_velodyne_hdl_sweep_point_cloud_xyzi> f =
      [&to](const pcl::PointCloud<pcl::PointXYZI>::ConstPtr& cloud) {
        const std::lock_guard lock(to.mutex);
        to.points.insert(to.points.end(), cloud->begin(), cloud->end());
        ++to.sweeps;
      };
  grabber.registerCallback(f);
}

/// All returns of a recording by our decoder, without the vertical offsets that PCL does not know.
std::vector<LidarPoint> decoded(const std::string& file) {
  Calibration c = factory_calibration(Model::vlp16);
  for (LaserCalibration& l : c.lasers) l.vertical_offset_m = 0;
  const auto decoder = PacketDecoder::create(Model::vlp16, c);
  auto reader = network::PcapReader::open(file);
  std::vector<LidarPoint> points;
  auto out = std::make_unique<DecodedPacket>();
  while (reader) {
    auto record = reader->next();
    if (!record || !*record) break;
    PacketFault fault{};
    if (!(*record)->udp) continue;
    const auto packet = DataPacket::parse((*record)->udp->payload, fault);
    if (!packet) continue;
    decoder->decode(*packet, *out);
    points.insert(points.end(), out->points.begin(), out->points.begin() + out->point_count);
  }
  return points;
}

/// PCL turns by half blocks alone, we by every laser: ours lies up to 34.56 µs of turning farther round.
void expect_same(const std::vector<pcl::PointXYZI>& theirs, const std::vector<LidarPoint>& ours,
                 std::size_t first, double rotation_hz, double tolerance_rad) {
  ASSERT_LE(first + theirs.size(), ours.size());
  const double turn_rad = 2 * M_PI * rotation_hz * 2.304e-6;
  for (std::size_t i = 0; i < theirs.size(); ++i) {
    const pcl::PointXYZI& a = theirs[i];
    const LidarPoint& b = ours[first + i];
    const double range = std::hypot(b.x_m, b.y_m, b.z_m);
    ASSERT_NEAR(std::hypot(a.x, a.y, a.z), range, 2e-5) << "return " << i;
    ASSERT_NEAR(a.z, b.z_m, 2e-5) << "return " << i;
    ASSERT_EQ(a.intensity, b.remission) << "return " << i;
    // PCL: azimuth 0 along y, clockwise.
    const double theirs_rad = std::atan2(a.x, a.y), ours_rad = -std::atan2(b.y_m, b.x_m);
    const double farther = std::remainder(ours_rad - theirs_rad, 2 * M_PI);
    // PCL takes the first block's step for all and whole hundredths of a degree.
    ASSERT_NEAR(farther, turn_rad * b.ring, tolerance_rad) << "return " << i << " of laser " << b.ring;
  }
}

TEST(PclGrabber, HasTheReturnsOfTheRecordingThatWeHave) {
  const std::string file = rigor::test::test_data("velodyne_vlp16/vlp16_stationary_room.pcap").string();
  if (!std::filesystem::exists(file)) GTEST_SKIP() << "test data: no " << file;
  const auto ours = decoded(file);
  Collected theirs;
  pcl::VLPGrabber grabber(file);
  collect(grabber, theirs);
  grabber.start();
  // 1.28 s at 20 Hz: 26 sweeps and one that is never finished.
  for (int i = 0; i < 3000; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    const std::lock_guard lock(theirs.mutex);
    if (theirs.sweeps >= 26) break;
  }
  grabber.stop();
  const std::lock_guard lock(theirs.mutex);
  ASSERT_GE(theirs.sweeps, 26u);
  EXPECT_GT(theirs.points.size(), ours.size() * 9 / 10);
  // The rotor's own unevenness: 0.05 degrees.
  expect_same(theirs.points, ours, 0, 20, 9e-4);
}

TEST(PclGrabber, TakesWhatTheEmulatorSends) {
  rigor::test::TemporaryDirectory dir;
  const std::string file = dir.file("sent.pcap");
  const auto port = network::test::free_ports();
  VelodyneEmulator emulator;
  DeviceParts parts;
  parts.samples = std::make_shared<test::FormulaLidar>(Model::vlp16, 10);
  emulator.attach(parts);
  auto config = rigor::test::image_config("{port: " + std::to_string(port[0]) + ", position_port: " +
                                          std::to_string(port[1]) + ", pcap: " + file + "}");
  config.kind = SampleKind::point_cloud;
  ASSERT_TRUE(emulator.configure(config));
  ASSERT_TRUE(emulator.arm({}));
  Collected theirs;
  pcl::VLPGrabber grabber(boost::asio::ip::make_address("127.0.0.1"), port[0]);
  collect(grabber, theirs);
  grabber.start();
  ASSERT_TRUE(emulator.start(bench_now()));
  for (int i = 0; i < 2000; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    const std::lock_guard lock(theirs.mutex);
    if (theirs.sweeps >= 6) break;
  }
  // Its reading thread ends with the next packet.
  grabber.stop();
  ASSERT_TRUE(emulator.stop());
  const std::lock_guard lock(theirs.mutex);
  ASSERT_GE(theirs.sweeps, 6u) << "PCL's grabber made no clouds of the emulator's packets";
  expect_same(theirs.points, decoded(file), 0, 10, 6e-4);
}

}  // namespace
}  // namespace rigor::velodyne
