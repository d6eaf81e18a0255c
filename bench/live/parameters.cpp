#include "bench/live/parameters.h"

#include <nlohmann/json.hpp>

#include "sensor-hal/channel/pair_source.h"

namespace rigor::live {
namespace {

using nlohmann::json;

std::string name_of_parameter(const RunChannel& channel) { return "/" + channel.entry->name + "/active"; }

}  // namespace

void serve_parameters(Hub& hub, RunParts& parts) {
  hub.serve_parameters(
      [&parts] {
        json all = json::array();
        for (const auto& c : parts.channels)
          if (c->pair)
            all.push_back({{"name", name_of_parameter(*c)}, {"value", name_of(c->pair->active())}});
        return all;
      },
      [&parts](const std::string& name, const json& value) {
        for (const auto& c : parts.channels) {
          if (!c->pair || name != name_of_parameter(*c)) continue;
          if (value == "real") return c->pair->switch_to(PairSide::real), true;
          if (value == "simulated") return c->pair->switch_to(PairSide::simulated), true;
        }
        return false;
      });
}

}  // namespace rigor::live
