// The commands of `rigor`, each with the options that main.cpp parsed for it. Each returns the exit status:
// 0 good, 1 ran and failed, 2 bad input and nothing touched.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace rigor {

/// `--live` and what belongs to it (docs/live.md).
struct LiveOptions {
  bool on = false;
  std::string endpoint;  ///< [ADDRESS:]PORT; empty: 127.0.0.1:8765
  std::string token;     ///< empty: RIGOR_LIVE_TOKEN, or one that is made and printed
  bool open = false;     ///< no token is asked for
  std::filesystem::path page;
  bool ends = false;  ///< replays: the page ends with the replay, in place of staying until Ctrl-C
  /// Virtual time: at most so many seconds of it in a second; 0: as fast as it goes. None: as a clock where
  /// somebody looks on, else as fast as it goes.
  std::optional<double> pace;
  [[nodiscard]] double pace_or_default() const { return pace.value_or(on ? 1 : 0); }
};
struct RunOptions {
  std::filesystem::path rig;
  std::vector<std::string> overrides;  ///< --set
  std::string clock;                   ///< "", "wall", "virtual"
  std::optional<double> duration_s;
  int workers = 0;  ///< threads for simulators; 0: what the rig says
  std::filesystem::path record, report, trace;
  std::filesystem::path junit;        ///< what the rig expects, as JUnit's XML; empty: none
  std::filesystem::path faults_from;  ///< a recording whose live faults come again; empty: none
  bool no_emulators = false;
  bool digest = false;  ///< also of a run by the clock that is not recorded
  bool no_control = false;
  bool force = false;                ///< replace what is there
  std::vector<std::string> fail_on;  ///< findings that fail the run (verdict.h)
  LiveOptions live;
  bool json = false;
};
struct ReplayOptions {
  std::filesystem::path recording, rig;
  std::vector<std::string> overrides;
  std::filesystem::path record, report, junit;
  std::vector<std::string> fail_on;
  LiveOptions live;
  bool run_program = false;  ///< the application that the recording names may be started or loaded
  bool force = false;        ///< replace what is there
  bool json = false;
};
struct CheckOptions {
  std::filesystem::path recording, rig;  ///< rig: whose `expect` is taken; empty: the recorded one
  std::vector<std::string> overrides;
  std::filesystem::path junit;
  bool data = false;   ///< by its data alone, whatever the rig expects
  bool force = false;  ///< replace what is there
  bool json = false;
};
struct EmulateOptions {
  std::filesystem::path rig;
  std::vector<std::string> overrides;
  std::vector<std::string> only;  ///< names; empty: all
  int ready_fd = -1;              ///< where "ready\n" goes once every device is up; internal
  bool json = false;
};
struct SenseOptions {
  std::filesystem::path rig;
  std::vector<std::string> overrides;
  std::string channel;
  double at_s = 0;
  std::vector<std::string> joints;  ///< NAME=DEGREES
  std::filesystem::path output;
  std::filesystem::path truth;  ///< .exr; empty: none
  bool ideal = false;
  std::vector<std::string> only;  ///< effects
  bool difference = false;        ///< of a range image to the same without effects
  std::string engine;             ///< "", "rays", "raster"
  bool force = false;             ///< replace what is there
  bool json = false;
};
struct TuneOptions {
  std::filesystem::path rig;
  std::vector<std::string> overrides;
  bool force = false;  ///< replace what is there
  bool json = false;
};
struct InspectOptions {
  std::filesystem::path file;
  std::filesystem::path metadata;  ///< of an Ouster
  bool repair = false;
  std::filesystem::path output;  ///< of the repair
  bool force = false;            ///< replace what is there
  bool json = false;
};
struct LocalizationOptions {
  std::filesystem::path recording;
  std::string truth = "truth", estimate = "estimate";  ///< a channel, a sink
  double after_s = 1;
  std::filesystem::path map;     ///< stems to draw; empty: none
  std::filesystem::path report;  ///< empty: none
  bool force = false;            ///< replace what is there
  bool json = false;
};
struct WorldRenderOptions {
  std::filesystem::path world;
  std::filesystem::path output;     ///< .png or .exr
  std::vector<double> eye, target;  ///< world frame, metres; empty: an overview
  bool above_ground = false;        ///< z of eye and target counts from the ground below them
  int width_px = 1280, height_px = 720;
  double fov_deg = 60;                   ///< horizontal
  std::string time;                      ///< 2024-06-21T12:00:00Z; empty: the world's
  std::vector<std::string> assignments;  ///< --set Type.attribute=value
  std::string bands = "rgb";             ///< rgb | nir | false-colour
  std::optional<double> white_radiance;  ///< that becomes white; empty: by the picture
  double brighter_ev = 0;
  double allowed_error_px = 1.0;
  std::vector<std::string> off;   ///< switches of the view
  bool plain = false;             ///< ground and imagery alone
  std::string engine = "raster";  ///< raster | rays
  std::string device;             ///< part of the Vulkan device's name
  bool force = false;             ///< replace what is there
  bool json = false;
};
struct FaultOptions {
  std::string run;      ///< name or process id; empty: list the runs
  std::string channel;  ///< empty: list the channels
  std::string kind;
  std::vector<std::string> keys;  ///< KEY=VALUE
  double for_s = 0;               ///< 0: until it is cleared
  bool list = false, clear = false;
  bool json = false;
};
struct PairOptions {
  std::string run;      ///< name or process id
  std::string channel;  ///< empty: all pairs
  bool acknowledge = false, learn_again = false;
  bool json = false;
};
struct ConvertOptions {
  std::filesystem::path input, output;
  std::filesystem::path metadata;  ///< of an Ouster
  std::string image;               ///< of an Ouster: a field as images; empty: points
  int scan = 0;                    ///< of a .pcd or .png
  bool scan_given = false;
  bool force = false;
  bool json = false;
};
struct HostOptions {
  std::string application;
  std::vector<std::filesystem::path> plugins;
};
struct PlainOptions {
  bool json = false;
};
struct DeviceOptions {
  bool json = false;
  std::vector<std::filesystem::path> plugins;  ///< whose drivers are asked, too
};

int run_command(const RunOptions& options);
int replay_command(const ReplayOptions& options);
int check_command(const CheckOptions& options);
int emulate_command(const EmulateOptions& options);
int sense_command(const SenseOptions& options);
int tune_command(const TuneOptions& options);
int inspect_command(const InspectOptions& options);
int localization_command(const LocalizationOptions& options);
int world_render_command(const WorldRenderOptions& options);
int fault_command(const FaultOptions& options);
int pair_command(const PairOptions& options);
int convert_command(const ConvertOptions& options);
int devices_command(const DeviceOptions& options);
int doctor_command(const DeviceOptions& options);
int host_command(const HostOptions& options);
int rigs_command(const PlainOptions& options);

}  // namespace rigor
