#include "bench/plant/plants.h"

#include <fmt/format.h>

#include <algorithm>

#include "bench/plant/plant_source.h"
#include "sensor-hal/channel/simulated_sink.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor::plant {

Result<Plants> Plants::open(const RigConfig& rig, const std::function<bool(const std::string&)>& wanted) {
  Plants plants;
  for (const PlantEntry& entry : rig.plants) {
    if (!wanted(entry.name)) {
      plants.elsewhere_.push_back(entry.name);
      continue;
    }
    auto plant = Plant::make(entry);
    if (!plant) return tl::unexpected<Error>(plant.error());
    plants.plants_[entry.name].plant = std::move(*plant);
  }
  return plants;
}

std::shared_ptr<Plant> Plants::of(const ConfigNode& n, const char* key) {
  const std::string name = n.text(key);
  if (const auto it = plants_.find(name); it != plants_.end()) {
    it->second.used = true;
    return it->second.plant;
  }
  if (std::ranges::find(elsewhere_, name) != elsewhere_.end())
    throw n.error(key,
                  fmt::format("expected a plant that no emulator shows, got {}, which lives in the devices' "
                              "world: read and command that device",
                              name));
  std::vector<std::string> names;
  for (const auto& [known, entry] : plants_) names.push_back(known);
  throw n.error(key, fmt::format("expected one of the rig's `plants` ({}), got \"{}\"{}",
                                 joined_or_none(names), name, did_you_mean(name, names)));
}

std::vector<std::shared_ptr<Plant>> Plants::used() const {
  std::vector<std::shared_ptr<Plant>> all;
  for (const auto& [name, entry] : plants_)
    if (entry.used) all.push_back(entry.plant);
  return all;
}

std::vector<std::string> plants_of_emulators(const RigConfig& rig) {
  std::vector<std::string> names;
  for (const EmulatorEntry& e : rig.emulators)
    if (e.emulator.params.has("plant")) names.push_back(e.emulator.params.text("plant"));
  return names;
}

Backend fmu_backend(Plants& plants) {
  Backend b;
  b.name = "fmu";
  b.summary = "values of FMUs by name, as source and sink (FMI 2.0 and 3.0, co-simulation)";
  b.make_source = [&plants] { return std::make_unique<PlantSource>(plants); };
  b.make_sink = [&plants] {
    return std::make_unique<SimulatedSink>(
        [&plants](const ChannelConfig& config) -> Result<std::shared_ptr<SignalModel>> {
          return std::shared_ptr<SignalModel>(plants.of(config.params));
        });
  };
  b.same_in_virtual_time = true;
  return b;
}

}  // namespace rigor::plant
