// The GenICam description of the emulated camera (GenApi schema 1.1, SFNC names), generated from its table of
// registers.
#pragma once

#include <string>

#include "drivers/aravis/gige_device_model.h"

namespace rigor::gige {

/// A document that GenApi and Aravis accept, padded to a multiple of four bytes. Allocates; setup context.
[[nodiscard]] std::string make_genicam_xml(const GigeCameraConfig& config, const RegisterTable& registers);

}  // namespace rigor::gige
