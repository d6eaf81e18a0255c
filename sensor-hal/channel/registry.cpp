#include "sensor-hal/channel/registry.h"

#include <utility>

namespace rigor {

void Registry::add(Backend backend) {
  auto name = backend.name;
  backends_.insert_or_assign(std::move(name), std::move(backend));
}

const Backend* Registry::find(std::string_view name) const {
  const auto it = backends_.find(name);
  return it == backends_.end() ? nullptr : &it->second;
}

std::vector<std::string> Registry::names() const {
  std::vector<std::string> names;
  names.reserve(backends_.size());
  for (const auto& [name, backend] : backends_) names.push_back(name);
  return names;
}

}  // namespace rigor
