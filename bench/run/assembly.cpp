#include "bench/run/assembly.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "bench/application/application_choice.h"
#include "bench/console/progress.h"
#include "bench/run/bridges.h"
#include "bench/run/pair_watches.h"
#include "bench/run/rig_frames.h"
#include "bench/run/simulated_backend.h"
#include "bench/sensing/scan_line.h"
#include "sensor-hal/channel/fault_bench.h"
#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/channel/simulated_source.h"
#include "sensor-hal/channel/typed_source.h"
#include "sensor-hal/channel/worker_pool.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sim/platform/platform.h"

namespace rigor {
namespace {

class Assembler {
 public:
  Assembler(Assembly& out, Registry registry)
      : out_(out), rig_(out.parts.rig), registry_(std::move(registry)) {}

  Status run() {
    if (auto s = check_channel_count(); !s) return s;
    auto expectations = Expectations::read(rig_);
    if (!expectations) return tl::unexpected<Error>(expectations.error());
    out_.parts.expectations = std::move(*expectations);
    auto application = make_application(rig_, registry_);
    if (!application) return tl::unexpected<Error>(application.error());
    out_.parts.application = std::move(*application);
    EngineChoices renderers;
    if (!rig_.simulation.world.empty()) {
      auto simulation = Simulation::open(rig_.simulation);
      if (!simulation) return tl::unexpected<Error>(simulation.error());
      out_.simulation = std::move(*simulation);
      out_.parts.motion.set_joint_count(out_.simulation->joint_count());
      auto chosen = choose_engines(rig_, *out_.simulation);
      if (!chosen) return tl::unexpected<Error>(chosen.error());
      renderers = std::move(*chosen);
    }
    out_.workers = std::make_unique<WorkerPool>(static_cast<std::size_t>(rig_.simulation.workers));
    registry_.add(
        simulated_backend({&out_.parts, out_.simulation.get(), out_.workers.get(), std::move(renderers)}));
    const auto shown = plant::plants_of_emulators(rig_);
    auto plants = plant::Plants::open(
        rig_, [&](const std::string& name) { return std::ranges::find(shown, name) == shown.end(); });
    if (!plants) return tl::unexpected<Error>(plants.error());
    out_.plants = std::move(*plants);
    registry_.add(plant::fmu_backend(out_.plants));
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
    out_.parts.plants = out_.plants.used();
    if (out_.devices)
      for (auto& p : out_.devices->plants()) out_.parts.plants.push_back(std::move(p));
    if (auto s = bind_joints(); !s) return s;
    std::vector<InputPort> ports;
    for (const auto& channel : out_.parts.channels)
      ports.push_back({channel->entry->name, &channel->source->describe(), &channel->port});
    if (auto s = out_.parts.faults->bind(ports); !s) return s;
    if (auto s = follow(); !s) return s;
    if (auto s = add_frames(); !s) return s;
    return add_bridges(out_.parts, registry_);
  }

 private:
  [[nodiscard]] bool virtual_time() const { return rig_.clock == ClockKind::virtual_time; }

