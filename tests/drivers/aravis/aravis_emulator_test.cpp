// The emulator as a channel, seen by the source.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <mutex>

#include "drivers/aravis/aravis_source.h"
#include "drivers/aravis/gige_channel_emulator.h"
#include "drivers/aravis/gige_discovery.h"
#include "tests/drivers/aravis/aravis_test_tools.h"

namespace rigor {
namespace {

using ::testing::HasSubstr;
using testing::make_config;
using testing::run_for;

class Pictures final : public ImageProvider {
 public:
  [[nodiscard]] Geometry geometry() const override {
    return {.width_px = 320,
            .height_px = 200,
            .format = PixelFormat::rgb8,
            .exposure = milliseconds(3),
            .frame_id = "f"};
  }
  [[nodiscard]] Status capture(const ImageRequest& r, std::span<std::byte> pixels) override {
    // The middle of the exposure and the joint's angle go out in the picture.
    const auto t = static_cast<std::uint64_t>(r.t_capture.ns());
    const auto angle = static_cast<std::uint64_t>(std::llround(r.motion.joint[0].at(r.t_capture) * 1e9));
    std::vector<std::uint8_t> bytes(pixels.size(), static_cast<std::uint8_t>(r.gain_db));
    store_be(gige::MutableBytes(bytes), 0, t);
    store_be(gige::MutableBytes(bytes), 8, angle);
    std::memcpy(pixels.data(), bytes.data(), bytes.size());
    const std::lock_guard lock(mutex);
    last = r;
    return {};
  }
  std::mutex mutex;
  ImageRequest last;
};
class Turning final : public MotionSource {
 public:
  [[nodiscard]] WorldMotion motion_at(BenchTime t) const noexcept override {
    WorldMotion m;
    m.count = 1;
    m.joint[0] = JointState{
        .t_ref = t, .position_rad = static_cast<double>(t.ns() % 1'000'000'000) * 1e-9, .rate_radps = 1};
    return m;
  }
};

TEST(GigeChannelEmulator, ShowsTheProvidersPictureAsTheClientWantsIt) {
  auto pictures = std::make_shared<Pictures>();
  GigeChannelEmulator emulator;
  DeviceParts parts;
  parts.image = pictures;
  parts.motion = std::make_shared<Turning>();
  emulator.attach(parts);
  ChannelConfig c =
      make_config("{address: 127.0.0.61, vendor: Rigor, serial: emu61, user_name: left eye, rate_hz: 25}");
  ASSERT_TRUE(emulator.configure(c));
  ASSERT_TRUE(emulator.arm({}));
  ASSERT_TRUE(emulator.start(testing::now()));
  EXPECT_EQ(emulator.endpoint(), "GigE Vision camera Rigor-emu61 at 127.0.0.61");

  AravisSource source;
  ASSERT_TRUE(
      source.configure(make_config("{device: left eye, pixel_format: Mono16, exposure_us: 5000, gain_db: 7, "
                                   "region: {x_px: 16, y_px: 8, width_px: 128, height_px: 64}}")));
  const auto armed = source.arm({});
  ASSERT_TRUE(armed) << armed.error().text();
  ASSERT_TRUE(source.start(testing::now()));
  std::size_t n = 0;
  const BenchTime end = testing::now() + seconds(2);
  while (testing::now() < end) {
    if (auto lease = source.poll(testing::now())) {
      const auto* bytes = reinterpret_cast<const std::uint8_t*>(lease->bytes().data());
      const gige::Bytes b(bytes, lease->bytes().size());
      ASSERT_EQ(b.size(), 128U * 64U * 2U);
      const auto t = static_cast<std::int64_t>(load_be<std::uint64_t>(b, 0));
      EXPECT_EQ(load_be<std::uint64_t>(b, 8), static_cast<std::uint64_t>(t % 1'000'000'000));
      EXPECT_EQ(b[100], 7);
      EXPECT_LT(std::abs((lease->stamp.t_capture - BenchTime(t)).ns()), 5 * lease->stamp.sigma_capture.ns());
      ++n;
    }
    usleep(1000);
  }
  EXPECT_GE(n, 45U);
  EXPECT_TRUE(emulator.health().connected);
  {
    const std::lock_guard lock(pictures->mutex);
    EXPECT_EQ(pictures->last.exposure, milliseconds(5));
    EXPECT_EQ(pictures->last.offset_x_px, 16U);
    EXPECT_EQ(pictures->last.height_px, 64U);
    EXPECT_EQ(pictures->last.format, PixelFormat::mono16);
  }
  ASSERT_TRUE(source.stop());
  usleep(500'000);
  EXPECT_FALSE(emulator.health().connected);
  ASSERT_TRUE(emulator.stop());
  EXPECT_GE(emulator.counters().frames_sent, n);
  EXPECT_FALSE(gige::ask_gige_camera("127.0.0.61", milliseconds(100)));
  ASSERT_TRUE(emulator.arm({}));
  ASSERT_TRUE(emulator.start(testing::now()));
  EXPECT_TRUE(gige::ask_gige_camera("127.0.0.61", milliseconds(500)));
  ASSERT_TRUE(emulator.stop());
}

TEST(GigeChannelEmulator, SaysWhatIsMissing) {
  GigeChannelEmulator emulator;
  EXPECT_FALSE(emulator.configure(make_config("{address: here}")));
  ASSERT_TRUE(emulator.configure(make_config("{address: 127.0.0.61, serial: x}")));
  const auto armed = emulator.arm({});
  ASSERT_FALSE(armed);
  EXPECT_THAT(armed.error().text(), HasSubstr("makes pictures"));
  DeviceParts parts;
  parts.image = std::make_shared<Pictures>();
  emulator.attach(parts);
  ASSERT_TRUE(emulator.configure(make_config("{address: 192.0.2.77, serial: x}")));
  ASSERT_TRUE(emulator.arm({}));
  const auto started = emulator.start(testing::now());
  ASSERT_FALSE(started);
  EXPECT_THAT(started.error().text(), HasSubstr("192.0.2.77"));
  EXPECT_EQ(emulator.state(), ChannelState::armed);
}

}  // namespace
}  // namespace rigor
