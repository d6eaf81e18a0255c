#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/run/machine_probe.h"
#include "bench/sensing/simulation.h"
#include "builtin/registry.h"
#include "cli/commands.h"
#include "rt-core/realtime_setup.h"

namespace rigor {

int doctor_command(const DeviceOptions& options) {
  const auto registry = make_registry(options.plugins);
  if (!registry) return report_error(registry.error(), options.json);
  struct Line {
    std::string part;
    DoctorFinding finding;
  };
  std::vector<Line> lines;
  for (const RealtimeSetting& s : probe_realtime())
    lines.push_back({"real time",
                     {s.granted  ? DoctorFinding::Level::good
                      : s.wanted ? DoctorFinding::Level::missing
                                 : DoctorFinding::Level::note,
                      s.name + ": " + s.text, ""}});
  for (auto& f : examine_machine(this_machine())) lines.push_back({"machine", std::move(f)});
  for (auto& f : Simulation::doctor()) lines.push_back({"simulation", std::move(f)});
  for (const auto& [name, backend] : registry->all())
    if (backend.doctor)
      for (auto& f : backend.doctor()) lines.push_back({name, std::move(f)});

  static constexpr const char* kMark[] = {"good", "note", "MISSING"};
  nlohmann::json list = nlohmann::json::array();
  for (const Line& l : lines) {
    const char* mark = kMark[static_cast<int>(l.finding.level)];
    list.push_back({{"part", l.part}, {"level", mark}, {"what", l.finding.what}, {"cure", l.finding.cure}});
    if (options.json) continue;
    fmt::print("{:<8} {:<11} {}\n", mark, l.part, l.finding.what);
    if (!l.finding.cure.empty()) fmt::print("{:<20} mend it: {}\n", "", l.finding.cure);
  }
  if (options.json) fmt::print("{}\n", json_text(nlohmann::json{{"findings", list}}));
  return 0;
}

}  // namespace rigor
