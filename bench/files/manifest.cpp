#include "bench/files/manifest.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <set>

#include "bench/files/file_digest.h"

namespace rigor {
namespace {

using nlohmann::json;

std::string difference_below(const json& there, const json& here, const std::string& path) {
  if (there == here) return "";
  const auto named = [&](const std::string& key) { return path.empty() ? key : path + "." + key; };
  if (there.is_object() && here.is_object()) {
    std::set<std::string> keys;
    for (const auto& [key, value] : there.items()) keys.insert(key);
    for (const auto& [key, value] : here.items()) keys.insert(key);
    for (const std::string& key : keys) {
      if (!there.contains(key) || !here.contains(key))
        return fmt::format("{} is {} there", named(key), there.contains(key) ? "only" : "not");
      if (auto d = difference_below(there[key], here[key], named(key)); !d.empty()) return d;
    }
  }
  constexpr std::size_t kShown = 80;
  return fmt::format("{} is {} there, and {} here", path, there.dump().substr(0, kShown),
                     here.dump().substr(0, kShown));
}

}  // namespace

json input_digests(const InputFiles& files, const std::filesystem::path& main) {
  const auto whole = [](const std::filesystem::path& file) {
    return std::filesystem::absolute(file).lexically_normal();
  };
  const std::filesystem::path base = whole(main).parent_path();
  json inputs = json::object();
  for (const std::string& name : files.names())
    inputs[whole(name).lexically_proximate(base).generic_string()] = sha256_of(name);
  return inputs;
}

std::string manifest_difference(const json& there, const json& here) {
  return difference_below(there, here, "");
}

}  // namespace rigor
