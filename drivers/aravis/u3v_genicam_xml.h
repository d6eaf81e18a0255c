// The GenICam description (GenApi schema 1.1, SFNC names) of the emulated USB3 Vision camera: what tells a
// client which register is which feature.
#pragma once

#include <string>

#include "drivers/aravis/gige_device_model.h"

namespace rigor::u3v {

/// The XML for this camera's ranges and formats. Setup context.
[[nodiscard]] std::string make_genicam_xml(const gige::GigeCameraConfig& config);

}  // namespace rigor::u3v
