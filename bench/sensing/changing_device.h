// A simulated device that becomes another one while a run goes on: to see what notices it.
//
//   sensor: camera.yaml
//   T_world_sensor: { … }
//   model_schedule:                           # each with all keys that it needs of the sensor's own
//     - { from_s: 600, sensor: camera-longer.yaml, T_world_sensor: { … } }
//
// Samples that are captured from_s or later after the start are measured by that one.
#pragma once

#include <functional>
#include <memory>

#include "sensor-hal/channel/providers.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

/// Makes the device that the keys of `params` describe, or one that changes. Throws ConfigError.
[[nodiscard]] Result<std::shared_ptr<ImageProvider>> changing_camera(
    const ConfigNode& params,
    const std::function<Result<std::shared_ptr<ImageProvider>>(const ConfigNode&)>& make);
[[nodiscard]] Result<std::shared_ptr<SampleProvider>> changing_sampler(
    const ConfigNode& params,
    const std::function<Result<std::shared_ptr<SampleProvider>>(const ConfigNode&)>& make);

}  // namespace rigor
