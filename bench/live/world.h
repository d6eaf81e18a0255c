// The run's world for the live view: seen from above, picked, read, changed.
//
// Services are answered on the thread for services; they wait for sensors that are measuring. What moves is
// told by the loop (LiveTap::motion); a pick means the newest of these instants.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "bench/live/world_shapes.h"
#include "bench/run/bench_run.h"
#include "bench/run/tap.h"
#include "bench/sensing/mount.h"
#include "bench/sensing/simulation.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::live {

class LiveWorld {
 public:
  static constexpr std::size_t kMostObjects = 20'000;
  static constexpr int kMostGround_px = 1024;

  /// Setup context, after the channels are armed. All outlive it.
  LiveWorld(Simulation& simulation, const RunParts& parts, LiveTap& tap);

  /// The message of /rigor/world. Server's thread.
  [[nodiscard]] nlohmann::json moving() const;
  /// Changes whenever `moving` would say something else.
  [[nodiscard]] std::string moving_key() const;

  // One thread at a time. bad_input, not_found.
  [[nodiscard]] Result<nlohmann::json> map(const nlohmann::json& request) const;
  [[nodiscard]] Result<nlohmann::json> pick(const nlohmann::json& request) const;
  [[nodiscard]] Result<nlohmann::json> node(const nlohmann::json& request) const;
  [[nodiscard]] Result<nlohmann::json> set(const nlohmann::json& request);

 private:
  struct Sensor {
    std::string channel;
    Mount mount;
    bool optical = true;                ///< looks along z; else along x
    std::optional<CameraModel> camera;  ///< of image channels
  };
  [[nodiscard]] world::Pose T_world_sensor(const Sensor& sensor, const LiveTap::MotionAt& at,
                                           const world::Snapshot& world) const;
  [[nodiscard]] nlohmann::json ground_picture(const std::array<double, 4>& area, int size_px,
                                              const GroundHeight& ground) const;
  [[nodiscard]] nlohmann::json shape_json(const world::Snapshot& world, const Shape& shape) const;
  [[nodiscard]] Result<Hit> pick_in_picture(const nlohmann::json& request, const world::Snapshot& world,
                                            const GroundHeight& ground) const;

  Simulation& simulation_;
  LiveTap& tap_;
  std::vector<Sensor> sensors_;
  std::vector<std::pair<std::string, world::NodeId>> platforms_;
  std::set<world::NodeId> platform_nodes_;
  std::vector<std::string> joints_;
};

/// `answer` as a service has it: {"ok": true, "result": …} or {"ok": false, "error": …}. It throws nothing.
[[nodiscard]] std::string service_answer(
    const std::string& request, const std::function<Result<nlohmann::json>(const nlohmann::json&)>& answer);

}  // namespace rigor::live
