#include "bench/version.h"

#include <fmt/format.h>
#include <rigor/hal_abi.h>
#include <rigor/world_abi.h>

#include "sensor-hal/record/recording_schema.h"

namespace rigor {

Version version() {
  return {.release = RIGOR_VERSION,
          .hal_headers = RIGOR_HAL_HEADERS_DIGEST,
          .world_headers = RIGOR_WORLD_HEADERS_DIGEST,
          .compiler = __VERSION__,
          .recording_schema = record::kRecordingSchema};
}

std::string version_text() {
  const Version v = version();
  return fmt::format(
      "rigor {}\nplugins     headers {} (Hal), {} (World); compiler {}\nrecordings  schema {}{}", v.release,
      v.hal_headers, v.world_headers, v.compiler, v.recording_schema,
      v.recording_schema > 1 ? " and older" : "");
}

}  // namespace rigor
