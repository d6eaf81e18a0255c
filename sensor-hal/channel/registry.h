// What rigs name: backends (`backend: aravis`), applications (`application: { name: script, … }`), analyses
// of a run (`analyses: { localization: … }`) and bridges to other programs (`bridges: { ros2: … }`). Whoever
// makes a bench fills one registry; nothing registers itself behind anyone's back.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sensor-hal/channel/application.h"
#include "sensor-hal/channel/emulator.h"
#include "sensor-hal/channel/fault_spec.h"

namespace rigor {

/// One device found on this machine, for `rigor devices`.
struct FoundDevice {
  std::string backend, id, description, address;
};
/// One thing that a backend needs of the machine, for `rigor doctor`.
struct DoctorFinding {
  enum class Level : std::uint8_t { good, note, missing } level = Level::good;
  std::string what, cure;
};

/// What a backend offers; empty functions are what it does not have.
struct Backend {
  std::string name, summary;
  std::function<std::unique_ptr<Source>()> make_source;
  std::function<std::unique_ptr<Sink>()> make_sink;
  std::function<std::unique_ptr<Emulator>()> make_emulator;
  /// Virtual time: the device's model and codec in process over an in-memory transport, in place of the
  /// device. `emulator_params` are the keys of the emulator that stands for this device in the rig.
  std::function<Result<std::unique_ptr<Source>>(DeviceParts parts, ConfigNode emulator_params)>
      make_virtual_source;
  std::function<Result<std::unique_ptr<Sink>>(DeviceParts parts, ConfigNode emulator_params)>
      make_virtual_sink;
  /// There is no device to replace: `make_source` and `make_sink` serve in virtual time, too.
  bool same_in_virtual_time = false;
  /// Whether a source with these keys reads a recording of the device: then it serves in virtual time itself,
  /// and no emulator has to stand for it.
  std::function<bool(const ConfigNode& params)> reads_recording;
  /// Its sources give samples of kind pose, imu, nav_fix and odometry themselves. False: they give registers
  /// or signals of a bus, which the bench converts (sensor-hal/channel/typed_source.h).
  bool gives_typed_samples = false;
  /// The files that a source or an emulator with these keys writes; an empty function: none. May throw
  /// ConfigError.
  std::function<std::vector<std::filesystem::path>(const ConfigNode& params)> files;
  /// The signals in the frames of its bus, which faults of a channel of kind can_frame name; an empty
  /// function: it has no frames.
  FrameSignalFinder find_signal;
  std::function<std::vector<FoundDevice>()> find_devices;
  std::function<std::vector<DoctorFinding>()> doctor;
};

/// An application in this process.
struct NamedApplication {
  std::string name;
  std::function<std::unique_ptr<Application>()> make;
  /// The files that it writes with these keys, those of an earlier run in the same place included; an empty
  /// function: none. May throw ConfigError.
  std::function<std::vector<std::filesystem::path>(const ConfigNode& params)> files{};
};

/// What an analysis found.
struct AnalysisReport {
  std::string name;
  std::string line;  ///< for the terminal, one line
  std::string json;  ///< an object
  std::string html;  ///< a section of the report; empty: none
};

/// Looks at the recording of a run that has ended.
struct NamedAnalysis {
  std::string name;
  /// Setup context, before the run, whose channels and sinks are `inputs` and `outputs`: bad_input where the
  /// rig has not what it needs. May throw ConfigError.
  std::function<Status(const ConfigNode& params, const ApplicationPorts& ports)> check;
  /// Setup context, after it. None: the run gave it nothing to look at.
  std::function<Result<std::optional<AnalysisReport>>(const ConfigNode& params,
                                                      const std::filesystem::path& recording)>
      run;
};

class Bridge;
/// Connects runs with other programs (sensor-hal/channel/bridge.h).
struct NamedBridge {
  std::string name, summary;
  std::function<std::unique_ptr<Bridge>()> make;
};

class Registry {
 public:
  // A second one with the name replaces the first.
  void add(Backend backend);
  void add(NamedApplication application);
  void add(NamedAnalysis analysis);
  void add(NamedBridge bridge);
  /// nullptr when there is none.
  [[nodiscard]] const Backend* find(std::string_view name) const;
  [[nodiscard]] std::vector<std::string> names() const;
  [[nodiscard]] const std::map<std::string, Backend, std::less<>>& all() const { return backends_; }
  /// nullptr when there is none.
  [[nodiscard]] const NamedApplication* find_application(std::string_view name) const;
  [[nodiscard]] std::vector<std::string> application_names() const;
  /// nullptr when there is none.
  [[nodiscard]] const NamedAnalysis* find_analysis(std::string_view name) const;
  [[nodiscard]] std::vector<std::string> analysis_names() const;
  /// nullptr when there is none.
  [[nodiscard]] const NamedBridge* find_bridge(std::string_view name) const;
  [[nodiscard]] std::vector<std::string> bridge_names() const;

 private:
  std::map<std::string, Backend, std::less<>> backends_;
  std::map<std::string, NamedApplication, std::less<>> applications_;
  std::map<std::string, NamedAnalysis, std::less<>> analyses_;
  std::map<std::string, NamedBridge, std::less<>> bridges_;
};

}  // namespace rigor
