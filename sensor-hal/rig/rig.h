// A rig: the whole bench in one file. What it says in common for all channels is parsed here into plain
// structs; what only a backend understands stays in the channel's ConfigNode and is parsed by the backend,
// from the same map.
//
//   name: demo
//   loop: { rate_hz: 1000, spin_us: 100, overrun: skip }
//   channels:
//     right: { kind: image, backend: simulated, rate_hz: 25, latency_ms: 60, … }
//     left:
//       kind: image
//       rate_hz: 25
//       latency_ms: 60
//       pair: { active: real, real: { backend: aravis, … }, simulated: { backend: simulated, … } }
//   sinks:
//     table: { backend: modbus, latency_ms: 10, safe: {…}, … }
//   emulators:
//     left: { backend: aravis, … }
//   plants:
//     ball: { fmu: BouncingBall.fmu, … }
//   application: { name: turntable-sweep, … }
//   plugins: [build/libmydriver.so]
//   analyses: { localization: { truth: truth, estimate: estimate } }
//   bridges: { ros2: { domain: 0, … } }
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rt-core/period.h"
#include "rt-core/port.h"
#include "rt-core/result.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/config/named_file.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/types/point_layout.h"

namespace rigor {

enum class ClockKind : std::uint8_t { wall, virtual_time };
enum class OverrunChoice : std::uint8_t { skip, abort, log };

struct LoopConfig {
  Period period = milliseconds(1);
  Duration spin;  ///< busy-wait over the last part of each period; 0: plain sleep
  OverrunChoice overrun = OverrunChoice::skip;
  int fifo_priority = 80;  ///< 0: ordinary scheduling
  int cpu = -1;            ///< -1: the last one of the machine
  bool lock_memory = true;
  bool dma_latency = true;  ///< hold /dev/cpu_dma_latency at 0
  Duration heartbeat_deadline = milliseconds(100);
};

/// One side of a channel: which backend, and its own keys.
struct BackendChoice {
  std::string backend;
  std::string emulated_by;  ///< which entry of `emulators` stands for the device in virtual time
  ConfigNode params;
};

/// `pair: { switches: [ { at_s: 5, active: simulated } ] }`
struct PairSwitch {
  Duration after_start;
  bool to_real = true;
};

/// `pair: { watch: { window_s: 10, baseline_windows: 200, false_alarms_per_h: 0.001 } }`
/// (docs/pair-watch.md)
struct PairWatchConfig {
  double window_s = 10;
  std::uint32_t baseline_windows = 200;
  double false_alarms_per_h = 1e-3;
};

struct ChannelEntry {
  std::string name;
  SampleKind kind = SampleKind::none;
  Period period;  ///< 0: aperiodic; captures need not lie on the loop's grid
  Duration latency;
  PortTiming timing;
  bool record = true;
  PointLayout points = PointLayout::rigor;  ///< of a cloud, in recordings and in the live view
  ConfigNode laser_scan;  ///< of a 2D scanner whose rays no sensor model tells; absent: none
  bool is_pair = false;
  std::vector<PairSwitch> switches;      ///< in order of time
  std::optional<PairWatchConfig> watch;  ///< of a pair: whether it is looked at for changes
  BackendChoice source;                  ///< the channel itself, or the real side of a pair
  BackendChoice simulated;               ///< the simulated side of a pair
  ConfigNode pair;                       ///< keys of the pair itself
  ConfigNode node;
};

struct SinkEntry {
  std::string name;
  Duration latency;
  BackendChoice sink;
  ConfigNode node;
};

struct EmulatorEntry {
  std::string name;
  BackendChoice emulator;
  ConfigNode node;
};

/// `plants: { ball: { fmu: BouncingBall.fmu, … } }`: simulated devices that are FMUs (docs/plants.md).
struct PlantEntry {
  std::string name;
  ConfigNode node;
};

struct RecordConfig {
  std::filesystem::path file;  ///< empty: no recording
  std::string compression = "zstd";
  std::size_t chunk_bytes = 4u << 20;
  std::size_t budget_bytes = 256u << 20;
  bool fail_on_drop = false;
};

/// Which channel tells the bench where a joint of the world stands.
struct JointBinding {
  std::string joint, channel, position_name, rate_name;  ///< rate_name may be empty: rate 0
  double scale_rad = 1;                                  ///< radians per unit of the register
};

/// `simulation: { platforms: { robot: { kind: skid-steer, model: …, T_world_start: {…} } } }`: what carries
/// sensors through the world.
struct PlatformEntry {
  std::string name, model;
  std::string channel;  ///< which channel tells the bench where it is; empty: the bench computes it
  ConfigNode node;      ///< the model's own keys
};

struct SimulationConfig {
  std::filesystem::path world;     ///< empty: the rig has no world
  std::vector<NamedFile> plugins;  ///< of the world (docs/world-plugins.md)
  int workers = 1;
  std::string device;  ///< Vulkan device by name; empty: the first
  std::vector<JointBinding> joints;
  std::vector<PlatformEntry> platforms;
  std::uint64_t seed = 1;  ///< of the rig, for what platforms draw
  /// Attributes of the world's Atmosphere in place of its own, by their names.
  std::vector<std::pair<std::string, double>> weather;
};

/// `frames: { root: world, rate_hz: 100, mounts: { lidar: { parent: robot, position_m: … } }, stereo: [ … ]
/// }`: what `/tf_static`, `/tf` and `/clock` tell (docs/recording.md#frames).
struct FramesConfig {
  bool publish = true;
  std::string root = "world";
  Period period = milliseconds(10);  ///< of `/tf` and `/clock`
  /// Where sensors sit whose channels do not say so, by the frame of their headers.
  struct Mount {
    std::string frame, parent;
    ConfigNode node;  ///< the pose's own keys
  };
  std::vector<Mount> mounts;
  /// Channels of image kind whose CameraInfo is that of a rectified pair.
  struct Stereo {
    std::string left, right;
    ConfigNode node;
  };
  std::vector<Stereo> stereo;
};

/// `analyses: { localization: { … } }`: what looks at the recording of the run when it has ended.
struct AnalysisChoice {
  std::string name;
  ConfigNode params;
};

/// `bridges: { ros2: { … } }`: which programs outside the rig follow a run and command it.
struct BridgeEntry {
  std::string name;
  ConfigNode node;
};

struct RigConfig {
  std::string name;
  std::filesystem::path file;
  std::vector<std::string> overrides;  ///< of the file: "channels.left.rate_hz=10"
  std::string text;                    ///< the file as parsed, overrides included, for the recording
  std::uint64_t seed = 1;
  ClockKind clock = ClockKind::wall;
  Duration duration;            ///< 0: until stopped
  bool start_emulators = true;  ///< `rigor run` brings the emulators up in a process of their own
  LoopConfig loop;
  SimulationConfig simulation;
  std::vector<NamedFile> plugins;  ///< shared objects with drivers and applications (docs/sdk.md)
  std::vector<ChannelEntry> channels;
  std::vector<SinkEntry> sinks;
  std::vector<EmulatorEntry> emulators;
  std::vector<PlantEntry> plants;
  std::string application;  ///< its name, the file of its library, or the words of its command; empty: none
  ConfigNode application_params;
  std::vector<ConfigNode> expect;  ///< entries, which bench/expect reads
  std::vector<AnalysisChoice> analyses;
  std::vector<BridgeEntry> bridges;
  FramesConfig frames;
  RecordConfig record;
  std::filesystem::path report;  ///< directory; empty: none

  [[nodiscard]] const EmulatorEntry* emulator(std::string_view emulator_name) const;
};

/// Reads and checks a rig file. Relative paths of inputs are meant against the file's directory, of outputs
/// against the working directory. bad_input with place, or not_found. Setup context.
[[nodiscard]] Result<RigConfig> load_rig(const std::filesystem::path& file,
                                         const std::vector<ConfigOverride>& overrides = {});
[[nodiscard]] Result<RigConfig> parse_rig(ConfigNode root, const std::filesystem::path& file);

[[nodiscard]] std::string_view kind_name(SampleKind kind);

}  // namespace rigor
