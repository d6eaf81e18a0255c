#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/files/output_file.h"
#include "bench/tune/engine_choices.h"
#include "bench/tune/tuner.h"
#include "cli/commands.h"
#include "cli/overrides.h"

namespace rigor {
namespace {

nlohmann::json json_of(const Trial& t, bool image) {
  nlohmann::json j{{"choice", t.choice.text()}, {"renderer", t.choice.engine},
                   {"p50_ms", t.p50_ms},        {"max_ms", t.max_ms},
                   {"timed", t.timed},          {"meets", t.meets}};
  if (image) {
    j["radiance"] = t.radiance;
  } else {
    j["range_rmse_m"] = t.range_rmse_m;
    j["outliers"] = t.outliers;
  }
  return j;
}

std::string error_of(const Trial& t, bool image) {
  if (image) return fmt::format("radiance {:6.2f} %", t.radiance * 100);
  return fmt::format("range {:8.2f} mm, {:6.2f} % outliers", t.range_rmse_m * 1e3, t.outliers * 100);
}

}  // namespace

int tune_command(const TuneOptions& options) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return report_error(overrides.error(), options.json);
  auto rig = load_rig(options.rig, *overrides);
  if (!rig) return report_error(rig.error(), options.json);
  std::vector<std::pair<const ChannelEntry*, Tolerance>> wanted;
  for (const ChannelEntry& entry : rig->channels) {
    const ConfigNode* params = simulated_params(entry);
    if (!params) continue;
    const auto tolerance = catch_config([&] { return read_tolerance(*params, entry.kind); });
    if (!tolerance) return report_error(tolerance.error(), options.json);
    if (*tolerance && !params->has("renderer")) wanted.emplace_back(&entry, **tolerance);
  }
  if (wanted.empty())
    return report_error(
        {ErrorCode::bad_input, options.rig.string(),
         "expected a simulated channel with a `tolerance` and without a `renderer`, found none: "
         "there is nothing to tune"},
        options.json);
  if (rig->simulation.world.empty())
    return report_error(
        {ErrorCode::bad_input, options.rig.string(), "expected `simulation.world`, found none"},
        options.json);
  const auto file = lock_path(rig->file);
  InputFiles inputs;
  inputs.add_rig(*rig);
  Outputs outputs(std::move(inputs));
  const Existing existing = options.force ? Existing::replace : Existing::keep;
  if (auto s = outputs.add(file, "RIG, which names it", existing); !s)
    return report_error(s.error(), options.json);
  auto simulation = Simulation::open(rig->simulation);
  if (!simulation) return report_error(simulation.error(), options.json);

  LockFile lock;
  lock.cpu = cpu_name();
  const std::string world = world_digest((*simulation)->world().snapshot());
  nlohmann::json told{{"rig", options.rig.string()}, {"channels", nlohmann::json::array()}};
  std::string text;
  int status = 0;
  std::optional<ProgressTask> progress(std::in_place, "tune");
  for (const auto& [entry, tolerance] : wanted) {
    const bool image = entry->kind == SampleKind::image;
    auto tuned = tune_channel(**simulation, *rig, *entry, tolerance,
                              [&](const std::string& what) { progress->note(what); });
    if (!tuned) return report_error(tuned.error(), options.json);
    nlohmann::json channel{{"name", entry->name}, {"trials", nlohmann::json::array()}};
    text += entry->name + '\n';
    for (const Trial& t : tuned->trials) {
      channel["trials"].push_back(json_of(t, image));
      text += fmt::format("  {} p50 {:8.2f} ms  max of {:2} {:8.2f} ms  {}  {}\n",
                          &t == tuned->best() ? "→"
                          : t.meets           ? " "
                                              : "×",
                          t.p50_ms, t.timed, t.max_ms, error_of(t, image), t.choice.text());
    }
    if (const Trial* best = tuned->best()) {
      const auto digest = channel_digest(world, *simulated_params(*entry));
      if (!digest) return report_error(digest.error(), options.json);
      lock.channels[entry->name] = {best->choice,   best->p50_ms,   best->max_ms, best->range_rmse_m,
                                    best->outliers, best->radiance, *digest};
      channel["chosen"] = json_of(*best, image);
    } else {
      status = 1;
    }
    told["channels"].push_back(std::move(channel));
  }
  progress.reset();
  lock.gpu = (*simulation)->engine();
  told["lock"] = status == 0 ? file.string() : "";
  if (status == 0) {
    if (existing == Existing::keep)
      if (const auto kept = keep_earlier(file); !kept) return report_error(kept.error(), options.json);
    if (auto s = save_lock(file, lock); !s) return report_error(s.error(), options.json);
  }
  if (options.json)
    fmt::print("{}\n", told.dump());
  else
    fmt::print("{}{}\n", text,
               status == 0
                   ? file.string()
                   : "nothing was written: no engine meets the tolerance of every channel (×: does not)");
  return status;
}

}  // namespace rigor
