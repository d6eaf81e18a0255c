// Files that a configuration names, each with the place that names it, for messages.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "sensor-hal/config/yaml.h"

namespace rigor {

struct NamedFile {
  std::filesystem::path file;
  std::string named_by;  ///< "rig.yaml:12:14", "--plugin"
};

/// `key: [a.so, b.so]`, relative to the folder of the configuration; empty where the key is absent. Throws
/// ConfigError.
inline std::vector<NamedFile> named_files(const ConfigNode& node, std::string_view key) {
  std::vector<NamedFile> files;
  for (const ConfigNode& n : node.list_or_empty(key)) {
    const std::string name = n.as_text();
    if (name.empty()) throw n.error("", "expected the name of a file, got none");
    files.push_back({node.base_dir() / name, n.place()});
  }
  return files;
}

}  // namespace rigor
