// `rigor`: parses the command line and calls the command. All that CLI11 costs in compile time is paid here,
// once.
#include <fmt/format.h>
#include <algorithm>
#include <cstdio>
#include <exception>
#include <new>
#include <string>
#include <string_view>
#include <vector>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/files/installed_configs.h"
#include "bench/plant/fmu_host.h"
#include "bench/version.h"
#include "cli/calibrate/calibrate_cli.h"
#include "cli/commands.h"
#include "cli/dataset_cli.h"
#include "cli/option_checks.h"
#include "cli/sweep_cli.h"
#include "cli/world/world_cli.h"
#include "sensor-hal/config/renamed.h"

namespace {

void add_overrides(CLI::App* app, std::vector<std::string>& overrides) {
  app->add_option("--set", overrides, "Replace one value of the rig: path.to.key=value (may be repeated)")
      ->type_name("KEY=VALUE")
      ->allow_extra_args(false);
}

void add_fail_on(CLI::App* app, std::vector<std::string>& names) {
  app->add_option("--fail-on", names,
                  "Exit status 1 where the verdict has one of these: lost, late, silent, alarm, uncompared, "
                  "skipped, missed, command, … (docs/verdict.md; an unknown one lists them all)")
      ->type_name("NAME,…")
      ->delimiter(',')
      ->allow_extra_args(false);
}

void add_junit(CLI::App* app, std::filesystem::path& file) {
  app->add_option("--junit", file, "Write what the rig expects, and what came of it, as JUnit's XML");
}

void add_live(CLI::App* app, rigor::LiveOptions& live) {
  app->add_option_function<std::vector<std::string>>(
         "--live",
         [&live](const std::vector<std::string>& given) {
           live.on = true;
           if (!given.empty()) live.endpoint = given.front();
         },
         "Serve a page that shows how it goes, for browsers and Foxglove (default 127.0.0.1:8765)")
      ->type_name("[ADDRESS:]PORT")
      ->expected(0, 1)
      ->trigger_on_parse();
  app->add_option("--live-token", live.token,
                  "Who connects must say this (or RIGOR_LIVE_TOKEN; default: one that is made and printed)");
  app->add_flag("--live-open", live.open, "Any user of this machine may connect, without a token");
  app->add_option("--live-page", live.page, "Folder with other files for the page")
      ->check(CLI::ExistingDirectory);
  app->add_option(
         "--pace", live.pace,
         "Virtual time: at most so many seconds of it in a second; 0: as fast as it goes (default: 1 with "
         "--live, else 0)")
      ->check(rigor::number_within({.min = 0, .max = 1e6}));
}

/// To every command that works on something. Options of a subcommand stand behind its name.
void add_progress(CLI::App& app) {
  const auto below = app.get_subcommands([](CLI::App*) { return true; });
  for (CLI::App* sub : below) add_progress(*sub);
  if (!below.empty()) return;
  app.add_option_function<std::string>(
         "--progress",
         [](const std::string& format) {
           using rigor::ProgressFormat;
           rigor::set_progress_format(format == "json"   ? ProgressFormat::json
                                      : format == "none" ? ProgressFormat::none
                                                         : ProgressFormat::line);
         },
         "How far it has come, on stderr: line, json (an object a line) or none (default: line, from 2 s on)")
      ->check(CLI::IsMember({"line", "json", "none"}));
}

constexpr const char* kForce = "Write over a file that is there";
constexpr const char* kForceKept = "Write over what is there, in place of keeping it under a number";

int command_line(int argc, char** argv) {
  rigor::set_progress_format(rigor::ProgressFormat::line);
  CLI::App app{"Rigor: a hardware-in-the-loop real-time test bench of real and simulated sensors."};
  app.require_subcommand(1);
  app.set_version_flag("--version", rigor::version_text);
  app.footer("Every command has --help with an example. Exit status: 0 good, 1 ran and failed, 2 bad input.");

  rigor::RunOptions run;
  auto* run_app = app.add_subcommand("run", "Run a rig");
  run_app->add_option("RIG", run.rig, "Rig file, or the name of one that came along (rigor rigs)")
      ->required();
  run_app->add_option("--clock", run.clock, "wall or virtual (default: what the rig says)")
      ->check(CLI::IsMember({"wall", "virtual"}));
  run_app->add_option("--duration", run.duration_s, "Seconds; 0: until Ctrl-C")
      ->check(rigor::number_within({.min = 0, .max = rigor::kLongestRun_s}));
  run_app->add_option("--workers", run.workers, "Threads that simulators compute on; no result depends on it")
      ->check(CLI::Range(1, 64));
  run_app->add_option("--record", run.record, "Write an MCAP recording");
  run_app->add_option("--report", run.report, "Write an HTML report into this folder");
  run_app->add_option("--trace", run.trace, "Write a trace of the loop for ui.perfetto.dev");
  run_app->add_flag("--no-emulators", run.no_emulators,
                    "Do not bring up the rig's emulators: the devices are there already");
  run_app->add_option(
      "--faults-from", run.faults_from,
      "Recording of a run of this rig: faults that were injected while it went on come again");
  run_app->add_flag("--digest", run.digest,
                    "Digest what the application sees, also in wall-clock time without a recording");
  add_fail_on(run_app, run.fail_on);
  add_junit(run_app, run.junit);
  add_live(run_app, run.live);
  run_app->add_flag("--no-control", run.no_control, "Without the socket that `rigor fault` talks to");
  run_app->add_flag("--force", run.force, kForceKept);
  run_app->add_flag("--json", run.json, "Print the results as JSON");
  add_overrides(run_app, run.overrides);
  run_app->footer(
      "Examples: rigor run configs/demo.yaml --duration 10 --record demo.mcap --report report\n"
      "          rigor run configs/demo.yaml --clock virtual --fail-on lost,late,alarm");

  rigor::EmulateOptions emulate;
  auto* emulate_app =
      app.add_subcommand("emulate", "Bring up the devices of a rig as emulators, until Ctrl-C");
  emulate_app->add_option("RIG", emulate.rig, "Rig file or name")->required();
  emulate_app->add_option("--only", emulate.only, "Only these emulators");
  emulate_app->add_option("--ready-fd", emulate.ready_fd, "File descriptor that gets a line when all are up")
      ->group("");
  emulate_app->add_flag("--json", emulate.json, "Print the endpoints as JSON");
  add_overrides(emulate_app, emulate.overrides);
  emulate_app->footer("Example: rigor emulate configs/demo.yaml");

  rigor::ReplayOptions replay;
  auto* replay_app = app.add_subcommand("replay", "Run the same rig on recorded inputs");
  replay_app->add_option("RECORDING", replay.recording, "MCAP file of a run")->required();
  replay_app->add_option("RIG", replay.rig, "Rig file (default: the one in the recording)");
  replay_app->add_option("--record", replay.record, "Write an MCAP recording of the replay");
  replay_app->add_option("--report", replay.report, "Write an HTML report into this folder");
  add_fail_on(replay_app, replay.fail_on);
  add_junit(replay_app, replay.junit);
  add_live(replay_app, replay.live);
  replay_app->add_flag("--live-end", replay.live.ends, "The page ends with the replay (else: with Ctrl-C)");
  replay_app->add_flag(
      "--run-program", replay.run_program,
      "Start the program, or load the shared object, that the recording names as its application");
  replay_app->add_flag("--force", replay.force, kForceKept);
  replay_app->add_flag("--json", replay.json, "Print the results as JSON");
  add_overrides(replay_app, replay.overrides);
  replay_app->footer("Example: rigor replay demo.mcap --record again.mcap");

  rigor::CheckOptions check;
  auto* check_app = app.add_subcommand(
      "check",
      "Judge a recording by what its rig expects (docs/expect.md), or where nothing is expected, and of any "
      "program's ROS 2 recording, by its data (docs/recording.md)");
  check_app->add_option("RECORDING", check.recording, "MCAP file")->required();
  check_app->add_option(
      "RIG", check.rig,
      "Rig whose `expect` is taken in place of the recorded one's, or a file with nothing else");
  check_app->add_flag("--data", check.data,
                      "By its data whatever the rig expects: stamps, gaps, rates, clouds, frames");
  add_junit(check_app, check.junit);
  check_app->add_flag("--force", check.force, kForceKept);
  check_app->add_flag("--json", check.json, "Print what came of it as JSON");
  add_overrides(check_app, check.overrides);
  check_app->footer(
      "Examples: rigor check demo.mcap\n"
      "          rigor check demo.mcap stricter.yaml --junit junit.xml\n"
      "          rigor check --data somebodys.mcap --json\n"
      "Exit status: 1 where something does not hold, or is wrong with the data. What a recording cannot tell "
      "is said and fails "
      "nothing.");

  rigor::SenseOptions sense;
  auto* sense_app = app.add_subcommand("sense", "Take one sample of a simulated channel");
  sense_app->add_option("RIG", sense.rig, "Rig file or name")->required();
  sense_app->add_option("--channel", sense.channel, "Channel, or NAME of a pair (its simulated side)")
      ->required();
  sense_app->add_option("--at", sense.at_s, "Capture instant in seconds after the start");
  sense_app->add_option("--joint", sense.joints, "Position of a joint of the world, NAME=DEGREES")
      ->allow_extra_args(false);
  auto* ideal = sense_app->add_flag("--ideal", sense.ideal, "Without the sensor's errors");
  sense_app
      ->add_option("--only", sense.only,
                   "Of the sensor's effects these alone, separated by commas, or none; an unknown one lists "
                   "them all")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->excludes(ideal);
  sense_app
      ->add_flag("--difference", sense.difference,
                 "Range images: what the effects add to the ranges of the same device without any")
      ->excludes(ideal);
  sense_app->add_option("--renderer", sense.engine, "rays or raster (default: what the rig says)")
      ->check(CLI::IsMember({"rays", "raster"}));
  sense_app->add_option("--truth", sense.truth,
                        "Write node, class, range, normal and flow of every element as OpenEXR planes");
  sense_app
      ->add_option("-o,--output", sense.output,
                   "out.png, out.exr (images, range images) or out.pcd (point clouds, range images)")
      ->required();
  sense_app->add_flag("--force", sense.force, kForce);
  sense_app->add_flag("--json", sense.json, "Print what was written as JSON");
  add_overrides(sense_app, sense.overrides);
  sense_app->footer("Example: rigor sense configs/demo.yaml --channel right --at 2 -o right.png");

  rigor::TuneOptions tune;
  auto* tune_app = app.add_subcommand(
      "tune", "Measure engines and their settings for channels with a tolerance; write RIG.lock.yaml");
  tune_app->add_option("RIG", tune.rig, "Rig file or name")->required();
  tune_app->add_flag("--force", tune.force, kForceKept);
  tune_app->add_flag("--json", tune.json, "Print what was measured as JSON");
  add_overrides(tune_app, tune.overrides);
  tune_app->footer("Example: rigor tune tuned-scan");

  rigor::FaultOptions fault;
  auto* fault_app = app.add_subcommand(
      "fault", "Make something go wrong in a run that is going on; without KIND: what there is");
  fault_app->add_option("RUN", fault.run, "Name of the rig or process id (without: list the runs)");
  fault_app->add_option("CHANNEL", fault.channel, "Channel, sink, or NAME.real, NAME.simulated of a pair");
  fault_app->add_option("KIND", fault.kind, "drop, delay, bias, …: docs/faults.md");
  fault_app->add_option("KEYS", fault.keys, "The fault's keys, as key=value");
  fault_app->add_option("--for", fault.for_s, "Seconds; without: until it is cleared")
      ->check(rigor::number_within({.min = 0, .max = rigor::kLongestRun_s, .exclusive_min = true}));
  auto* fault_list = fault_app->add_flag("--list", fault.list, "What each fault of the run did so far");
  fault_app->add_flag("--clear", fault.clear, "End what was injected (of CHANNEL, or all)")
      ->excludes(fault_list);
  fault_app->add_flag("--json", fault.json, "Print as JSON");
  fault_app->footer("Example: rigor fault demo right drop probability=0.2 --for 2");

  rigor::PairOptions pair;
  auto* pair_app = app.add_subcommand(
      "pair",
      "Say what the watch of a run's pairs says, of one of them number by number: docs/pair-watch.md");
  pair_app->add_option("RUN", pair.run, "Name of the rig or process id")->required();
  auto* pair_channel = pair_app->add_option("CHANNEL", pair.channel, "A pair (without: all)");
  auto* acknowledge = pair_app->add_flag("--acknowledge", pair.acknowledge, "The alarm is over: watch again")
                          ->needs(pair_channel);
  pair_app->add_flag("--learn-again", pair.learn_again, "What is now is taken as normal")
      ->needs(pair_channel)
      ->excludes(acknowledge);
  pair_app->add_flag("--json", pair.json, "Print as JSON");
  pair_app->footer("Example: rigor pair pair-watch scan --acknowledge");

  rigor::InspectOptions inspect;
  auto* inspect_app = app.add_subcommand("inspect", "Say what is in a recording, or in an FMU");
  inspect_app
      ->add_option("FILE", inspect.file,
                   "MCAP file; packets of a Velodyne, a Livox or an Ouster (pcap); telegrams of a SICK "
                   "scanner (JSON); "
                   "an FMU (*.fmu)")
      ->required();
  inspect_app->add_option("--metadata", inspect.metadata,
                          "What an Ouster says of itself, JSON (default: FILE.json beside FILE.pcap)");
  inspect_app->add_flag("--repair", inspect.repair, "Make an indexed file of one that was cut short");
  inspect_app->add_option("-o,--output", inspect.output,
                          "Where the repaired file goes (default: FILE.repaired.mcap)");
  inspect_app->add_flag("--force", inspect.force, kForce);
  inspect_app->add_flag("--json", inspect.json, "Print as JSON");
  inspect_app->footer("Example: rigor inspect demo.mcap --repair -o demo-whole.mcap");

  rigor::ConvertOptions convert;
  auto* convert_app = app.add_subcommand(
      "convert", "Make points, or images, of what a LiDAR sent: packets or telegrams, without a rig");
  convert_app
      ->add_option("INPUT", convert.input,
                   "Packets of a Velodyne, a Livox or an Ouster (pcap, pcapng), telegrams of a SICK scanner "
                   "in JSON, or "
                   "UBX and NMEA of a satellite receiver (.ubx, .nmea, .log)")
      ->required();
  convert_app
      ->add_option("-o,--output", convert.output,
                   "out.mcap (all scans), or one of them: out.pcd, with --image out.png")
      ->required();
  convert_app->add_option("--metadata", convert.metadata,
                          "What an Ouster says of itself, JSON (default: INPUT.json beside INPUT.pcap)");
  convert_app->add_option("--image", convert.image, "Of an Ouster: this field as images in place of points")
      ->check(CLI::IsMember({"signal", "near_infrared", "reflectivity", "range"}));
  auto* convert_scan =
      convert_app->add_option("--scan", convert.scan, "Which one a .pcd or .png gets, from 0 (default: 0)")
          ->check(rigor::number_within({.min = 0, .max = 1e9}));
  convert_app->add_flag("--force", convert.force, "Write over a file that is there");
  convert_app->add_flag("--json", convert.json, "Print what was written as JSON");
  convert_app->footer("Example: rigor convert drive.pcap -o drive.mcap");

  rigor::LocalizationOptions localization;
  auto* localization_app = app.add_subcommand(
      "localization", "Say how far an application's estimate of its pose was from the truth");
  localization_app->add_option("RECORDING", localization.recording, "MCAP file of a run")->required();
  localization_app->add_option("--truth", localization.truth,
                               "Channel of kind pose, or registers with x_m, y_m, yaw_deg (truth)");
  localization_app->add_option("--estimate", localization.estimate,
                               "Sink that receives x, y, yaw (estimate)");
  localization_app->add_option("--after", localization.after_s, "Seconds from which on it counts (1)")
      ->check(rigor::number_within({.min = 0, .max = rigor::kLongestRun_s}));
  localization_app->add_option("--map", localization.map, "Stems to draw: x_m,y_m,diameter_m");
  localization_app->add_option("--report", localization.report, "Write a page with plots into this folder");
  localization_app->add_flag("--force", localization.force, kForceKept);
  localization_app->add_flag("--json", localization.json, "Print as JSON");
  localization_app->footer("Example: rigor localization report/forest-discs.mcap --report error");

  rigor::CalibrateCommandLine calibrate(app);
  rigor::WorldCommandLine world(app);
  const rigor::DatasetCommandLine dataset(app);
  const rigor::SweepCommandLine sweep(app);

  for (CLI::App* opens_a_world : {run_app, emulate_app, sense_app, tune_app, app.get_subcommand("dataset"),
                                  app.get_subcommand("sweep")})
    rigor::add_plugins(opens_a_world);
  add_progress(app);
  for (CLI::App* quick : {fault_app, pair_app}) quick->remove_option(quick->get_option("--progress"));

  rigor::DeviceOptions devices, doctor;
  rigor::PlainOptions rigs;
  rigor::HostOptions host;
  auto* host_app =
      app.add_subcommand("host", "Run an application of the loop in a process of its own; a rig starts it");
  host_app->add_option("APPLICATION", host.application, "Name of one that comes with Rigor or with a plugin")
      ->required();
  const auto with_plugins = [](CLI::App* command, std::vector<std::filesystem::path>& plugins,
                               const std::string& what) {
    command->add_option("--plugin", plugins, what + " (docs/sdk.md; may be repeated)")
        ->type_name("FILE.so")
        ->allow_extra_args(false);
  };
  with_plugins(host_app, host.plugins, "A shared object with applications");
  host_app->footer("In a rig: application: { command: [rigor, host, forest-localization], params: { … } }");

  auto* fmu_app = app.add_subcommand("fmu-host", "Serve one FMU to the run that starts this command");
  fmu_app->group("");

  auto* rigs_app = app.add_subcommand("rigs", "List the rigs that Rigor comes with");
  rigs_app->add_flag("--json", rigs.json, "Print as JSON");
  rigs_app->footer("Example: rigor rigs");
  auto* devices_app = app.add_subcommand("devices", "List what is attached, per driver");
  devices_app->add_flag("--json", devices.json, "Print as JSON");
  with_plugins(devices_app, devices.plugins, "A shared object with drivers");
  devices_app->footer("Example: rigor devices --json");
  auto* doctor_app = app.add_subcommand(
      "doctor", "Say what this machine lacks for real time or a driver, and how to mend it");
  doctor_app->add_flag("--json", doctor.json, "Print as JSON");
  with_plugins(doctor_app, doctor.plugins, "A shared object with drivers");
  doctor_app->footer("Example: rigor doctor");

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    const std::vector<std::string> words(argv + 1, argv + argc);
    const bool json = std::find(words.begin(), words.end(), "--json") != words.end();
    if (e.get_exit_code() != 0) {
      for (const std::string& word : words)
        if (const std::string_view now = rigor::renamed_option(word); !now.empty())
          return rigor::report_error({rigor::ErrorCode::bad_input, word, "now called " + std::string(now)},
                                     json);
      if (const std::string unknown = rigor::unknown_command(app, words); !unknown.empty())
        return rigor::report_error({rigor::ErrorCode::bad_input, "", unknown}, json);
      if (json) return rigor::report_error({rigor::ErrorCode::bad_input, "", e.what()}, true);
    }
    return app.exit(e) == 0 ? 0 : 2;
  }
  for (std::filesystem::path* rig :
       {&run.rig, &emulate.rig, &replay.rig, &check.rig, &sense.rig, &tune.rig, &localization.map})
    *rig = rigor::find_config(*rig);
  try {
    if (*run_app) return rigor::run_command(run);
    if (*emulate_app) return rigor::emulate_command(emulate);
    if (*replay_app) return rigor::replay_command(replay);
    if (*check_app) return rigor::check_command(check);
    if (*sense_app) return rigor::sense_command(sense);
    if (*tune_app) return rigor::tune_command(tune);
    if (*fault_app) return rigor::fault_command(fault);
    if (*pair_app) return rigor::pair_command(pair);
    if (*inspect_app) return rigor::inspect_command(inspect);
    convert.scan_given = convert_scan->count() > 0;
    if (*convert_app) return rigor::convert_command(convert);
    if (*localization_app) return rigor::localization_command(localization);
    if (calibrate.chosen()) return calibrate.run();
    if (world.chosen()) return world.run();
    if (dataset.chosen()) return dataset.run();
    if (sweep.chosen()) return sweep.run();
    if (*host_app) return rigor::host_command(host);
    if (*fmu_app) return rigor::plant::host_fmu();
    if (*rigs_app) return rigor::rigs_command(rigs);
    if (*devices_app) return rigor::devices_command(devices);
    return rigor::doctor_command(doctor);
  } catch (const std::bad_alloc&) {
    rigor::write_stderr(
        "rigor: this machine's memory is used up; choose smaller pictures, fewer channels or a smaller "
        "world\n");
    return 1;
  } catch (const std::exception& e) {
    if (std::ferror(stdout) != 0) return 1;  // it did not take what was printed; finish_stdout says so
    rigor::write_stderr(fmt::format("rigor: a defect of Rigor, please report it: {}\n", e.what()));
    return 1;
  }
}

}  // namespace

int main(int argc, char** argv) {
  rigor::prepare_streams();
  return rigor::finish_stdout(command_line(argc, argv));
}
