// Random words by counter: every draw of a simulator is a pure function of (seed, channel, effect, capture
// index, element), so a result does not depend on the order or the number of threads that computed it.
//
// All functions: any thread, no allocation, no state.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>

#include "sensor-hal/models/one_source.h"

namespace rigor::models {

struct PhiloxKey {
  std::uint32_t word0 = 0;
  std::uint32_t word1 = 0;
  constexpr bool operator==(const PhiloxKey&) const = default;
};

/// What a draw is for: the second word of the counter. Numbers are part of every recording's meaning; never
/// reuse one.
enum class NoiseEffect : std::uint32_t {
  camera_shot_and_read = 1,    ///< word 0 shot, word 1 read (samples 0), words 2, 3 sample 1
  camera_shot_and_read_2 = 2,  ///< words 0, 1 sample 2 of a pixel with three samples
  camera_fixed_pattern = 3,    ///< word 0 PRNU, word 1 DSNU; capture index 0
  camera_hot_pixel = 4,        ///< word 0 whether, word 1 how hot; capture index 0
  lidar_echo = 16,             ///< element firing·2 + echo: word 0 range, word 1 remission
  lidar_drop = 17,             ///< element firing: word 0 way to the nearest drop
  tof_fixed_pattern = 61,      ///< word 0 range offset, word 1 gain; capture index 0
  tof_jitter = 62,             ///< element sample: words 0, 1 its place in its cell; capture index 0
  tof_multipath = 63,          ///< element ray: words 0, 1 its direction; capture index 0
  tof_shot = 64,               ///< to 71, one for each modulation frequency: word k tap k
  tof_read = 72,               ///< to 79, one for each modulation frequency: word k tap k
  calibration_draw = 96,       ///< element parameter: word 0 its deviation; capture index 0
  calibration_rounding = 97,   ///< element pixel, capture index picture: word 0 how it is rounded
  fault_choice = 112,          ///< of a fault's own key: element 0 whether, others by kind; word 0
  fault_value = 113,           ///< of a fault's own key: element/4 of pixels, points, bits: word element%4
  platform_slip = 112,         ///< element side, capture index half second: word 0 whether, word 1 how much
  imu_device = 128,            ///< element triad·16 + group of three: words 0 to 2; capture index 0
  imu_white = 129,             ///< element triad: words 0 to 2 the axes
  imu_instability = 130,       ///< likewise; capture index: place of the middle (markov_path.h)
  imu_walk = 131,              ///< likewise
  gnss_white = 136,            ///< words 0 to 2 east, north, up
  gnss_drift = 137,            ///< element 0 at its best, 1 degraded; capture index: place of the middle
  gnss_multipath = 138,        ///< likewise
  gnss_outage = 139,           ///< element event, capture index minute: word 0 start, 1 length, 2 depth
  gnss_loss = 140,             ///< likewise
  gnss_satellites = 141,       ///< word 0; capture index: place of the middle
  odometry_device = 144,       ///< element 0: words 0, 1 radii, 2 track; element 1: 0, 1 encoders' phases
};

[[nodiscard]] inline std::array<std::uint32_t, 4> philox(std::array<std::uint32_t, 4> counter,
                                                         PhiloxKey key) {
  std::array<std::uint32_t, 4> words{};
  PhiloxMath::philox4x32_10(counter[0], counter[1], counter[2], counter[3], key.word0, key.word1, words[0],
                            words[1], words[2], words[3]);
  return words;
}

/// The key of one channel under one seed: the first two words of philox((channel, 0, 0, 0), seed).
[[nodiscard]] inline PhiloxKey channel_key(std::uint64_t seed, std::uint32_t channel_id) {
  const auto words = philox({channel_id, 0, 0, 0}, PhiloxKey{static_cast<std::uint32_t>(seed),
                                                             static_cast<std::uint32_t>(seed >> 32)});
  return {words[0], words[1]};
}

/// A channel's number from its name (FNV-1a, 32 bit): stable over runs and over the order of channels in a
/// rig.
[[nodiscard]] constexpr std::uint32_t channel_id_from_name(std::string_view name) {
  std::uint32_t hash = 2166136261u;
  for (const char c : name) hash = (hash ^ static_cast<std::uint8_t>(c)) * 16777619u;
  return hash;
}

/// Four words for one element of one effect in one capture.
[[nodiscard]] inline std::array<std::uint32_t, 4> draw_words(PhiloxKey key, NoiseEffect effect,
                                                             std::uint64_t capture_index,
                                                             std::uint32_t element) {
  return philox({element, static_cast<std::uint32_t>(effect), static_cast<std::uint32_t>(capture_index),
                 static_cast<std::uint32_t>(capture_index >> 32)},
                key);
}

}  // namespace rigor::models
