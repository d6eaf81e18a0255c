// The driver against the kernel's own devices: vivid captures, v4l2loopback carries an emulated camera to
// readers, a USB gadget is seen by uvcvideo. Behaviour and counts only: the guest that has these devices is
// slow.
#include <fcntl.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <thread>

#include "drivers/v4l2/v4l2_backend.h"
#include "drivers/v4l2/v4l2_emulator.h"
#include "drivers/v4l2/v4l2_source.h"
#include "tests/drivers/v4l2/kernel_test_tools.h"
#include "tests/drivers/v4l2/usbip_camera.h"

namespace rigor::v4l2 {
namespace {

using testing::HasSubstr;
using namespace test;  // NOLINT: the tools of these tests

struct Seen {
  std::vector<Stamp> stamps;
  std::vector<std::vector<std::byte>> pictures;
  ImageInfo info;
};
/// Polls until `n` samples came or the limit is over.
Seen take(Source& s, std::size_t n, bool pictures = false, Duration limit = seconds(60)) {
  Seen seen;
  const MonotonicTime end = monotonic_now() + limit;
  while (seen.stamps.size() < n && monotonic_now() < end) {
    const SampleLease sample = s.poll(bench_now());
    if (!sample) {
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
      continue;
    }
    seen.stamps.push_back(sample->stamp);
    seen.info = *sample->as<ImageInfo>();
    if (pictures) seen.pictures.emplace_back(sample->bytes().begin(), sample->bytes().end());
  }
  return seen;
}
bool wait_for(const std::function<bool()>& done, Duration limit = seconds(30)) {
  const MonotonicTime end = monotonic_now() + limit;
  while (!done() && monotonic_now() < end) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  return done();
}
Status start(Channel& c, const ChannelConfig& config) {
  if (auto s = c.configure(config); !s) return s;
  if (auto s = c.arm({}); !s) return s;
  return c.start(bench_now());
}

// ------------------------------------------------------------------ capture: vivid

class Vivid : public testing::Test {
 protected:
  void SetUp() override { NEEDS_DEVICE(!vivid().empty(), "vivid"); }
  static ChannelConfig config_of(const std::string& more, double rate_hz = 10,
                                 const std::string& controls = "",
                                 const std::string& event = "start_of_exposure") {
    // Stamps of the start of exposures: vivid stamps the end of frames before it is there.
    return config("{device: " + vivid() + ", width_px: 320, height_px: 180, exposure_us: 1000, " + more +
                      ", controls: {timestamp_source: " + event + (controls.empty() ? "" : ", ") + controls +
                      "}}",
                  seconds_from(1 / rate_hz), milliseconds(200));
  }
};

TEST_F(Vivid, CapturesEachFormat) {
  const struct {
    const char *format, *code;
  } cases[] = {{"Mono8", "GREY"},
               {"Mono10", "Y10"},
               {"Mono12", "Y12"},
               {"Mono16", "Y16"},
               {"YUV422_8", "YUYV"},
               {"YUV422_8", "UYVY"},
               {"RGB8", "RGB3"},
               {"RGB8", "BGR3"},
               {"BayerRG8", "RGGB"},
               {"BayerRG16", "RG16"},
               {"Mono16", "Y16-BE"},
               {"RGB8", "YUYV"},
               {"YCbCr420_8_YY_CbCr_Semiplanar", "NV12"},
               {"YCbCr420_8_YY_CbCr_Semiplanar", "YU12"}};
  std::map<std::string, std::vector<std::byte>> rgb;
  for (const auto& c : cases) {
    V4l2Source s;
    const auto status =
        start(s, config_of(std::string("pixel_format: ") + c.format + ", device_format: " + c.code, 10,
                           "test_pattern: 100_colorbar, osd_text_mode: none"));
    ASSERT_TRUE(status) << c.code << ": " << status.error().text();
    const Seen seen = take(s, 3, true);
    ASSERT_EQ(seen.stamps.size(), 3u) << c.code;
    EXPECT_EQ(pfnc_name(seen.info.format), c.format);
    EXPECT_EQ(seen.pictures[0].size(), image_bytes(seen.info.format, 320, 180));
    EXPECT_EQ(seen.stamps[2].validity, kValid);
    EXPECT_EQ(s.plan().format.code, fourcc_from(c.code));
    if (std::string_view(c.format) == "RGB8") rgb[c.code] = seen.pictures[2];
    EXPECT_TRUE(s.stop());
  }
  // Bars of one and the same picture, whichever way they came: the middle of each.
  for (std::size_t bar = 0; bar < 8; ++bar)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t at = (90 * 320 + bar * 40 + 20) * 3 + k;
      EXPECT_EQ(rgb["RGB3"][at], rgb["BGR3"][at]);
      EXPECT_NEAR(std::to_integer<int>(rgb["RGB3"][at]), std::to_integer<int>(rgb["YUYV"][at]), 6)
          << bar << " " << k;
    }
}

TEST_F(Vivid, AccountsForThreeHundredFrames) {
  V4l2Source s;
  const auto status = start(s, config_of("pixel_format: Mono8, buffers: 16", 30));
  ASSERT_TRUE(status) << status.error().text();
  const Seen seen = take(s, 300, false, seconds(100));
  ASSERT_EQ(seen.stamps.size(), 300u);
  // Each capture that vivid counted came, or was reported as lost with the sample after it.
  std::uint64_t lost = 0;
  for (std::size_t i = 1; i < seen.stamps.size(); ++i) {
    EXPECT_EQ(seen.stamps[i].sequence - seen.stamps[i - 1].sequence, 1u + seen.stamps[i].lost_before) << i;
    EXPECT_GT(seen.stamps[i].t_capture, seen.stamps[i - 1].t_capture);
    lost += seen.stamps[i].lost_before;
  }
  EXPECT_EQ(seen.stamps.back().sequence - seen.stamps.front().sequence + 1, 300 + lost);
  std::printf("%llu video frames sent by vivid, 300 received, %llu reported lost\n",
              static_cast<unsigned long long>(seen.stamps.back().sequence - seen.stamps.front().sequence + 1),
              static_cast<unsigned long long>(lost));
  EXPECT_TRUE(s.stop());
}

TEST_F(Vivid, StampsByTheEventThatTheDriverNames) {
  for (const char* event : {"end_of_frame", "start_of_exposure"}) {
    V4l2Source s;
    const auto status = start(s, config_of("pixel_format: Mono8", 10, "", event));
    ASSERT_TRUE(status) << status.error().text();
    const Seen seen = take(s, 2);
    ASSERT_EQ(seen.stamps.size(), 2u);
    // vivid hands a frame over when it starts: the end that it stamps has then not come, and is not believed.
    if (event == std::string("start_of_exposure"))
      EXPECT_EQ(seen.stamps[1].validity, kValid) << "vivid stamps by CLOCK_MONOTONIC";
    else
      EXPECT_EQ(seen.stamps[1].validity & ~std::uint32_t{kClockUnsure}, kValid);
    // Captured before it arrived, and not long ago even on a slow machine. vivid does not measure its stamps:
    // it counts frame periods from the start (cap_stream_start), and wakes up by jiffies. So a stamp may be
    // ahead, by less than the millisecond that the driver forgives.
    EXPECT_LT(seen.stamps[1].t_capture, seen.stamps[1].t_arrival + milliseconds(1));
    EXPECT_GT(seen.stamps[1].t_capture, seen.stamps[1].t_arrival - seconds(5));
    EXPECT_TRUE(s.stop());
  }
}

TEST_F(Vivid, TakesControlsAndSaysWhichThereAre) {
  V4l2Source s;
  auto status = start(s, config_of("pixel_format: Mono8", 10, "brightnes: 3"));
  ASSERT_FALSE(status);
  EXPECT_THAT(status.error().text(), HasSubstr("did you mean brightness?"));
  V4l2Source t;
  status = start(t, config_of("pixel_format: Mono8", 10, "brightness: 300"));
  ASSERT_FALSE(status);
  EXPECT_THAT(status.error().text(), HasSubstr("0 … 255"));
  V4l2Source u;
  status = start(u, config_of("pixel_format: Mono8", 10,
                              "test_pattern: 100_black, osd_text_mode: none, show_border: false"));
  ASSERT_TRUE(status) << status.error().text();
  const Seen black = take(u, 3, true);
  ASSERT_EQ(black.pictures.size(), 3u);
  EXPECT_LE(std::to_integer<int>(black.pictures[2][90 * 320 + 160]), 1);
  EXPECT_TRUE(u.stop());
  V4l2Source w;
  ASSERT_TRUE(start(w, config_of("pixel_format: Mono8", 10, "test_pattern: 100_white")));
  const Seen white = take(w, 3, true);
  ASSERT_EQ(white.pictures.size(), 3u);
  EXPECT_GE(std::to_integer<int>(white.pictures[2][90 * 320 + 160]), 254);
  EXPECT_TRUE(w.stop());
}

TEST_F(Vivid, SaysWhatTheDeviceOffers) {
  V4l2Source s;
  const auto no_rate = start(s, config_of("pixel_format: Mono8", 26));
  ASSERT_FALSE(no_rate);
  EXPECT_THAT(no_rate.error().text(), HasSubstr("got 26 Hz"));
  V4l2Source t;
  const auto no_depth = start(t, config_of("pixel_format: Coord3D_C16"));
  ASSERT_FALSE(no_depth);
  EXPECT_THAT(no_depth.error().text(), HasSubstr("it offers YUYV"));
  V4l2Source u;
  const auto nobody = start(u, config("{device: /dev/video99}"));
  ASSERT_FALSE(nobody);
  EXPECT_EQ(nobody.error().code, ErrorCode::not_found);
  EXPECT_THAT(nobody.error().text(), HasSubstr(vivid()));
}

TEST_F(Vivid, CapturesIntoDmaBufs) {
  V4l2Source s;
  const auto status =
      start(s, config_of("pixel_format: Mono8, memory: dmabuf", 10, "test_pattern: 100_white"));
  ASSERT_TRUE(status) << status.error().text();
  const Seen seen = take(s, 5, true);
  ASSERT_EQ(seen.pictures.size(), 5u);
  EXPECT_GE(std::to_integer<int>(seen.pictures[4][90 * 320 + 160]), 254);
  const auto notes = s.warnings();
  ASSERT_FALSE(notes.empty());
  EXPECT_THAT(notes.back(), HasSubstr("dmabuf"));
  std::printf("%s\n", notes.back().c_str());
  EXPECT_TRUE(s.stop());
}

TEST_F(Vivid, SurvivesBeingUnplugged) {
  V4l2Source s;
  // By its card: it may come back as another node.
  auto status = start(
      s, config("{device: vivid, width_px: 320, height_px: 180, exposure_us: 1000, pixel_format: Mono8, "
                "device_format: GREY}",
                milliseconds(100), milliseconds(200)));
  ASSERT_TRUE(status) << status.error().text();
  ASSERT_EQ(take(s, 5).stamps.size(), 5u);
  ASSERT_TRUE(write_file("/sys/bus/platform/drivers/vivid/unbind", "vivid.0"));
  EXPECT_TRUE(wait_for([&] { return !s.health().connected; }));
  (void)take(s, 1000, false, milliseconds(1500));
  EXPECT_FALSE(s.health().connected);
  ASSERT_TRUE(write_file("/sys/bus/platform/drivers/vivid/bind", "vivid.0"));
  EXPECT_TRUE(wait_for([&] { return s.health().connected; }));
  const Seen back = take(s, 5);
  ASSERT_EQ(back.stamps.size(), 5u);
  EXPECT_EQ(s.health().reconnects, 1u);
  EXPECT_GE(s.health().lost, 10u) << "a second and a half at 10 Hz and more";
  EXPECT_GE(back.stamps.front().lost_before, 10u);
  for (std::size_t i = 1; i < back.stamps.size(); ++i)
    EXPECT_EQ(back.stamps[i].sequence - back.stamps[i - 1].sequence, 1u + back.stamps[i].lost_before);
  EXPECT_EQ(back.stamps.back().sequence + 1, s.health().received + s.health().lost);
  EXPECT_TRUE(s.stop());
}

TEST_F(Vivid, IsListed) {
  const auto found = v4l2_backend().find_devices();
  bool seen = false;
  for (const FoundDevice& d : found)
    if (d.id == vivid()) {
      seen = true;
      EXPECT_THAT(d.description, HasSubstr("vivid"));
      EXPECT_THAT(d.description, HasSubstr("captures"));
      EXPECT_THAT(d.description, HasSubstr("YUYV"));
    }
  EXPECT_TRUE(seen);
  for (const DoctorFinding& f : v4l2_backend().doctor())
    EXPECT_NE(f.level, DoctorFinding::Level::missing) << f.what;
}

// ------------------------------------------------------------------ output: v4l2loopback

class Loopback : public testing::Test {
 protected:
  static constexpr std::uint32_t kW = 64, kH = 48;
  void SetUp() override { NEEDS_DEVICE(!loopback().empty(), "v4l2loopback"); }
  static Status emulate(V4l2Emulator& e, const std::string& more) {
    e.attach(parts_of(kW, kH));
    return start(e, config("{device: " + loopback() + ", " + more + "}"));
  }
  static ChannelConfig reader(const std::string& more, double rate_hz) {
    return config("{device: " + loopback() + ", " + more + "}", seconds_from(1 / rate_hz), milliseconds(500));
  }
  /// The index of the picture that these bytes are, from `first` on.
  static std::optional<std::uint64_t> index_of(std::span<const std::byte> picture, PixelFormat format,
                                               std::uint64_t first) {
    std::vector<std::byte> p(image_bytes(format, kW, kH));
    for (std::uint64_t i = first; i < first + 2000; ++i) {
      FormulaCamera::fill(i, p);
      if (std::equal(p.begin(), p.end(), picture.begin(), picture.end())) return i;
    }
    return std::nullopt;
  }
};

TEST_F(Loopback, CarriesEachFormatToOurReaderBitForBit) {
  const struct {
    const char *camera, *samples;
    PixelFormat format;
  } cases[] = {{"GREY", "Mono8", PixelFormat::mono8},
               {"YUYV", "YUV422_8", PixelFormat::yuv422_8},
               {"RGB3", "RGB8", PixelFormat::rgb8},
               {"BGR3", "RGB8", PixelFormat::rgb8},
               {"Y16", "Mono16", PixelFormat::mono16},

               {"RGGB", "BayerRG8", PixelFormat::bayer_rg8},
               {"NV12", "YCbCr420_8_YY_CbCr_Semiplanar", PixelFormat::yuv420_sp}};
  for (const auto& c : cases) {
    V4l2Emulator camera;
    auto status = emulate(camera, std::string("rate_hz: 10, formats: [") + c.camera + "]");
    ASSERT_TRUE(status) << c.camera << ": " << status.error().text();
    ASSERT_TRUE(wait_for([&] { return camera.health().received > 0; }));
    V4l2Source s;
    status = start(s, reader(std::string("exposure_us: 2000, pixel_format: ") + c.samples +
                                 ", device_format: " + c.camera,
                             10));
    ASSERT_TRUE(status) << c.camera << ": " << status.error().text();
    const Seen seen = take(s, 6, true);
    ASSERT_EQ(seen.pictures.size(), 6u) << c.camera;
    std::optional<std::uint64_t> last;
    for (std::size_t i = 0; i < seen.pictures.size(); ++i) {
      const auto index = index_of(seen.pictures[i], c.format, last ? *last + 1 : 0);
      ASSERT_TRUE(index) << c.camera << ": picture " << i << " is none that was sent";
      // The stamp that went with it: pictures are a period apart, and so are their stamps, to the
      // microsecond. (What waits when a reader sets its format is stamped anew by the module.)
      if (last && i > 1) {
        const Duration apart = seen.stamps[i].t_capture - seen.stamps[i - 1].t_capture;
        EXPECT_NEAR(static_cast<double>(apart.ns()), static_cast<double>(*index - *last) * 100e6, 2000)
            << c.camera;
      }
      last = index;
    }
    EXPECT_TRUE(s.stop());
    EXPECT_TRUE(camera.stop());
  }
}

TEST_F(Loopback, RefusesToWriteIntoFramesThatAreTooSmall) {
  V4l2Emulator camera;
  const auto status = emulate(camera, "rate_hz: 10, formats: [Y10]");
  if (status) {  // a module that counts right
    EXPECT_TRUE(wait_for([&] { return camera.health().received > 0; }));
    return;
  }
  EXPECT_THAT(status.error().text(), HasSubstr("6144 bytes in a frame of Y10"));
}

#ifdef RIGOR_V4L2_WITH_JPEG
TEST_F(Loopback, CarriesMotionJpeg) {
  V4l2Emulator camera;
  auto status = emulate(camera, "rate_hz: 10, formats: [MJPG], jpeg_quality: 95");
  ASSERT_TRUE(status) << status.error().text();
  ASSERT_TRUE(wait_for([&] { return camera.health().received > 0; }));
  V4l2Source s;
  status = start(s, reader("pixel_format: RGB8, device_format: MJPG", 10));
  ASSERT_TRUE(status) << status.error().text();
  const Seen seen = take(s, 5, true);
  ASSERT_EQ(seen.pictures.size(), 5u);
  for (const Stamp& t : seen.stamps) EXPECT_EQ(t.validity, kValid);
  EXPECT_TRUE(s.stop());
}
#endif

TEST_F(Loopback, AccountsForWhatTheEmulatorSent) {
  V4l2Emulator camera;
  // By write, this module counts the frames that were written.
  auto status = emulate(camera, "rate_hz: 30, formats: [GREY], io: write");
  ASSERT_TRUE(status) << status.error().text();
  ASSERT_TRUE(wait_for([&] { return camera.health().received > 0; }));
  V4l2Source s;
  status = start(s, reader("pixel_format: Mono8, device_format: GREY, buffers: 16", 30));
  ASSERT_TRUE(status) << status.error().text();
  const Seen seen = take(s, 300, true, seconds(100));
  ASSERT_EQ(seen.stamps.size(), 300u);
  std::uint64_t lost = 0;
  std::optional<std::uint64_t> first, last;
  for (std::size_t i = 0; i < seen.pictures.size(); ++i) {
    const auto index = index_of(seen.pictures[i], PixelFormat::mono8, last ? *last + 1 : 0);
    ASSERT_TRUE(index) << "picture " << i << " is none that was sent, or comes twice";
    if (!first) first = index;
    last = index;
    if (i > 0) lost += seen.stamps[i].lost_before;
  }
  // Pictures of the grid in that time: delivered, lost on the way, or never sent, which the emulator counted.
  const std::uint64_t on_grid = *last - *first + 1;
  const std::uint64_t never_sent = camera.health().lost;
  EXPECT_LE(300 + lost, on_grid);
  EXPECT_GE(300 + lost + never_sent, on_grid);
  std::printf(
      "video frames sent within %llu instants (up to %llu left out by the emulator), 300 received, %llu "
      "reported lost\n",
      static_cast<unsigned long long>(on_grid), static_cast<unsigned long long>(never_sent),
      static_cast<unsigned long long>(lost));
  EXPECT_TRUE(s.stop());
  EXPECT_TRUE(camera.stop());
}

TEST_F(Loopback, ServesOtherPeoplesClients) {
  NEEDS_DEVICE(std::system("v4l2-ctl --version >/dev/null 2>&1") == 0, "v4l2-ctl");
  V4l2Emulator camera;
  auto status = emulate(camera, "rate_hz: 10, formats: [YUYV]");
  ASSERT_TRUE(status) << status.error().text();
  ASSERT_TRUE(wait_for([&] { return camera.health().received > 0; }));
  rigor::test::TemporaryDirectory folder;
  const std::string file = folder.file("frames.yuyv");
  // The first frames that a reader gets are the oldest in the module's memory, which the writer fills next.
  const std::string command = "timeout 60 v4l2-ctl -d " + camera.node() +
                              " --stream-mmap=2 --stream-skip=8 --stream-count=10 --stream-to=" + file +
                              " >/dev/null 2>&1";
  ASSERT_EQ(std::system(command.c_str()), 0) << command;
  std::ifstream in(file, std::ios::binary);
  std::vector<char> all((std::istreambuf_iterator<char>(in)), {});
  const std::size_t size = image_bytes(PixelFormat::yuv422_8, kW, kH);
  ASSERT_EQ(all.size(), 10 * size);
  std::uint64_t next = 0;
  for (std::size_t i = 0; i < 10; ++i) {
    const auto index =
        index_of(std::as_bytes(std::span(all).subspan(i * size, size)), PixelFormat::yuv422_8, next);
    ASSERT_TRUE(index) << "frame " << i << " of v4l2-ctl is none that was sent";
    next = *index + 1;
  }
  EXPECT_TRUE(camera.stop());
}

TEST_F(Loopback, ReaderComesBackWhenTheWriterDoes) {
  auto camera = std::make_unique<V4l2Emulator>();
  ASSERT_TRUE(emulate(*camera, "rate_hz: 10, formats: [GREY]"));
  ASSERT_TRUE(wait_for([&] { return camera->health().received > 0; }));
  V4l2Source s;
  const auto status = start(s, reader("pixel_format: Mono8, device_format: GREY, silence_ms: 700", 10));
  ASSERT_TRUE(status) << status.error().text();
  ASSERT_EQ(take(s, 3).stamps.size(), 3u);
  camera.reset();
  EXPECT_TRUE(wait_for([&] { return !s.health().connected; }));
  camera = std::make_unique<V4l2Emulator>();
  ASSERT_TRUE(emulate(*camera, "rate_hz: 10, formats: [GREY]"));
  (void)take(s, 1000, false, milliseconds(500));
  EXPECT_EQ(take(s, 3).stamps.size(), 3u);
  EXPECT_TRUE(s.health().connected);
  EXPECT_GE(s.health().lost, 5u);
  EXPECT_TRUE(s.stop());
}

// ------------------------------------------------------------------ USB gadget

class UsbCamera : public testing::Test {
 protected:
  void SetUp() override {
    NEEDS_DEVICE(!free_controllers().empty() && std::filesystem::exists("/sys/kernel/config/usb_gadget"),
                 "USB device controller (dummy_hcd)");
    NEEDS_DEVICE(std::filesystem::exists("/sys/module/usb_f_uvc"), "usb_f_uvc");
  }
  /// dummy_hcd has no isochronous endpoints, and usb_f_uvc streams by no others: there the kernel takes the
  /// camera's description, and refuses to plug it in. Nothing of it may stay behind.
  static void expect_no_isochronous(const Error& error) {
    EXPECT_EQ(error.code, ErrorCode::unavailable);
    EXPECT_THAT(error.text(), HasSubstr("isochronous"));
    EXPECT_THAT(error.text(), HasSubstr("dummy_udc")) << "a controller that can do it has to";
    EXPECT_FALSE(std::filesystem::exists("/sys/kernel/config/usb_gadget/rigor-left"));
    std::printf("%s\n", error.text().c_str());
  }
  static std::string host_node() {
    for (const DeviceTable& t : list_nodes(false))
      if (t.driver == "uvcvideo" && t.captures && t.card.find("Rigor test camera") != std::string::npos)
        return t.path;
    return {};
  }
};

TEST_F(UsbCamera, IsSeenAsACameraWithItsFormats) {
  V4l2Emulator camera;
  camera.attach(parts_of(64, 48));
  const auto status =
      start(camera, config("{as: usb, formats: [YUYV, GREY, MJPG], rate_hz: 10, card: Rigor test camera}"));
  if (!status) return expect_no_isochronous(status.error());
  ASSERT_TRUE(wait_for([] { return !host_node().empty(); })) << "the host did not see the camera";
  auto device = V4l2Device::open(host_node(), BufferMemory::mmap);
  ASSERT_TRUE(device) << device.error().text();
  const auto table = (*device)->table();
  ASSERT_TRUE(table) << table.error().text();
  ASSERT_EQ(table->formats.size(), 3u);
  for (const std::uint32_t code : {kYuyv, kGrey, kMjpg}) {
    const OfferedFormat* f = table->format(code);
    ASSERT_NE(f, nullptr) << fourcc_text(code);
    ASSERT_EQ(f->sizes.size(), 1u);
    EXPECT_TRUE(f->sizes[0].holds(64, 48));
    ASSERT_FALSE(f->sizes[0].intervals.empty());
    EXPECT_NEAR(f->sizes[0].intervals[0].rate_hz(), 10, 1e-3);
  }
  device->reset();
  // Unplugged, and plugged in again.
  EXPECT_TRUE(camera.stop());
  EXPECT_TRUE(wait_for([] { return host_node().empty(); })) << "the host still sees the camera";
  ASSERT_TRUE(camera.arm({}));
  ASSERT_TRUE(camera.start(bench_now()));
  EXPECT_TRUE(wait_for([] { return !host_node().empty(); }));
  EXPECT_TRUE(camera.stop());
}

TEST_F(UsbCamera, NegotiatesAndStartsItsStream) {
  V4l2Emulator camera;
  camera.attach(parts_of(64, 48));
  auto status =
      start(camera, config("{as: usb, formats: [GREY, YUYV], rate_hz: 10, card: Rigor test camera}"));
  if (!status) return expect_no_isochronous(status.error());
  ASSERT_TRUE(wait_for([] { return !host_node().empty(); }));
  V4l2Source s;
  status =
      start(s, config("{device: " + host_node() + ", pixel_format: YUV422_8, width_px: 64, height_px: 48}",
                      milliseconds(100), milliseconds(500)));
  ASSERT_TRUE(status) << status.error().text();
  EXPECT_TRUE(wait_for([&] { return camera.health().connected; })) << "the stream was not switched on";
  const Seen seen = take(s, 5, true, seconds(5));
  std::printf("%zu frames came through the USB camera, %llu were handed to the gadget\n",
              seen.pictures.size(), static_cast<unsigned long long>(camera.health().received));
  for (const auto& p : seen.pictures) EXPECT_EQ(p.size(), image_bytes(PixelFormat::yuv422_8, 64, 48));
  EXPECT_TRUE(s.stop());
  EXPECT_TRUE(wait_for([&] { return !camera.health().connected; })) << "the stream was not switched off";
  EXPECT_TRUE(camera.stop());
}

// ------------------------------------------------------------------ USB camera: uvcvideo

/// The kernel's uvcvideo with a camera on the virtual host controller of USB/IP.
class UvcVideo : public testing::Test {
 protected:
  static constexpr const char* kCard = "Rigor USB camera";
  static constexpr std::uint32_t kW = 64, kH = 48;
  void SetUp() override {
    NEEDS_DEVICE(std::filesystem::exists("/sys/devices/platform/vhci_hcd.0/attach"), "vhci_hcd");
    NEEDS_DEVICE(std::filesystem::exists("/sys/bus/usb/drivers/uvcvideo"), "uvcvideo");
  }
  static uvc::StreamOffer offer() {
    return {.formats = {{kYuyv, kW, kH, kW * kH * 2}, {kGrey, kW, kH, kW * kH}},
            .intervals = {333333, 1000000},
            .payload_bytes = 1024};
  }
  static ChannelConfig reader(double rate_hz, const std::string& more) {
    return config("{device: " + std::string(kCard) +
                      ", exposure_us: 1000, width_px: 64, height_px: 48, buffers: 16, " + more + "}",
                  seconds_from(1 / rate_hz), milliseconds(300));
  }
  static bool there() {
    for (const DeviceTable& t : list_nodes(false))
      if (t.driver == "uvcvideo" && t.captures && t.card.find(kCard) != std::string::npos) return true;
    return false;
  }
  static std::uint32_t number_of(const std::vector<std::byte>& picture) {
    std::uint32_t n = 0;
    std::memcpy(&n, picture.data(), 4);
    return n;
  }
};

TEST_F(UvcVideo, AccountsForThreeHundredFrames) {
  UsbipCamera camera(offer(), kCard);
  ASSERT_EQ(camera.plug(), "");
  ASSERT_TRUE(wait_for(there)) << "the host did not see the camera";
  camera.damage_every(50);
  V4l2Source s;
  const auto status = start(s, reader(30, "pixel_format: YUV422_8, device_format: YUYV"));
  ASSERT_TRUE(status) << status.error().text();
  const Seen seen = take(s, 300, true, seconds(100));
  ASSERT_EQ(seen.stamps.size(), 300u);
  // Each picture came as it was sent, or was reported as lost with the one after it: the damaged ones, and
  // those for which there was no buffer.
  std::uint64_t lost = 0, damaged = 0;
  const std::uint32_t first = number_of(seen.pictures.front()), last = number_of(seen.pictures.back());
  for (std::size_t i = 0; i < 300; ++i) {
    const std::uint32_t n = number_of(seen.pictures[i]);
    ASSERT_EQ(seen.pictures[i], UsbipCamera::picture(n, kW * kH * 2)) << "picture " << i;
    EXPECT_EQ(seen.stamps[i].validity, kValid) << i;
    if (i == 0) continue;
    lost += seen.stamps[i].lost_before;
    EXPECT_EQ(n - number_of(seen.pictures[i - 1]), 1 + seen.stamps[i].lost_before) << i;
    EXPECT_GT(seen.stamps[i].t_capture, seen.stamps[i - 1].t_capture);
  }
  for (std::uint32_t n = first; n <= last; ++n) damaged += n % 50 == 49;
  EXPECT_EQ(last - first + 1, 300 + lost);
  EXPECT_GE(lost, damaged);
  std::printf(
      "%u video frames sent by a USB camera (%llu of them damaged on the bus), 300 received, %llu reported "
      "lost\n",
      last - first + 1, static_cast<unsigned long long>(damaged), static_cast<unsigned long long>(lost));
  EXPECT_TRUE(s.stop());
  EXPECT_TRUE(wait_for([&] { return !camera.streams(); })) << "the stream was not switched off";
}

TEST_F(UvcVideo, NegotiatesFormatsAndRates) {
  UsbipCamera camera(offer(), kCard);
  ASSERT_EQ(camera.plug(), "");
  ASSERT_TRUE(wait_for(there));
  const struct {
    double rate_hz;
    const char *samples, *code;
    PixelFormat format;
  } cases[] = {{10, "Mono8", "GREY", PixelFormat::mono8}, {30, "YUV422_8", "YUYV", PixelFormat::yuv422_8}};
  for (const auto& c : cases) {
    V4l2Source s;
    const auto status =
        start(s, reader(c.rate_hz, std::string("pixel_format: ") + c.samples + ", device_format: " + c.code));
    ASSERT_TRUE(status) << c.code << ": " << status.error().text();
    const Seen seen = take(s, 3, true);
    ASSERT_EQ(seen.pictures.size(), 3u) << c.code;
    EXPECT_EQ(seen.info.format, c.format);
    EXPECT_EQ(seen.pictures[2],
              UsbipCamera::picture(number_of(seen.pictures[2]), image_bytes(c.format, kW, kH)));
    EXPECT_TRUE(s.stop());
  }
  V4l2Source s;
  const auto status = start(s, reader(20, "pixel_format: Mono8"));
  ASSERT_FALSE(status);
  EXPECT_THAT(status.error().text(), HasSubstr("got 20 Hz"));
}

TEST_F(UvcVideo, SurvivesBeingUnplugged) {
  UsbipCamera camera(offer(), kCard);
  ASSERT_EQ(camera.plug(), "");
  ASSERT_TRUE(wait_for(there));
  V4l2Source s;
  const auto status = start(s, reader(10, "pixel_format: Mono8, device_format: GREY"));
  ASSERT_TRUE(status) << status.error().text();
  ASSERT_EQ(take(s, 5).stamps.size(), 5u);
  camera.unplug();
  EXPECT_TRUE(wait_for([&] { return !s.health().connected; }));
  (void)take(s, 1000, false, milliseconds(1500));
  EXPECT_FALSE(s.health().connected);
  const MonotonicTime plugged = monotonic_now();
  ASSERT_EQ(camera.plug(), "");
  const Seen back = take(s, 5, true);
  ASSERT_EQ(back.stamps.size(), 5u);
  std::printf("USB camera: back after %.0f ms, %llu captures reported lost\n",
              static_cast<double>((back.stamps.front().t_arrival - BenchTime(plugged.ns())).ns()) * 1e-6,
              static_cast<unsigned long long>(s.health().lost));
  EXPECT_EQ(s.health().reconnects, 1u);
  EXPECT_GE(s.health().lost, 10u) << "a second and a half at 10 Hz and more";
  EXPECT_EQ(back.stamps.back().sequence + 1, s.health().received + s.health().lost);
  EXPECT_TRUE(s.stop());
}

}  // namespace
}  // namespace rigor::v4l2
