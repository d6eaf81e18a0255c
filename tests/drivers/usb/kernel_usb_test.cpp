// The scanner and the bulk source on a real kernel's USB: a gadget on dummy_hcd on one side, libusb on the
// other. Counted behaviour; where the kernel lives in an emulator, time means little.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "drivers/usb/bulk_emulator.h"
#include "drivers/usb/libusb_link.h"
#include "drivers/usb/usb_backend.h"
#include "tests/drivers/usb/usb_test_tools.h"
#include "tests/paths.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::usb {
namespace {

namespace fs = std::filesystem;
using testing::formula_scan;
using testing::RunningEmulator;
using testing::scanner_config;

BenchTime now() { return bench_now(); }

std::unique_ptr<ByteLink> any_link(const LinkSettings& s) {
  return s.transport == Transport::usb ? make_libusb_link(s.usb) : make_plain_link(s);
}

/// The driver that has interface `n` of the scanner, by sysfs.
std::string driver_of(const std::string& usb_path, int n) {
  std::error_code error;
  const auto link =
      fs::read_symlink("/sys/bus/usb/devices/" + usb_path + ":1." + std::to_string(n) + "/driver", error);
  return error ? std::string() : link.filename().string();
}

std::string path_of_scanner() {
  for (const auto& d : list_usb_devices())
    if (d.vendor == 0x15d1) return d.path;
  return {};
}

template <class F>
bool within(Duration limit, F&& is) {
  const BenchTime end = now() + limit;
  while (!is()) {
    if (now() > end) return false;
    usleep(5000);
  }
  return true;
}

class KernelUsb : public ::testing::Test {
 protected:
  void SetUp() override {
    const bool must = std::getenv("RIGOR_GUEST") != nullptr;
    (void)!std::system("modprobe -aq dummy_hcd libcomposite usb_f_acm usb_f_fs cdc_acm 2>/dev/null");
    (void)!std::system(
        "mountpoint -q /sys/kernel/config || mount -t configfs none /sys/kernel/config 2>/dev/null");
    const std::string why = gadget_obstacle();
    if (why.empty()) return;
    if (must) FAIL() << why;
    GTEST_SKIP() << "this kernel has no USB gadgets on dummy_hcd: " << why;
  }
  struct Seen {
    std::uint64_t n = 0, missing = 0, first = 0, last = 0, torn = 0;
    void add(const Sample& sample, bool whole) {
      if (n++ == 0) first = sample.stamp.sequence;
      last = sample.stamp.sequence;
      missing += sample.stamp.lost_before;
      torn += !whole;
    }
  };
  template <class Until>
  void poll(Source& source, Seen& seen, Duration limit, Until&& until) {
    const BenchTime end = now() + limit;
    while (now() < end && !until()) {
      while (SampleLease lease = source.poll(now()))
        seen.add(*lease, lease->kind() != SampleKind::point_cloud || formula_scan(*lease, urg_04lx()) >= 0);
      usleep(2000);
    }
  }
};

TEST_F(KernelUsb, ScannerGadgetEndToEndUnpluggedAndBack) {
  auto e = std::make_unique<RunningEmulator>("{as: gadget, model: urg-04lx, serial: H0042}", urg_04lx());
  ASSERT_EQ(e->problem, "");
  ASSERT_TRUE(within(seconds(20), [] { return !path_of_scanner().empty(); }))
      << "the gadget is not on the bus";
  const std::string path = path_of_scanner();
  // The kernel's own driver takes it first.
  EXPECT_TRUE(within(seconds(20), [&] { return driver_of(path, 0) == "cdc_acm"; })) << driver_of(path, 0);
  const auto found = usb_backend().find_devices();
  EXPECT_TRUE(std::any_of(found.begin(), found.end(), [](const auto& f) {
    return f.id.find("15d1:0000") != std::string::npos && f.description.find("scip") != std::string::npos;
  }));

  ScipSource source(any_link);
  auto s = source.configure(scanner_config("{serial: H0042, slots: 64, usb_path: \"" + path + "\"}",
                                           milliseconds(100), milliseconds(80)));
  ASSERT_TRUE(s) << s.error().text();
  s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(driver_of(path, 0), "usbfs") << "cdc_acm was not sent away";
  ASSERT_TRUE(source.start(now()));
  Seen seen;
  poll(source, seen, seconds(60), [&] { return seen.n >= 30; });
  EXPECT_GE(seen.n, 30u);
  EXPECT_EQ(seen.torn, 0u);
  const std::uint64_t sent = e->emulator.counters().scans_sent;
  std::printf("before it is unplugged: %lu scans sent, %lu received, %lu reported lost\n", sent, seen.n,
              seen.missing);

  // Unplugged with transfers in flight.
  e.reset();
  poll(source, seen, seconds(30), [&] { return !source.health().connected; });
  EXPECT_FALSE(source.health().connected);
  const std::uint64_t before = seen.n;
  usleep(300000);
  const BenchTime back = now();
  e = std::make_unique<RunningEmulator>("{as: gadget, model: urg-04lx, serial: H0042}", urg_04lx());
  ASSERT_EQ(e->problem, "");
  poll(source, seen, seconds(60), [&] { return seen.n > before; });
  std::printf("back after %.0f ms, %lu scans reported lost\n", (now() - back).seconds() * 1e3, seen.missing);
  poll(source, seen, seconds(60), [&] { return seen.n >= before + 10; });
  EXPECT_GE(seen.n, before + 10);
  EXPECT_GE(source.health().reconnects, 1u);
  ASSERT_TRUE(source.stop());
  EXPECT_EQ(seen.last - seen.first + 1, seen.n + seen.missing);
  EXPECT_EQ(seen.torn, 0u);
  // The terminal is the kernel's again.
  EXPECT_TRUE(within(seconds(10), [&] { return driver_of(path, 0) == "cdc_acm"; })) << driver_of(path, 0);
}

TEST_F(KernelUsb, EveryScanThatIsSentIsReceivedOrReportedLost) {
  RunningEmulator e("{as: gadget, model: urg-04lx}", urg_04lx());
  ASSERT_EQ(e.problem, "");
  ScipSource source(any_link);
  ASSERT_TRUE(source.configure(scanner_config("{slots: 64}", milliseconds(100), milliseconds(80))));
  ASSERT_TRUE(within(seconds(20), [] { return !path_of_scanner().empty(); }));
  const auto s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(now()));
  std::vector<std::int64_t> numbers;
  std::uint64_t missing = 0;
  const BenchTime end = now() + seconds(90);
  while (numbers.size() < 60 && now() < end) {
    while (SampleLease lease = source.poll(now())) {
      numbers.push_back(formula_scan(*lease, urg_04lx()));
      if (numbers.size() > 1) missing += lease->stamp.lost_before;
    }
    usleep(2000);
  }
  ASSERT_GE(numbers.size(), 60u);
  ASSERT_TRUE(source.stop());
  std::printf("%ld scans sent, %zu received, %lu reported lost\n",
              static_cast<long>(numbers.back() - numbers.front() + 1), numbers.size(), missing);
  EXPECT_EQ(static_cast<std::uint64_t>(numbers.back() - numbers.front() + 1), numbers.size() + missing);
}

