// The rigs, worlds and sensors that Rigor comes with, by short names: PREFIX/share/rigor/configs of the
// program that runs, or configs/ of the source tree that it was built in.
//
//   rigor run demo                            PREFIX/share/rigor/configs/demo.yaml
//   rigor run configs/rigs/can.yaml           the same, where the folder at hand has no such file
//   rigor run can                             PREFIX/share/rigor/configs/rigs/can.yaml
//
// A file that is there always comes first.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace rigor {

/// Empty where there is none.
[[nodiscard]] std::filesystem::path installed_configs();

/// The program `rigor`: this process's own, or the one that came with the library; empty where there is none.
[[nodiscard]] std::filesystem::path installed_program();

/// The clients for applications as processes (docs/application-protocol.md), beside them; empty where there
/// are none.
[[nodiscard]] std::filesystem::path installed_clients();

/// `name` itself where it exists, is absolute, empty, or nothing of that name came along.
[[nodiscard]] std::filesystem::path find_config(const std::filesystem::path& name);

struct InstalledRig {
  std::string name;   ///< as `rigor run` takes it
  std::string about;  ///< the first sentence of its comment
  std::filesystem::path file;
};
/// By name.
[[nodiscard]] std::vector<InstalledRig> installed_rigs();

}  // namespace rigor
