#include "bench/run/assembly.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "bench/application/application_choice.h"
#include "bench/console/progress.h"
#include "bench/run/fault_signals.h"
#include "bench/run/pair_watches.h"
#include "bench/sensing/changing_device.h"
#include "bench/sensing/inertial.h"
#include "bench/sensing/signal_values.h"
#include "bench/tune/engine_choices.h"
#include "sensor-hal/channel/fault_bench.h"
#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/channel/simulated_sink.h"
#include "sensor-hal/channel/simulated_source.h"
#include "sensor-hal/channel/typed_source.h"
#include "sensor-hal/channel/worker_pool.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/record/replay_source.h"
#include "sim/platform/platform.h"

namespace rigor {
namespace {

constexpr const char* kSimulated = "simulated";
constexpr const char* kReplay = "replay";

class Assembler {
 public:
  Assembler(Assembly& out, const Registry& registry) : out_(out), rig_(out.parts.rig), registry_(registry) {}

  Status run() {
    if (auto s = check_channel_count(); !s) return s;
    auto expectations = Expectations::read(rig_);
    if (!expectations) return tl::unexpected<Error>(expectations.error());
    out_.parts.expectations = std::move(*expectations);
    auto application = make_application(rig_, registry_);
    if (!application) return tl::unexpected<Error>(application.error());
    out_.parts.application = std::move(*application);
    if (!rig_.simulation.world.empty()) {
      auto simulation = Simulation::open(rig_.simulation);
      if (!simulation) return tl::unexpected<Error>(simulation.error());
      out_.simulation = std::move(*simulation);
      out_.parts.motion.set_joint_count(out_.simulation->joint_count());
      auto engines = choose_engines(rig_, *out_.simulation);
      if (!engines) return tl::unexpected<Error>(engines.error());
      engines_ = std::move(*engines);
    }
    out_.workers = std::make_unique<WorkerPool>(static_cast<std::size_t>(rig_.simulation.workers));
    if (virtual_time()) {
      auto devices = DeviceWorld::open(rig_);
      if (!devices) return tl::unexpected<Error>(devices.error());
      out_.devices = std::move(*devices);
    }
    carry();
    out_.fault_workers = std::make_unique<WorkerPool>(static_cast<std::size_t>(rig_.simulation.workers));
    out_.parts.faults = std::make_shared<FaultBench>();
    {
      ProgressTask making("make the channels", static_cast<double>(rig_.channels.size()), "channels");
      for (const ChannelEntry& entry : rig_.channels) {
        making.note(entry.name);
        if (auto s = add_channel(entry); !s) return s;
        making.set(static_cast<double>(out_.parts.channels.size()));
      }
      making.finish();
    }
    for (const SinkEntry& entry : rig_.sinks)
      if (auto s = add_sink(entry); !s) return s;
    if (auto s = bind_joints(); !s) return s;
    std::vector<InputPort> ports;
    for (const auto& channel : out_.parts.channels)
      ports.push_back({channel->entry->name, &channel->source->describe(), &channel->port});
    if (auto s = out_.parts.faults->bind(ports); !s) return s;
    if (auto s = follow(); !s) return s;
    return {};
  }

 private:
  [[nodiscard]] bool virtual_time() const { return rig_.clock == ClockKind::virtual_time; }

  /// Simulated channels and pairs compute on strands of the worker pool, which are refused here, at the
  /// channel that takes one too many, before a world is read.
  Status check_channel_count() const {
    std::size_t strands = 0;
    for (const ChannelEntry& entry : rig_.channels) {
      strands += entry.is_pair ? 2 : entry.source.backend == kSimulated ? 1 : 0;
      if (strands <= WorkerPool::kMaxStrands) continue;
      return tl::unexpected<Error>(
          entry.node
              .error("",
                     fmt::format("expected at most {} simulated channels in a rig (a pair counts twice), got "
                                 "more: this is the first that is too many; split the rig",
                                 WorkerPool::kMaxStrands))
              .error());
    }
    return {};
  }

  /// The error for a backend that does not exist, at its place.
  Error unknown_backend(const BackendChoice& choice) const {
    std::vector<std::string> names = registry_.names();
    names.emplace_back(kSimulated);
    names.emplace_back(kReplay);
    return choice.params
        .error("backend", fmt::format("expected one of {}, got \"{}\"{}", fmt::join(names, ", "),
                                      choice.backend, did_you_mean(choice.backend, names)))
        .error();
  }