TEST_F(KernelUsb, AnotherReaderOverTheKernelsTerminal) {
  if (std::system("command -v python3 >/dev/null") != 0) GTEST_SKIP() << "python3 is not installed";
  RunningEmulator e("{as: gadget, model: urg-04lx}", urg_04lx());
  ASSERT_EQ(e.problem, "");
  const auto tty = [] {
    std::error_code error;
    for (const auto& d : fs::directory_iterator("/sys/class/tty", error))
      if (d.path().filename().string().rfind("ttyACM", 0) == 0) return "/dev/" + d.path().filename().string();
    return std::string();
  };
  ASSERT_TRUE(within(seconds(20), [&] { return fs::exists(tty()); })) << "no /dev/ttyACM";
  usleep(500000);
  EXPECT_EQ(std::system(("python3 -I -S " + rigor::test::source_dir() + "/tests/drivers/usb/scip_reader.py " +
                         tty() + " 3")
                            .c_str()),
            0);
  // And our own source over it.
  ScipSource source(any_link);
  ASSERT_TRUE(source.configure(
      scanner_config("{transport: tty, device: " + tty() + "}", milliseconds(100), milliseconds(80))));
  const auto s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(now()));
  Seen seen;
  poll(source, seen, seconds(60), [&] { return seen.n >= 5; });
  EXPECT_GE(seen.n, 5u);
  EXPECT_EQ(seen.torn, 0u);
  ASSERT_TRUE(source.stop());
}

