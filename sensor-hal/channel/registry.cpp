#include "sensor-hal/channel/registry.h"

#include <utility>

namespace rigor {

void Registry::add(Backend backend) {
  auto name = backend.name;
  backends_.insert_or_assign(std::move(name), std::move(backend));
}

void Registry::add(NamedApplication application) {
  auto name = application.name;
  applications_.insert_or_assign(std::move(name), std::move(application));
}

const NamedApplication* Registry::find_application(std::string_view name) const {
  const auto it = applications_.find(name);
  return it == applications_.end() ? nullptr : &it->second;
}

std::vector<std::string> Registry::application_names() const {
  std::vector<std::string> names;
  for (const auto& [name, application] : applications_) names.push_back(name);
  return names;
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
