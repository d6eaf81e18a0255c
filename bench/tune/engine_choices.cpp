#include "bench/tune/engine_choices.h"

#include <fmt/format.h>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/tune/tuner.h"

namespace rigor {
namespace {

/// The tolerance of a channel that names no engine.
std::optional<Tolerance> to_be_tuned(const ChannelEntry& entry) {
  const ConfigNode* params = simulated_params(entry);
  if (!params || params->has("renderer")) return std::nullopt;
  return read_tolerance(*params, entry.kind);
}

/// What the lock says of a channel; empty: nothing. Refused where it was made for something else.
Result<std::optional<EngineChoice>> locked(const std::optional<LockFile>& lock, const RigConfig& rig,
                                           const ChannelEntry& entry, const std::string& world) {
  if (!lock || !lock->channels.contains(entry.name)) return std::optional<EngineChoice>{};
  const LockedChannel& c = lock->channels.at(entry.name);
  const auto digest = channel_digest(world, *simulated_params(entry));
  if (!digest) return tl::unexpected<Error>(digest.error());
  if (*digest != c.digest)
    return fail(ErrorCode::bad_input, lock_path(rig.file).string(),
                fmt::format("expected a lock of this world, rig and sensor, got an older one: channel {} was "
                            "tuned for something else. Type `rigor tune {}`",
                            entry.name, rig.file.string()));
  return std::optional<EngineChoice>(c.choice);
}

}  // namespace

Result<EngineChoices> choose_engines(const RigConfig& rig, Simulation& simulation) {
  EngineChoices choices;
  std::optional<std::optional<LockFile>> lock;
  std::string world;
  for (const ChannelEntry& entry : rig.channels) {
    const auto tolerance = catch_config([&] { return to_be_tuned(entry); });
    if (!tolerance) return tl::unexpected<Error>(tolerance.error());
    if (!*tolerance) continue;
    if (!lock) {
      auto loaded = load_lock(lock_path(rig.file));
      if (!loaded) return tl::unexpected<Error>(loaded.error());
      lock = std::move(*loaded);
      world = world_digest(simulation.world().snapshot());
    }
    auto choice = locked(*lock, rig, entry, world);
    if (!choice) return tl::unexpected<Error>(choice.error());
    if (*choice) {
      choices[entry.name] = **choice;
      continue;
    }
    if (rig.clock == ClockKind::virtual_time)
      return tl::unexpected<Error>(
          entry.node
              .error("",
                     fmt::format("expected, for a channel with a `tolerance` in virtual time, a `renderer` "
                                 "or {}, found neither. Type `rigor tune {}`",
                                 lock_path(rig.file).filename().string(), rig.file.string()))
              .error());
    std::optional<ProgressTask> progress(std::in_place, "tune");
    auto tuned = tune_channel(simulation, rig, entry, **tolerance,
                              [&](const std::string& what) { progress->note(what); });
    progress.reset();
    if (!tuned) return tl::unexpected<Error>(tuned.error());
    if (!tuned->best())
      return fail(
          ErrorCode::bad_input, entry.node.place(),
          fmt::format("{}: no engine meets its tolerance here; `rigor tune {}` says how near they come",
                      entry.name, rig.file.string()));
    choices[entry.name] = tuned->best()->choice;
  }
  return choices;
}

Result<std::optional<EngineChoice>> sense_choice(const RigConfig& rig, const ChannelEntry& entry,
                                                 Simulation& simulation, const std::string& engine) {
  const ConfigNode& params = *simulated_params(entry);
  const auto read = catch_config([&] { return read_engine_choice(params, entry.kind); });
  if (!read) return tl::unexpected<Error>(read.error());
  if (!engine.empty()) {
    EngineChoice c = *read;
    if (c.engine != engine) {
      c = {};
      c.engine = engine;
    }
    return std::optional<EngineChoice>(c);
  }
  const auto tolerance = catch_config([&] { return to_be_tuned(entry); });
  if (!tolerance) return tl::unexpected<Error>(tolerance.error());
  if (!*tolerance) return std::optional<EngineChoice>{};
  const auto lock = load_lock(lock_path(rig.file));
  if (!lock) return tl::unexpected<Error>(lock.error());
  auto choice = locked(*lock, rig, entry, *lock ? world_digest(simulation.world().snapshot()) : "");
  if (!choice || *choice) return choice;
  EngineChoice exact;
  exact.engine = "rays";
  return std::optional<EngineChoice>(exact);
}

}  // namespace rigor
