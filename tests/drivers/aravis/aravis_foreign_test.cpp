// The source with a camera that is not ours: Aravis' own fake one, whose features have other names
// (ExposureTimeAbs, GainRaw), whose clock counts CLOCK_REALTIME and cannot be latched.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/aravis/aravis_source.h"
#include "drivers/aravis/gige_discovery.h"
#include "tests/drivers/aravis/aravis_test_tools.h"
#include "tests/drivers/aravis/camera_process.h"
#include "tests/paths.h"

namespace rigor {
namespace {

using ::testing::HasSubstr;
using testing::make_config;
using testing::run_for;

class ForeignCamera : public ::testing::Test {
 protected:
  void SetUp() override {
    if (gige::ask_gige_camera("127.0.0.1", milliseconds(100)))
      GTEST_SKIP() << "another camera serves on 127.0.0.1, the one address that Aravis' fake camera can have";
    process = std::make_unique<testing::CameraProcess>(rigor::test::build_dir() + "/tests/foreign_camera",
                                                       "127.0.0.1", "FOREIGN", "0", "0");
  }
  std::unique_ptr<testing::CameraProcess> process;
};

TEST_F(ForeignCamera, WithOtherFeatureNamesAndNoLatchIsAChannelToo) {
  AravisSource source;
  ASSERT_TRUE(source.configure(
      make_config("{address: 127.0.0.1, exposure_us: 2000, region: {width_px: 256, height_px: 128}}")));
  const auto armed = source.arm({});
  ASSERT_TRUE(armed) << armed.error().text();
  ASSERT_TRUE(source.start(testing::now()));
  const auto seen = run_for(source, seconds(3));
  ASSERT_TRUE(source.stop());
  ASSERT_GE(seen.size(), 60U);
  EXPECT_EQ(source.counters().latches, 0U);
  EXPECT_EQ(seen[0].image.exposure, milliseconds(2));
  for (std::size_t i = 10; i < seen.size(); ++i) {
    const Stamp& s = seen[i].stamp;
    EXPECT_EQ(s.validity, kValid) << i;
    EXPECT_EQ(s.sequence, seen[0].stamp.sequence + i) << "its ids roll over near the beginning";
    EXPECT_LT(s.t_capture, s.t_arrival + s.sigma_capture * 3);
    EXPECT_GT(s.t_capture, s.t_arrival - milliseconds(60));
  }
}

TEST_F(ForeignCamera, RefusalsNameItsOwnRanges) {
  AravisSource source;
  ASSERT_TRUE(source.configure(make_config("{address: 127.0.0.1, trigger: software, exposure_us: 5e8}")));
  const auto armed = source.arm({});
  ASSERT_FALSE(armed);
  EXPECT_THAT(armed.error().text(), HasSubstr("exposure_us: expected 10 … 1e+07 µs"));
  ASSERT_TRUE(source.configure(make_config("{address: 127.0.0.1, pixel_format: Mono12p}")));
  EXPECT_THAT(source.arm({}).error().text(), HasSubstr("expected a format that the camera offers (BayerBG8"));
}

}  // namespace
}  // namespace rigor
