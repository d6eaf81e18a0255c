// What a camera may say of the size of its frames. The numbers are those of a camera that lies: memory is
// taken for 16 buffers of what it says.
#include "drivers/aravis/payload_size.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace rigor {
namespace {

using testing::HasSubstr;

std::string said(const PayloadClaim& claim, const AravisSettings& settings = {}) {
  ChannelConfig config;
  config.name = "left";
  const auto checked = catch_config([&] {
    check_payload(claim, settings, config);
    return 0;
  });
  return checked ? "(accepted)" : checked.error().text();
}

TEST(PayloadSize, WithoutChunksOrPartsIsThatOfThePicture) {
  EXPECT_EQ(said({640, 480, 640 * 480}), "(accepted)");
  EXPECT_THAT(said({640, 480, 640 * 480 + 1}),
              HasSubstr("left: expected 307200 bytes for each picture of 640x480 Mono8"));
  EXPECT_THAT(said({640, 0, 0}),
              HasSubstr("expected a region of 1 … 268435456 pixels, the camera says 640x0"));
}

TEST(PayloadSize, WithChunksIsBounded) {
  AravisSettings s;
  s.chunks = true;
  EXPECT_EQ(said({640, 480, 640 * 480}, s), "(accepted)");
  EXPECT_EQ(said({640, 480, 640 * 480 + 4096}, s), "(accepted)");
  EXPECT_THAT(said({640, 480, 640 * 480 - 1}, s), HasSubstr("the camera says 307199"));
  EXPECT_THAT(said({640, 480, 0xffffffff}, s), HasSubstr("expected 307200 … 1355776 bytes"));
}

TEST(PayloadSize, OfSeveralPartsIsBounded) {
  AravisSettings s;
  s.part = "Range";
  EXPECT_EQ(said({640, 480, 4 * 640 * 480, true}, s), "(accepted)");
  EXPECT_THAT(said({640, 480, 640 * 480 - 1, true}, s), HasSubstr("the camera says 307199"));
  EXPECT_THAT(said({640, 480, 0xffffffff, true}, s), HasSubstr("the camera says 4294967295"));
}

/// 2^31 · 2^31 pixels of several bytes overflow 64 bits.
TEST(PayloadSize, OfARegionThatNoSensorHasIsRefused) {
  EXPECT_THAT(said({0x7fffffff, 0x7fffffff, 0xffffffff}), HasSubstr("the camera says 2147483647x2147483647"));
}

TEST(PayloadSize, OfBuffersBeyondTheMemoryIsRefused) {
  AravisSettings s;
  s.part = "Range";
  s.buffers = 1'000'000;
  EXPECT_THAT(said({16384, 16384, std::uint64_t{1} << 32, true}, s),
              HasSubstr("fit in this machine's memory"));
}

}  // namespace
}  // namespace rigor