  Result<DeviceParts> parts_of(const BackendChoice& choice, ConfigNode& emulator_params) {
    const EmulatorEntry* emulator = rig_.emulator(choice.emulated_by);
    if (!emulator)
      return tl::unexpected<Error>(
          choice.params
              .error("backend",
                     fmt::format(
                         "expected an entry `{}` in `emulators` to stand for this device in virtual time, "
                         "found none; add it, name another with `emulated_by`, or run with --clock wall",
                         choice.emulated_by))
              .error());
    emulator_params = emulator->emulator.params;
    return out_.devices->parts(emulator->name);
  }

  Result<std::unique_ptr<SimulatedSource>> make_simulated(const ChannelEntry& entry,
                                                          const BackendChoice& choice,
                                                          const std::string& name) {
    if (!out_.simulation)
      return tl::unexpected<Error>(
          choice.params
              .error("backend", "expected `simulation.world` in the rig for a simulated channel, found none")
              .error());
    if (auto s = knows_platform(choice); !s) return tl::unexpected<Error>(s.error());
    if (entry.kind == SampleKind::pose) {
      auto body = out_.simulation->platform(choice.params.text("platform"));
      if (!body) return tl::unexpected<Error>(choice.params.error("platform", body.error().message).error());
      return std::make_unique<SimulatedSource>(make_pose_provider(*body, choice.params.text("platform")),
                                               &out_.parts.motion, *out_.workers);
    }
    SensorOptions options;
    options.times = std::make_shared<SensorTimes>();
    out_.parts.sensor_times.emplace_back(name, options.times);
    if (const auto it = engines_.find(entry.name); it != engines_.end()) options.choice = it->second;
    if (entry.kind == SampleKind::point_cloud || entry.kind == SampleKind::range_image) {
      auto sampler = changing_sampler(
          choice.params, [&](const ConfigNode& params) -> Result<std::shared_ptr<SampleProvider>> {
            auto made = out_.simulation->sampler(entry.kind, params, rig_.seed, name, options);
            if (!made) return tl::unexpected<Error>(made.error());
            return std::shared_ptr<SampleProvider>(std::move(*made));
          });
      if (!sampler) return tl::unexpected<Error>(sampler.error());
      return std::make_unique<SimulatedSource>(std::move(*sampler), &out_.parts.motion, *out_.workers);
    }
    if (is_inertial(entry.kind)) {
      auto provider =
          out_.simulation->inertial(entry.kind, choice.params, rig_.seed, name, entry.period, options);
      if (!provider) return tl::unexpected<Error>(provider.error());
      return std::make_unique<SimulatedSource>(std::move(*provider), &out_.parts.motion, *out_.workers);
    }
    if (entry.kind == SampleKind::register_block)
      return std::make_unique<SimulatedSource>(
          make_signal_values(choice.params,
                             [this](const ConfigNode& n, std::string_view key) {
                               auto index = out_.simulation->joint(n.text(key));
                               if (!index) throw n.error(key, index.error().message);
                               return *index;
                             }),
          &out_.parts.motion, *out_.workers);
    if (entry.kind != SampleKind::image)
      return tl::unexpected<Error>(
          entry.node
              .error("kind",
                     fmt::format("expected image, range_image, point_cloud, registers, pose, imu, nav_fix or "
                                 "odometry, which simulators make, got {}",
                                 kind_name(entry.kind)))
              .error());
    auto camera = changing_camera(choice.params, [&](const ConfigNode& params) {
      return out_.simulation->camera(params, rig_.seed, name, options);
    });
    if (!camera) return tl::unexpected<Error>(camera.error());
    return std::make_unique<SimulatedSource>(std::move(*camera), &out_.parts.motion, *out_.workers);
  }

  /// Of kinds that devices tell by registers or signals: behind what says what these mean.
  Result<std::unique_ptr<Source>> make_source(const ChannelEntry& entry, const std::string& name,
                                              std::string& replaced_by) {
    auto source = make_plain_source(entry, name, replaced_by);
    const std::string& backend = entry.source.backend;
    const bool device = backend != kSimulated && backend != kReplay;
    if (!source || !device || values_of_kind(entry.kind).empty()) return source;
    return std::unique_ptr<Source>(std::make_unique<TypedSource>(std::move(*source)));
  }

