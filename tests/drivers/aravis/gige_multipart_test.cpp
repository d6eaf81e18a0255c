// Frames of several parts as the emulated camera makes them: range and amplitude of one exposure.
#include "tests/drivers/aravis/gige_model_bench.h"

namespace rigor::gige {
namespace {

/// A camera of range and amplitude whose client wants frames of several parts.
class GigeMultipart : public testing::GigeModel {
 protected:
  void SetUp() override {
    GigeCameraConfig c;
    c.formats = {PixelFormat::coord3d_c16};
    c.range.present = true;
    model = GigeDeviceModel::create(c).value();
    open();
    EXPECT_EQ(write(reg::kWidth, 16), GvStatus::success);
    EXPECT_EQ(write(reg::kHeight, 16), GvStatus::success);
    EXPECT_EQ(write(reg::kStreamConfiguration, reg::kMultipart), GvStatus::success);
  }
};

TEST_F(GigeMultipart, AFrameKeepsOneOfItsPictures) {
  const std::uint32_t both = get(reg::kPayloadSize);
  EXPECT_EQ(write(reg::kComponentSelector, kIntensity), GvStatus::success);
  EXPECT_EQ(write(reg::kComponentEnable, 0), GvStatus::success);
  EXPECT_EQ(get(reg::kPayloadSize), both / 2);
  EXPECT_EQ(write(reg::kComponentSelector, kRange), GvStatus::success);
  EXPECT_EQ(write(reg::kComponentEnable, 0), GvStatus::invalid_parameter);
  EXPECT_EQ(get(reg::kComponentEnable), 1U);
  EXPECT_EQ(get(reg::kPayloadSize), both / 2);
}

TEST_F(GigeMultipart, HaveNoChunks) {
  EXPECT_EQ(write(reg::kChunkModeActive, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  const auto out = expose(DeviceTime::never());
  ASSERT_TRUE(out);
  EXPECT_EQ(out->block->leader.payload_type, kMultipartPayload);
  EXPECT_EQ(out->block->data.size(), 2U * 16 * 16 * 2);
  EXPECT_EQ(out->block->data.size(), get(reg::kPayloadSize));
}

TEST_F(GigeMultipart, HaveBlockIdsOf64Bits) {
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  for (std::uint64_t n = 1; n <= 65537; ++n) {
    const auto out = expose(DeviceTime::never());
    ASSERT_TRUE(out);
    ASSERT_EQ(out->block->block_id, n);
    if (n % 50 == 0) now = model.next_exposure(), (void)get(reg::kControlPrivilege);
  }
}

}  // namespace
}  // namespace rigor::gige
