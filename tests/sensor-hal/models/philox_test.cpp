#include "sensor-hal/models/philox.h"

#include <gtest/gtest.h>

#include <set>

namespace rigor::models {
namespace {

// Known answers of Random123 1.14, examples/kat_vectors, "philox4x32 10".
TEST(Philox, GivesTheKnownAnswersOfRandom123) {
  using Words = std::array<std::uint32_t, 4>;
  EXPECT_EQ(philox({0, 0, 0, 0}, {0, 0}), (Words{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  EXPECT_EQ(philox({~0u, ~0u, ~0u, ~0u}, {~0u, ~0u}),
            (Words{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}),
            (Words{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(Philox, EveryPartOfTheKeyMatters) {
  const auto draw = [](std::uint64_t seed, const char* channel, NoiseEffect effect, std::uint64_t capture,
                       std::uint32_t element) {
    return draw_words(channel_key(seed, channel_id_from_name(channel)), effect, capture, element);
  };
  constexpr auto kShot = NoiseEffect::camera_shot_and_read;
  const std::set<std::array<std::uint32_t, 4>> all{draw(1, "left", kShot, 0, 0),
                                                   draw(2, "left", kShot, 0, 0),
                                                   draw(1ull << 40, "left", kShot, 0, 0),
                                                   draw(1, "right", kShot, 0, 0),
                                                   draw(1, "left", NoiseEffect::camera_fixed_pattern, 0, 0),
                                                   draw(1, "left", kShot, 1, 0),
                                                   draw(1, "left", kShot, 1ull << 32, 0),
                                                   draw(1, "left", kShot, 0, 1)};
  EXPECT_EQ(all.size(), 8u);
  EXPECT_EQ(draw(1, "left", kShot, 7, 9), draw(1, "left", kShot, 7, 9));
}

}  // namespace
}  // namespace rigor::models
