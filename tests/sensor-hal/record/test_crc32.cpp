#include <gtest/gtest.h>

#include "sensor-hal/record/crc32.h"
#include "tests/sensor-hal/record/recording_fixture.h"

namespace rigor::record {
namespace {

TEST(Crc32, MatchesThePublishedCheckValue) {
  const std::string_view check = "123456789";
  EXPECT_EQ(crc32(std::as_bytes(std::span(check))), 0xCBF43926u);
  EXPECT_EQ(crc32({}), 0u);
}

TEST(Crc32, FastWayEqualsPortableWayAtEveryLengthAndAlignment) {
  const auto bytes = test::noise(700, 3);
  for (std::size_t start = 0; start < 17; ++start)
    for (std::size_t n = 0; start + n <= bytes.size(); ++n) {
      const Bytes part = Bytes(bytes).subspan(start, n);
      ASSERT_EQ(crc32(part, 0x1234), crc32_portable(part, 0x1234))
          << "from " << start << ", " << n << " bytes";
    }
}

TEST(Crc32, GoesOnWhereItStopped) {
  const auto bytes = test::noise(1000, 4);
  const std::uint32_t whole = crc32(bytes);
  for (const std::size_t cut : {0u, 1u, 63u, 64u, 500u, 1000u})
    EXPECT_EQ(crc32(Bytes(bytes).subspan(cut), crc32(Bytes(bytes).first(cut))), whole);
}

TEST(Crc32, CombinesTwoBlocks) {
  const auto bytes = test::noise(70'000, 5);
  const std::uint32_t whole = crc32(bytes);
  for (const std::size_t cut : {0u, 1u, 64u, 4097u, 69'999u, 70'000u})
    EXPECT_EQ(
        crc32_combine(crc32(Bytes(bytes).first(cut)), crc32(Bytes(bytes).subspan(cut)), bytes.size() - cut),
        whole);
}

}  // namespace
}  // namespace rigor::record