  Result<std::unique_ptr<Source>> make_plain_source(const ChannelEntry& entry, const std::string& name,
                                                    std::string& replaced_by) {
    const BackendChoice& choice = entry.source;
    if (choice.backend == kSimulated) {
      auto source = make_simulated(entry, choice, name);
      if (!source) return tl::unexpected<Error>(source.error());
      return std::unique_ptr<Source>(std::move(*source));
    }
    if (choice.backend == kReplay) {
      // A relative path is an input of the rig, looked up from its folder.
      auto recording = Recording::open((choice.params.base_dir() / choice.params.text("file")).string());
      if (!recording) return tl::unexpected<Error>(recording.error());
      return std::make_unique<ReplaySource>(*recording, choice.params.text_or("channel", name));
    }
    const Backend* backend = registry_.find(choice.backend);
    if (!backend) return tl::unexpected<Error>(unknown_backend(choice));
    const bool recording = backend->reads_recording && backend->reads_recording(choice.params);
    if (!virtual_time() || recording) {
      if (!backend->make_source)
        return tl::unexpected<Error>(
            choice.params.error("backend", choice.backend + " gives no samples").error());
      return backend->make_source();
    }
    if (!backend->make_virtual_source)
      return tl::unexpected<Error>(
          choice.params
              .error("backend", choice.backend + " cannot be replaced in virtual time; run with --clock wall")
              .error());
    ConfigNode emulator_params;
    auto parts = parts_of(choice, emulator_params);
    if (!parts) return tl::unexpected<Error>(parts.error());
    replaced_by = "the " + choice.backend + " emulator \"" + choice.emulated_by + "\" in process";
    return backend->make_virtual_source(std::move(*parts), emulator_params);
  }

  ChannelConfig channel_config(const ChannelEntry& entry, const std::string& name, ConfigNode params) const {
    ChannelConfig c;
    c.name = name;
    c.kind = entry.kind;
    c.period = entry.period;
    c.latency = entry.latency;
    c.seed = rig_.seed;
    c.params = std::move(params);
    return c;
  }

  /// Any source can be given faults, in the rig or while the run goes on.
  template <class S>
  std::unique_ptr<FaultySource> with_faults(std::unique_ptr<S> source) {
    auto faulty =
        std::make_unique<FaultySource>(std::move(source), out_.fault_workers.get(), find_dbc_signal);
    faulty_.push_back(faulty.get());
    return faulty;
  }

  Status add_channel(const ChannelEntry& entry) {
    auto channel = std::make_unique<RunChannel>();
    channel->entry = &entry;
    if (!entry.is_pair) {
      auto source = make_source(entry, entry.name, channel->replaced_by);
      if (!source) return tl::unexpected<Error>(source.error());
      channel->source = with_faults(std::move(*source));
      if (auto s = channel->source->configure(channel_config(entry, entry.name, entry.source.params)); !s)
        return s;
    } else if (auto s = add_pair(entry, *channel); !s) {
      return s;
    }
    if (channel->source->describe().kind != entry.kind)
      return tl::unexpected<Error>(
          entry.node
              .error("kind", fmt::format("expected {}, which is what the backend gives, got {}",
                                         kind_name(channel->source->describe().kind), kind_name(entry.kind)))
              .error());
    for (FaultySource* source : faulty_)
      out_.parts.faults->add(*source, static_cast<std::uint32_t>(out_.parts.channels.size()));
    faulty_.clear();
    out_.parts.channels.push_back(std::move(channel));
    return {};
  }

  Status add_pair(const ChannelEntry& entry, RunChannel& channel) {
    if (entry.twin.backend != kSimulated)
      return tl::unexpected<Error>(
          entry.twin.params
              .error("backend",
                     "expected `simulated` for the twin of a pair, got \"" + entry.twin.backend + "\"")
              .error());
    auto real = make_source(entry, entry.name + ".real", channel.replaced_by);
    if (!real) return tl::unexpected<Error>(real.error());
    auto twin = make_simulated(entry, entry.twin, entry.name + ".simulated");
    if (!twin) return tl::unexpected<Error>(twin.error());
    auto pair = std::make_unique<PairSource>(with_faults(std::move(*real)),
                                             with_faults(std::unique_ptr<FollowerSource>(std::move(*twin))),
                                             *out_.workers);
    channel.pair = pair.get();
    channel.source = std::move(pair);
    if (auto s = channel.source->configure(channel_config(entry, entry.name, entry.pair)); !s) return s;
    if (!entry.watch) return {};
    auto watch = make_pair_watch(entry, channel.pair->side(PairSide::real).describe(),
                                 channel.pair->side(PairSide::simulated).describe());
    if (!watch) return tl::unexpected<Error>(watch.error());
    channel.pair->watch(std::make_unique<PairMonitor>(std::move(*watch)));
    return {};
  }

