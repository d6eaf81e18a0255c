// The plants of a rig that somebody uses: one instance of each in a process.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "bench/plant/plant.h"
#include "sensor-hal/channel/registry.h"

namespace rigor::plant {

class Plants {
 public:
  Plants() = default;
  /// Unpacks and checks those for which `wanted` is true. bad_input with place. Setup context.
  [[nodiscard]] static Result<Plants> open(const RigConfig& rig,
                                           const std::function<bool(const std::string&)>& wanted);
  /// The one that `n` names under `key`; it is used from now on. Throws ConfigError with the names that there
  /// are.
  [[nodiscard]] std::shared_ptr<Plant> of(const ConfigNode& n, const char* key = "plant");
  /// Of all that are used.
  [[nodiscard]] std::vector<std::shared_ptr<Plant>> used() const;

 private:
  struct Entry {
    std::shared_ptr<Plant> plant;
    bool used = false;
  };
  std::map<std::string, Entry, std::less<>> plants_;
  std::vector<std::string> elsewhere_;  ///< plants of the rig that are not among these
};

/// Names of the plants that the rig's emulators show: they live in the devices' world.
[[nodiscard]] std::vector<std::string> plants_of_emulators(const RigConfig& rig);

/// Sources and sinks of named values. `plants` outlives them.
[[nodiscard]] Backend fmu_backend(Plants& plants);

}  // namespace rigor::plant
