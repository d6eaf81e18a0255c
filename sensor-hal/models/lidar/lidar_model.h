// A LiDAR as numbers: scan pattern, beam, range and remission errors.
#pragma once

namespace rigor::models {

struct LidarModel {};

}  // namespace rigor::models