  /// A sink whose device is a platform of this process.
  Result<std::unique_ptr<Sink>> make_simulated_sink(const SinkEntry& entry) {
    const ConfigNode& n = entry.sink.params;
    if (!out_.simulation)
      return tl::unexpected<Error>(
          n.error("backend", "expected `simulation.world` in the rig for a simulated device, found none")
              .error());
    auto body = out_.simulation->platform(n.text("platform"));
    if (!body) return tl::unexpected<Error>(n.error("platform", body.error().message).error());
    if (!moves_here(*body))
      return tl::unexpected<Error>(
          n.error("platform",
                  "expected a platform that the bench moves, got one that an emulator or a channel "
                  "moves; command that device")
              .error());
    return std::make_unique<SimulatedSink>(out_.simulation->platforms()[*body].model);
  }

  Status add_sink(const SinkEntry& entry) {
    auto sink = std::make_unique<RunSink>();
    sink->entry = &entry;
    if (entry.sink.backend == kSimulated) {
      auto made = make_simulated_sink(entry);
      if (!made) return tl::unexpected<Error>(made.error());
      sink->sink = std::move(*made);
      return configure_sink(entry, std::move(sink));
    }
    const Backend* backend = registry_.find(entry.sink.backend);
    if (!backend) return tl::unexpected<Error>(unknown_backend(entry.sink));
    const bool replaced = virtual_time() && !backend->same_in_virtual_time;
    if (replaced ? !backend->make_virtual_sink : !backend->make_sink)
      return tl::unexpected<Error>(
          entry.node
              .error("backend",
                     entry.sink.backend +
                         (replaced ? " cannot be replaced in virtual time as a sink" : " takes no commands"))
              .error());
    if (replaced) {
      ConfigNode emulator_params;
      auto parts = parts_of(entry.sink, emulator_params);
      if (!parts) return tl::unexpected<Error>(parts.error());
      auto made = backend->make_virtual_sink(std::move(*parts), emulator_params);
      if (!made) return tl::unexpected<Error>(made.error());
      sink->sink = std::move(*made);
      sink->replaced_by =
          "the " + entry.sink.backend + " emulator \"" + entry.sink.emulated_by + "\" in process";
    } else {
      sink->sink = backend->make_sink();
    }
    return configure_sink(entry, std::move(sink));
  }

  Status configure_sink(const SinkEntry& entry, std::unique_ptr<RunSink> sink) {
    auto faulty = std::make_unique<FaultySink>(std::move(sink->sink));
    FaultySink& faults = *faulty;
    sink->sink = std::move(faulty);
    ChannelConfig c;
    c.name = entry.name;
    c.latency = entry.latency;
    c.seed = rig_.seed;
    c.params = entry.sink.params;
    if (auto s = sink->sink->configure(c); !s) return s;
    out_.parts.faults->add(faults);
    out_.parts.sinks.push_back(std::move(sink));
    return {};
  }

  /// Whether the bench computes this platform: no emulator does, and no channel tells.
  [[nodiscard]] bool moves_here(std::size_t body) const {
    const PlatformEntry& entry = rig_.simulation.platforms[body];
    return entry.channel.empty() && !emulated(entry.name);
  }
  [[nodiscard]] bool emulated(const std::string& platform) const {
    return std::any_of(rig_.emulators.begin(), rig_.emulators.end(), [&](const EmulatorEntry& e) {
      return e.emulator.params.has("platform") && e.emulator.params.text("platform") == platform;
    });
  }

  /// Platforms that are computed in this process move the bench's world, or that of its devices.
  void carry() {
    if (out_.simulation)
      for (std::size_t i = 0; i < out_.simulation->platforms().size(); ++i) {
        const WorldPlatform& p = out_.simulation->platforms()[i];
        if (!moves_here(i)) continue;
        out_.parts.motion.carry(i, p);
        out_.parts.platforms.push_back(p.model);
      }
    if (out_.devices)
      for (auto& p : out_.devices->platforms()) out_.parts.platforms.push_back(std::move(p));
  }