  /// Simulated channels and pairs compute on strands of the worker pool, which are refused here, at the
  /// channel that takes one too many, before a world is read.
  Status check_channel_count() const {
    std::size_t strands = 0;
    for (const ChannelEntry& entry : rig_.channels) {
      strands += entry.is_pair ? 2 : entry.source.backend == kSimulatedBackend ? 1 : 0;
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
    const std::vector<std::string> names = registry_.names();
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

  [[nodiscard]] Result<const Backend*> backend_of(const BackendChoice& choice) const {
    if (const Backend* backend = registry_.find(choice.backend)) return backend;
    return tl::unexpected<Error>(unknown_backend(choice));
  }

  Result<std::unique_ptr<Source>> make_source(const ChannelEntry& entry, std::string& replaced_by) {
    const auto backend = backend_of(entry.source);
    if (!backend) return tl::unexpected<Error>(backend.error());
    auto source = make_plain_source(**backend, entry.source, replaced_by);
    if (!source || (*backend)->gives_typed_samples || values_of_kind(entry.kind).empty()) return source;
    return std::unique_ptr<Source>(std::make_unique<TypedSource>(std::move(*source)));
  }

  /// Of the device itself, or of what stands for it in virtual time.
  Result<std::unique_ptr<Source>> make_plain_source(const Backend& backend, const BackendChoice& choice,
                                                    std::string& replaced_by) {
    const bool itself = !virtual_time() || backend.same_in_virtual_time ||
                        (backend.reads_recording && backend.reads_recording(choice.params));
    if (itself ? !backend.make_source : !backend.make_virtual_source)
      return tl::unexpected<Error>(
          choice.params
              .error("backend", choice.backend + (itself ? " gives no samples"
                                                         : " cannot be replaced in virtual time; run with "
                                                           "--clock wall"))
              .error());
    if (itself) return backend.make_source();
    ConfigNode emulator_params;
    auto parts = parts_of(choice, emulator_params);
    if (!parts) return tl::unexpected<Error>(parts.error());
    replaced_by = "the " + choice.backend + " emulator \"" + choice.emulated_by + "\" in process";
    return backend.make_virtual_source(std::move(*parts), emulator_params);
  }

  /// The simulated side of a pair measures at the instants of the real one.
  Result<std::unique_ptr<FollowerSource>> make_follower(const BackendChoice& choice) {
    const auto backend = backend_of(choice);
    if (!backend) return tl::unexpected<Error>(backend.error());
    if (const bool serves = !virtual_time() || (*backend)->same_in_virtual_time;
        serves && (*backend)->make_source) {
      std::unique_ptr<Source> source = (*backend)->make_source();
      if (auto* follower = dynamic_cast<FollowerSource*>(source.get())) {
        (void)source.release();
        return std::unique_ptr<FollowerSource>(follower);
      }
    }
    return tl::unexpected<Error>(
        choice.params
            .error("backend",
                   "expected `simulated`, or another backend that measures at given instants, for the "
                   "simulated side of a pair, got \"" +
                       choice.backend + "\"")
            .error());
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

  /// The signals in frames of a bus that faults name: there is one description of them, whatever gives the
  /// frames.
  [[nodiscard]] FrameSignalFinder find_signal() const {
    for (const auto& [name, backend] : registry_.all())
      if (backend.find_signal) return backend.find_signal;
    return {};
  }

  /// Any source can be given faults, in the rig or while the run goes on.
  template <class S>
  std::unique_ptr<FaultySource> with_faults(std::unique_ptr<S> source) {
    auto faulty = std::make_unique<FaultySource>(std::move(source), out_.fault_workers.get(), find_signal());
    faulty_.push_back(faulty.get());
    return faulty;
  }

  Status add_channel(const ChannelEntry& entry) {
    auto channel = std::make_unique<RunChannel>();
    channel->entry = &entry;
    if (!entry.is_pair) {
      auto source = make_source(entry, channel->replaced_by);
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
    auto real = make_source(entry, channel.replaced_by);
    if (!real) return tl::unexpected<Error>(real.error());
    auto simulated = make_follower(entry.simulated);
    if (!simulated) return tl::unexpected<Error>(simulated.error());
    auto pair = std::make_unique<PairSource>(with_faults(std::move(*real)),
                                             with_faults(std::move(*simulated)), *out_.workers);
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

  Status add_sink(const SinkEntry& entry) {
    auto sink = std::make_unique<RunSink>();
    sink->entry = &entry;
    const auto found = backend_of(entry.sink);
    if (!found) return tl::unexpected<Error>(found.error());
    const Backend* backend = *found;
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

  Status add_frames() {
    for (const ChannelEntry& entry : rig_.channels)
      if (const auto lines = scan_lines(rig_, entry); !lines) return tl::unexpected<Error>(lines.error());
    if (!rig_.frames.publish) return {};
    auto frames = frames_of(rig_, out_.parts.channels, out_.simulation.get());
    if (!frames) return tl::unexpected<Error>(frames.error());
    out_.parts.frames_assumed = std::move(frames->assumed);
    if (!frames->tree.empty())
      out_.parts.frames = std::make_shared<const record::FrameTree>(std::move(frames->tree));
    return {};
  }

  /// Platforms that are computed in this process move the bench's world, or that of its devices.
  void carry() {
    if (out_.simulation)
      for (std::size_t i = 0; i < out_.simulation->platforms().size(); ++i) {
        const WorldPlatform& p = out_.simulation->platforms()[i];
        if (!moves_here(rig_, i)) continue;
        out_.parts.motion.carry(i, p);
        out_.parts.platforms.push_back(p.model);
      }
    if (out_.devices)
      for (auto& p : out_.devices->platforms()) out_.parts.platforms.push_back(std::move(p));
  }

  /// Platforms that channels tell of.
  Status follow() {
    for (std::size_t i = 0; i < rig_.simulation.platforms.size(); ++i) {
      const PlatformEntry& entry = rig_.simulation.platforms[i];
      const BodyState start = out_.simulation->platforms()[i].model->motion_at(BenchTime()).body;
      if (entry.channel.empty()) {
        if (moves_here(rig_, i)) {
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
  Registry registry_;                  ///< and the backend `simulated`, over the rig's own world
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
