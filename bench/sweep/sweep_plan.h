// A sweep: many runs of one rig in virtual time, which differ by values of the rig and by its seed.
//
//   SweepOptions options;
//   options.rig = "demo.yaml";
//   options.vary.push_back(*SweepParameter::parse("channels.left.exposure_us=1000..8000:8"));
//   options.seeds = 20;
//   auto plan = SweepPlan::create(options);      // 160 runs, and digests of all files that they read
//   plan->run(17);                               // its values and its seed
//
// Run k is a function of the manifest and k. So any process that has the manifest can make it, on any machine
// that has the rig's files, and runs can be made in any order.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "bench/dataset/variation.h"
#include "rt-core/result.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

/// A key of the rig and the values that it takes, as `--vary` writes them.
struct SweepParameter {
  std::string key;
  dataset::Written written;
  dataset::Values values;
  /// Of "path.to.key=VALUES". bad_input.
  [[nodiscard]] static Result<SweepParameter> parse(const std::string& text);
  /// All values, in their order; of a range its two ends.
  [[nodiscard]] std::vector<std::string> listed() const;
};

struct SweepOptions {
  std::filesystem::path rig;
  std::vector<ConfigOverride> overrides;  ///< of the rig, in every run
  std::vector<SweepParameter> vary;
  std::uint64_t seeds = 0;      ///< runs of each combination, from the rig's own seed on; 0: one run
  std::uint64_t samples = 0;    ///< Latin hypercube samples of `vary` in place of the grid; 0: the grid
  std::uint64_t draw_seed = 1;  ///< of those samples
  double duration_s = 0;        ///< of each run; 0: what the rig says
  std::vector<std::filesystem::path> plugins;  ///< of the world

  static constexpr std::uint64_t kMostRuns = 1'000'000;
};

/// One run of a sweep.
struct SweepRun {
  std::uint64_t index = 0;
  std::vector<std::string> values;  ///< in the order of the parameters
  std::uint64_t seed = 0;
};

class SweepPlan {
 public:
  /// Reads the rig with every value that is listed, and the files that it names. Setup context. bad_input: no
  /// runs or too many, a key twice, a range without steps in a grid, a key or value that the rig refuses;
  /// not_found.
  [[nodiscard]] static Result<SweepPlan> create(const SweepOptions& options);
  /// Of a manifest that was written by the same version of Rigor. bad_input: another version, something else,
  /// or a file that is not as it was; `where` names the manifest.
  [[nodiscard]] static Result<SweepPlan> from_manifest(const nlohmann::json& manifest,
                                                       const std::string& where);

  /// Has a bench assembled with values of each parameter, the others at their first: what only a backend or
  /// an application can refuse is found before anything runs. Of a parameter with more than kChecked values
  /// its ends alone. bad_input with the value.
  [[nodiscard]] Status check(const Registry& registry) const;
  static constexpr std::size_t kChecked = 16;

  [[nodiscard]] const SweepOptions& options() const { return options_; }
  [[nodiscard]] std::uint64_t size() const { return points_ * seeds_each(); }
  [[nodiscard]] SweepRun run(std::uint64_t index) const;
  /// Options, version, and digests of the rig and of the files that it names.
  [[nodiscard]] nlohmann::json manifest() const;

  /// Words of `rigor run` that repeat a run, for a user.
  [[nodiscard]] std::vector<std::string> command(const SweepRun& run) const;
  /// The same for a process that works in a folder of its own and prints the report as JSON.
  [[nodiscard]] std::vector<std::string> child_command(const SweepRun& run) const;

 private:
  [[nodiscard]] Status count_points();
  [[nodiscard]] Status read_rig();
  void draw_samples();
  [[nodiscard]] std::uint64_t seeds_each() const { return options_.seeds == 0 ? 1 : options_.seeds; }
  [[nodiscard]] std::vector<std::string> first_values() const;
  [[nodiscard]] std::vector<ConfigOverride> overrides_of(const std::vector<std::string>& values) const;
  using Attempt = std::function<Status(const std::vector<ConfigOverride>&)>;
  /// The error of an attempt with these values, at the value that is to blame for it.
  [[nodiscard]] Error refused(const std::vector<std::string>& values, const Error& error,
                              const Attempt& attempt) const;

  SweepOptions options_;
  std::uint64_t points_ = 1, first_seed_ = 1;
  bool rig_records_ = false, analyses_ = false;
  std::vector<std::vector<std::string>> samples_;            ///< by parameter: the value of each sample
  std::vector<std::pair<std::string, std::string>> inputs_;  ///< path beside the rig, SHA-256
};

}  // namespace rigor
