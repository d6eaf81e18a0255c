// The pixels of one row, from rates to digital numbers, many at a time: the arithmetic of sensor-hal/models
// over float, laid out for vector units. The result of a pixel depends on its arguments alone, not on the
// vector width.
//
// Internal to the sensor stage. All functions: any thread, no allocation.
#pragma once

#include <cstdint>

#include "sensor-hal/models/philox.h"

namespace rigor::sensor_stage {

/// What is the same for all pixels of one exposure.
struct ExposureConstants {
  models::PhiloxKey key;
  std::uint64_t capture_index = 0;
  bool shot_noise = false, read_noise = false;
  float exposure_s = 0, dark_e_per_s = 0, full_well_e = 0, read_noise_e = 0;
  float gain_dn_per_e = 0, black_dn = 0, max_dn = 0;
  float response_c2 = 0, response_c3 = 0;
};

/// What pixels next to each other in a row have of their own. Null: the same for all.
struct PixelRun {
  std::uint32_t first_element = 0;  ///< index on the full sensor
  int count = 0;
  const float* gain = nullptr;          ///< null: 1
  const float* offset_e = nullptr;      ///< null: 0
  const float* dark_e_per_s = nullptr;  ///< null: the constants'
};

/// Light of a run: mean electrons per second, in one plane, or in three for a camera that measures all
/// colours in each pixel.
struct RunRates {
  const float* plane[3] = {nullptr, nullptr, nullptr};
  int planes = 1;
};
struct RunNumbers {
  std::uint16_t* plane[3] = {nullptr, nullptr, nullptr};
};

void expose_run(const ExposureConstants& constants, const PixelRun& run, const RunRates& rates,
                const RunNumbers& numbers);

/// electrons/s of `count` pixels from their radiance (4 bands each) and two responses, of the even and of the
/// odd pixels of the run. Bands that are no number or negative count as 0, those above `max_radiance` as
/// that.
void rates_of_run(const float* radiance, int count, const float even_response[4], const float odd_response[4],
                  float max_radiance, float* rate);

/// How many of the pixels have a band that is no number or negative, and how many one above max_radiance.
struct BadRadiance {
  std::uint32_t invalid = 0, clipped = 0;
};
[[nodiscard]] BadRadiance count_bad_radiance(const float* radiance, int count, float max_radiance);

}  // namespace rigor::sensor_stage