TEST_F(KernelUsb, BulkFramesFromFunctionFsWithAStallAndAnUnplug) {
  const std::string frame =
      "frame: {magic: 52474654, header_bytes: 24, width_px: 16, height_px: 12, sequence: {at: 4, type: u32}, "
      "stamp: {at: 8, type: u64, tick_ns: 1000}, length: {at: 16, type: u32}, "
      "planes: [{name: range, type: f32}, {name: amplitude, type: f32}]}";
  BulkEmulator e;
  DeviceParts parts;
  parts.samples = std::make_shared<test::FormulaSamples>(SampleKind::range_image);
  e.attach(parts);
  auto s = e.configure(
      scanner_config("{as: gadget, vendor: 0x1209, product: 0x0042, rate_hz: 10, " + frame + "}"));
  if (s) s = e.arm({});
  if (s) s = e.start(now());
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(within(seconds(20), [] {
    for (const auto& d : list_usb_devices())
      if (d.vendor == 0x1209) return d.bulk_interface == 0 && d.bulk_endpoint == 0x81;
    return false;
  }));
  BulkSource source(any_link);
  ChannelConfig config =
      scanner_config("{protocol: bulk, vendor: 0x1209, product: 0x0042, slots: 64, " + frame + "}",
                     milliseconds(100), milliseconds(50));
  config.kind = SampleKind::range_image;
  s = source.configure(config);
  if (s) s = source.arm({});
  if (s) s = source.start(now());
  ASSERT_TRUE(s) << s.error().text();
  std::vector<std::uint64_t> sequence;
  std::uint64_t missing = 0;
  const auto take = [&](std::size_t n, Duration limit) {
    const BenchTime end = now() + limit;
    while (sequence.size() < n && now() < end) {
      while (SampleLease lease = source.poll(now())) {
        if (!sequence.empty()) missing += lease->stamp.lost_before;
        sequence.push_back(lease->stamp.sequence);
        // Value i of the range plane is index + 0.01 i: one frame's own throughout.
        float first = 0, last = 0;
        std::memcpy(&first, lease->bytes().data(), 4);
        std::memcpy(&last, lease->bytes().data() + 191 * 4, 4);
        EXPECT_NEAR(last - first, 1.91, 0.01);
      }
      usleep(2000);
    }
    return sequence.size() >= n;
  };
  EXPECT_TRUE(take(20, seconds(60)));
  e.stall_once();
  EXPECT_TRUE(take(40, seconds(60))) << "it did not go on after a stall";
  e.device()->unplug();
  EXPECT_TRUE(within(seconds(20), [&] {
    (void)take(sequence.size() + 1, milliseconds(10));
    return !source.health().connected;
  }));
  const std::size_t before = sequence.size();
  const BenchTime back = now();
  const auto plugged = e.device()->plug();
  ASSERT_TRUE(plugged) << plugged.error().text();
  EXPECT_TRUE(take(before + 1, seconds(60)));
  std::printf("back after %.0f ms\n", (now() - back).seconds() * 1e3);
  EXPECT_TRUE(take(before + 10, seconds(60)));
  ASSERT_TRUE(source.stop());
  EXPECT_GE(source.link_counters().stalls, 1u);
  EXPECT_EQ(sequence.back() - sequence.front() + 1, sequence.size() + missing);
  std::printf("%lu frames sent, %zu received, %lu reported lost, %lu stalls\n",
              sequence.back() - sequence.front() + 1, sequence.size(), missing,
              source.link_counters().stalls);
  ASSERT_TRUE(e.stop());
}

}  // namespace
}  // namespace rigor::usb
