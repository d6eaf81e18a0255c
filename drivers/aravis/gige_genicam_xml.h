// The GenICam description (GenApi schema 1.1, SFNC names) of the emulated camera: what a client reads first,
// and what tells it which register is which feature.
#pragma once

#include <string>

#include "drivers/aravis/gige_device_model.h"

namespace rigor::gige {

/// The XML for this camera's ranges and formats. Its length is a multiple of 4, as READMEM needs. Setup
/// context.
[[nodiscard]] std::string make_genicam_xml(const GigeCameraConfig& config);

}  // namespace rigor::gige
