#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <nlohmann/json.hpp>
#include <thread>

#include "bench/console/terminal.h"
#include "bench/devices/device_world.h"
#include "builtin/registry.h"
#include "cli/commands.h"
#include "cli/overrides.h"
#include "rt-core/executive.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/plugin/plugin.h"

namespace rigor {
namespace {

Result<RigConfig> load(const EmulateOptions& options) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return tl::unexpected<Error>(overrides.error());
  auto rig = load_rig(options.rig, *overrides);
  if (!rig) return rig;
  if (rig->emulators.empty())
    return fail(ErrorCode::bad_input, options.rig.string(),
                "expected a section `emulators`, found none: nothing to emulate");
  for (const std::string& name : options.only)
    if (!rig->emulator(name)) {
      std::vector<std::string> names;
      for (const auto& e : rig->emulators) names.push_back(e.name);
      return fail(ErrorCode::bad_input, "--only",
                  fmt::format("expected one of the rig's emulators {}, got \"{}\"{}", fmt::join(names, ", "),
                              name, did_you_mean(name, names)));
    }
  return rig;
}

}  // namespace

int emulate_command(const EmulateOptions& options) {
  auto rig = load(options);
  if (!rig) return report_error(rig.error(), options.json);
  Registry registry = make_registry();
  if (auto s = load_plugins(rig->plugins, registry); !s) return report_error(s.error(), options.json);
  StopSource stop;
  SignalStop signals(stop);

  auto world = DeviceWorld::open(*rig);
  if (!world) return report_error(world.error(), options.json);
  std::vector<std::unique_ptr<Emulator>> running;
  nlohmann::json endpoints = nlohmann::json::array();
  for (const EmulatorEntry& entry : rig->emulators) {
    if (!options.only.empty() &&
        std::find(options.only.begin(), options.only.end(), entry.name) == options.only.end())
      continue;
    auto emulator = (*world)->start_emulator(entry, registry, bench_now());
    if (!emulator) return report_error(emulator.error(), options.json);
    endpoints.push_back({{"name", entry.name}, {"endpoint", (*emulator)->endpoint()}});
    if (!options.json && options.ready_fd < 0) fmt::print("{:<16} {}\n", entry.name, (*emulator)->endpoint());
    running.push_back(std::move(*emulator));
  }
  if (options.json) fmt::print("{}\n", nlohmann::json{{"emulators", endpoints}}.dump(2));
  std::fflush(stdout);
  if (options.ready_fd >= 0) {
    const std::string ready = "ready\n";
    if (write(options.ready_fd, ready.data(), ready.size()) < 0) return 1;
    close(options.ready_fd);
  } else if (!options.json) {
    fmt::print("running until Ctrl-C\n");
    std::fflush(stdout);
  }
  while (!stop.token().stop_requested()) std::this_thread::sleep_for(std::chrono::milliseconds(50));
  int status = 0;
  for (auto& emulator : running)
    if (auto s = emulator->stop(); !s) status = report_error(s.error(), options.json);
  return status;
}

}  // namespace rigor
