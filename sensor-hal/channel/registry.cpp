#include "sensor-hal/channel/registry.h"

#include <utility>

namespace rigor {
namespace {

template <class Map, class Named>
void put(Map& map, Named named) {
  auto name = named.name;
  map.insert_or_assign(std::move(name), std::move(named));
}

template <class Map>
const typename Map::mapped_type* find_in(const Map& map, std::string_view name) {
  const auto it = map.find(name);
  return it == map.end() ? nullptr : &it->second;
}

template <class Map>
std::vector<std::string> names_of(const Map& map) {
  std::vector<std::string> names;
  names.reserve(map.size());
  for (const auto& [name, named] : map) names.push_back(name);
  return names;
}

}  // namespace

void Registry::add(Backend backend) { put(backends_, std::move(backend)); }
void Registry::add(NamedApplication application) { put(applications_, std::move(application)); }
void Registry::add(NamedAnalysis analysis) { put(analyses_, std::move(analysis)); }
void Registry::add(NamedBridge bridge) { put(bridges_, std::move(bridge)); }

const Backend* Registry::find(std::string_view name) const { return find_in(backends_, name); }
const NamedApplication* Registry::find_application(std::string_view name) const {
  return find_in(applications_, name);
}
const NamedAnalysis* Registry::find_analysis(std::string_view name) const { return find_in(analyses_, name); }

std::vector<std::string> Registry::names() const { return names_of(backends_); }
std::vector<std::string> Registry::application_names() const { return names_of(applications_); }
std::vector<std::string> Registry::analysis_names() const { return names_of(analyses_); }

const NamedBridge* Registry::find_bridge(std::string_view name) const { return find_in(bridges_, name); }
std::vector<std::string> Registry::bridge_names() const { return names_of(bridges_); }

}  // namespace rigor