  /// A simulated channel on a platform whose way nobody tells the bench would stand still.
  Status knows_platform(const BackendChoice& choice) const {
    const ConfigNode& n = choice.params;
    const char* const key = n.has("platform") ? "platform" : "parent";
    if (!n.has(key)) return {};
    const std::string word = n.text(key), name = word.substr(0, word.find('.'));
    for (const PlatformEntry& entry : rig_.simulation.platforms)
      if (entry.name == name && entry.channel.empty() && emulated(name))
        return tl::unexpected<Error>(
            n.error(key,
                    fmt::format("expected `channel` in simulation.platforms.{}: an emulator moves it in the "
                                "devices' world, and the bench knows of that what a channel tells",
                                name))
                .error());
    return {};
  }

  /// Platforms that channels tell of.
  Status follow() {
    for (std::size_t i = 0; i < rig_.simulation.platforms.size(); ++i) {
      const PlatformEntry& entry = rig_.simulation.platforms[i];
      const BodyState start = out_.simulation->platforms()[i].model->motion_at(BenchTime()).body;
      if (entry.channel.empty()) {
        if (moves_here(i)) {
          if (auto s = knows_its_fellings(entry); !s) return s;
          continue;
        }
        out_.parts.motion.stand(i, start);
      }
      for (const auto& channel : out_.parts.channels)
        if (channel->entry->name == entry.channel) {
          const InputPort input{entry.channel, &channel->source->describe(), &channel->port};
          if (auto s = out_.parts.motion.follow(i, entry.name, start, input); !s) return s;
        }
      if (auto s = follow_fellings(i, entry); !s) return s;
    }
    return {};
  }

  /// A platform that the bench moves is asked itself.
  static Status knows_its_fellings(const PlatformEntry& entry) {
    if (entry.node.text_or("felled", "").empty()) return {};
    return tl::unexpected<Error>(
        entry.node
            .error(
                "felled",
                fmt::format("expected none: the bench moves {} itself, and its world loses a tree at the "
                            "instant of `fell`; `felled` is for a platform that a device or a channel moves",
                            entry.name))
            .error());
  }
  Status follow_fellings(std::size_t index, const PlatformEntry& entry) {
    const std::string teller = entry.node.text_or("felled", "");
    if (teller.empty()) return {};
    for (const auto& channel : out_.parts.channels)
      if (channel->entry->name == teller && channel->entry->kind == SampleKind::register_block)
        return out_.parts.motion.follow_fellings(index, out_.simulation->platforms()[index].model,
                                                 {teller, &channel->source->describe(), &channel->port});
    return tl::unexpected<Error>(
        entry.node
            .error("felled", fmt::format("expected a channel of kind registers that tells what the platform "
                                         "cuts, got \"{}\"",
                                         teller))
            .error());
  }

  Status bind_joints() {
    for (const JointBinding& binding : rig_.simulation.joints) {
      if (!out_.simulation)
        return fail(ErrorCode::bad_input, "simulation.joints", "expected `simulation.world`, found none");
      auto index = out_.simulation->joint(binding.joint);
      if (!index) return tl::unexpected<Error>(index.error());
      for (const auto& channel : out_.parts.channels)
        if (channel->entry->name == binding.channel) {
          const InputPort input{binding.channel, &channel->source->describe(), &channel->port};
          if (auto s = out_.parts.motion.bind(*index, binding, input); !s) return s;
        }
    }
    return {};
  }

  Assembly& out_;
  const RigConfig& rig_;
  const Registry& registry_;
  EngineChoices engines_;
  std::vector<FaultySource*> faulty_;  ///< of the channel that is being added
};

}  // namespace

Result<std::unique_ptr<Assembly>> assemble(RigConfig rig, const Registry& registry) {
  auto assembly = std::make_unique<Assembly>();
  assembly->parts.rig = std::move(rig);
  auto status = catch_config([&] { return Assembler(*assembly, registry).run(); });
  if (!status) return tl::unexpected<Error>(status.error());
  if (!*status) return tl::unexpected<Error>(status->error());
  return assembly;
}

}  // namespace rigor
