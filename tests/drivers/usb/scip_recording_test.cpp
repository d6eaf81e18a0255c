// The recorded scans of a URG-04LX through the emulated scanner, its bytes, and the decoder.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "drivers/usb/scan_keeper.h"
#include "tests/paths.h"

namespace rigor::usb {
namespace {

std::vector<std::vector<std::uint32_t>> recorded() {
  std::vector<std::vector<std::uint32_t>> scans;
  std::ifstream in(rigor::test::test_data("hokuyo_urg04lx/exp1.dat"));
  for (std::string line; std::getline(in, line);) {
    std::istringstream fields(line);
    std::string skipped;
    for (int i = 0; i < 23; ++i) fields >> skipped;
    std::vector<std::uint32_t> scan;
    for (std::uint32_t mm = 0; fields >> mm;) scan.push_back(mm);
    if (scan.size() >= 682) scans.push_back(std::move(scan));
  }
  return scans;
}

TEST(ScipRecording, EveryRangeOfEveryScanSurvivesTheWire) {
  const auto scans = recorded();
  if (scans.empty()) GTEST_SKIP() << "no test data: hokuyo_urg04lx";
  ASSERT_EQ(scans.size(), 756u);
  const auto& p = urg_04lx().parameters;
  const std::uint32_t width = p.last_step - p.first_step + 1;
  std::uint64_t returns = 0, scan_returns = 0;
  std::size_t played = 0;
  ScipDevice device(urg_04lx(),
                    [&](std::uint64_t, DeviceTime, std::span<std::uint32_t> range, std::span<std::uint32_t>) {
                      const auto& scan = scans[played++];
                      for (std::uint32_t s = 0; s < width; ++s) range[p.first_step + s] = scan[s];
                      return true;
                    },
                    {});
  ScipReplyReader reader;
  ScipReply reply;
  ScipScan scan;
  std::size_t seen = 0;
  std::vector<LidarPoint> points(width);
  // 99 at a time is the most that one command can ask for.
  for (DeviceTime t; seen < scans.size(); t = t + seconds(20)) {
    ScanRequest r;
    r.first_step = p.first_step;
    r.last_step = p.last_step;
    r.scans = static_cast<std::uint32_t>(std::min<std::size_t>(99, scans.size() - seen));
    device.receive(r.line() + "\n", t);
    for (DeviceTime at = t; device.measuring(); at = at + milliseconds(50)) {
      device.advance(at);
      reader.push(std::exchange(device.output(), {}), at.ns());
      while (reader.next(reply)) {
        if (decode_scan(reply, scan) != ScanDecode::scan) continue;
        ASSERT_EQ(scan.range_mm.size(), width);
        ASSERT_TRUE(std::equal(scan.range_mm.begin(), scan.range_mm.end(), scans[seen].begin()))
            << "scan " << seen;
        std::uint64_t wanted = 0;
        for (const std::uint32_t mm : scan.range_mm) wanted += mm >= p.min_range_mm && mm <= p.max_range_mm;
        scan_returns += wanted;
        returns += scan_points(scan, p, points);
        ++seen;
      }
    }
  }
  EXPECT_EQ(seen, scans.size());
  EXPECT_EQ(returns, scan_returns);
  EXPECT_GT(returns, 100'000u);
}

}  // namespace
}  // namespace rigor::usb
