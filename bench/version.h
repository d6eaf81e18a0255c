// Which Rigor this is: the release, what its plugins must have been built against, and which recordings it
// reads. `rigor --version` prints it.
#pragma once

#include <string>

namespace rigor {

struct Version {
  std::string release;        ///< such as "0.1.0"
  std::string hal_headers;    ///< digest of the headers that drivers and applications are built against
  std::string world_headers;  ///< digest of those of plugins of the world
  std::string compiler;       ///< plugins are built with the same
  int recording_schema = 0;   ///< that is written; older ones are read (sensor-hal/record/recording_schema.h)
};

/// Any thread; allocates.
[[nodiscard]] Version version();
/// The same in lines, the first of which is "rigor RELEASE".
[[nodiscard]] std::string version_text();

}  // namespace rigor
