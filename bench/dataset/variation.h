// What differs from sample to sample of a dataset, and the value that a sample gets.
//
//   simulation.weather   clear,fog           presets: world, clear, overcast, fog, rain, snow
//   Atmosphere.fog_visibility_m   50..500    an attribute of all nodes of a type, evenly between two numbers
//   Atmosphere.fog_visibility_m   log:50..500   evenly in its logarithm
//   joint.turntable      0..360              a joint of the world, degrees
//   channels.left.exposure_us   2000,4000    of a camera; also gain_db
//   channels.left.exposure_us   1000..8000:8   eight numbers from 1000 to 8000, in equal steps
//
// Draws are by counter: the value of sample k depends on the seed, the key and k alone. So other keys, and
// subsets of samples, change nothing.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/rig/weather.h"

namespace rigor::dataset {

/// What the user wrote, and where: "data.yaml:7:3: vary.simulation.weather", or "--vary".
struct Written {
  std::string text, where;
};

/// Words, or numbers between two. Numbers in steps ("1000..8000:8") are words.
class Values {
 public:
  /// bad_input. Commas within brackets do not separate words, and "../" is no range.
  [[nodiscard]] static Result<Values> parse(const Written& written);
  /// `u`, from 0 to 1, chooses.
  [[nodiscard]] std::string at(double u) const;
  [[nodiscard]] const std::vector<std::string>& words() const { return words_; }  ///< empty: a range
  [[nodiscard]] double from() const { return from_; }
  [[nodiscard]] double to() const { return to_; }
  [[nodiscard]] bool logarithmic() const { return logarithmic_; }  ///< a range, with or without steps

  static constexpr std::uint64_t kMostSteps = 1'000'000;

 private:
  [[nodiscard]] double number_at(double u) const;
  std::vector<std::string> words_;
  double from_ = 0, to_ = 0;
  bool logarithmic_ = false;
};

/// Numbers between two, evenly; "1.2" or "1..2".
struct Interval {
  double from = 0, to = 0;
  [[nodiscard]] static Result<Interval> parse(const Written& written, double min, double max);
  [[nodiscard]] double at(double u) const { return from + (to - from) * u; }
  [[nodiscard]] std::string text() const;
};

struct Variation {
  enum class Of : std::uint8_t { weather, attribute, joint, channel };
  std::string key;
  Written written;
  Of of = Of::attribute;
  std::string name, attribute;  ///< joint; channel and its key
  Values values;

  /// bad_input: a key that is none of these, values that do not fit it.
  [[nodiscard]] static Result<Variation> parse(const std::string& key, const Written& written);
};

/// weather_preset() with its values as text.
[[nodiscard]] std::vector<std::pair<std::string, std::string>> weather_texts(const std::string& preset);

/// Key and value of each variation, in their order, in sample `index`. A variation of an attribute that
/// presets of the weather set is in force only where the sample's preset has another value than `clear`: of
/// `simulation.weather=clear,fog` and `Atmosphere.fog_visibility_m=50..500` the latter says how thick the fog
/// is in samples with fog; elsewhere its value is empty.
[[nodiscard]] std::vector<std::pair<std::string, std::string>> draw_conditions(
    const std::vector<Variation>& variations, std::uint64_t seed, std::uint64_t index);

/// Four numbers from 0 to 1, ends excluded, of one element of a sample.
enum class Draw : std::uint8_t { pose, value, device, split };
[[nodiscard]] std::array<double, 4> draw(std::uint64_t seed, Draw what, std::uint64_t index,
                                         std::uint32_t element);

}  // namespace rigor::dataset
