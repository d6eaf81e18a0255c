#include "sensor-hal/rig/rig.h"

#include <fmt/format.h>

#include <array>
#include <numbers>
#include <set>

#include "sensor-hal/config/rate.h"
#include "sensor-hal/rig/weather.h"

namespace rigor {
namespace {

constexpr std::array<std::pair<std::string_view, SampleKind>, 10> kKinds{
    {{"image", SampleKind::image},
     {"range_image", SampleKind::range_image},
     {"point_cloud", SampleKind::point_cloud},
     {"can_frame", SampleKind::can_frame},
     {"registers", SampleKind::register_block},
     {"pose", SampleKind::pose},
     {"event", SampleKind::event},
     {"imu", SampleKind::imu},
     {"nav_fix", SampleKind::nav_fix},
     {"odometry", SampleKind::odometry}}};

std::optional<PairWatchConfig> read_pair_watch(const ConfigNode& pair, Duration period) {
  if (!pair.has("watch")) return {};
  const ConfigNode n = pair.map("watch");
  PairWatchConfig w;
  w.window_s = n.number_or("window_s", w.window_s, {.min = 1e-3, .max = 1e6});
  if (w.window_s < period.seconds())
    throw n.error("window_s", fmt::format("expected at least the channel's period, {:g} s, got {:g}; windows "
                                          "without a pair say nothing",
                                          period.seconds(), w.window_s));
  w.baseline_windows = static_cast<std::uint32_t>(
      n.integer_or("baseline_windows", w.baseline_windows, {.min = 16, .max = 100000}));
  w.false_alarms_per_h = n.number_or("false_alarms_per_h", w.false_alarms_per_h, {.min = 1e-12, .max = 3600});
  n.finish();
  return w;
}

SampleKind read_kind(ConfigNode n) {
  std::vector<std::string> names;
  for (const auto& [name, kind] : kKinds) names.emplace_back(name);
  const std::string word = n.choice("kind", names);
  for (const auto& [name, kind] : kKinds)
    if (name == word) return kind;
  return SampleKind::none;
}

/// Frames of a bus and events come when they come; registers may, where they are signals of a bus.
bool may_lack_a_rate(SampleKind kind) {
  return kind == SampleKind::can_frame || kind == SampleKind::event || kind == SampleKind::register_block;
}

/// Of channels: periods from 1 us to 12 days, which int64 nanoseconds hold.
constexpr Range kRate_hz{.min = 1e-6, .max = 1e6};

/// Whether the channel itself, or the real side of a pair, is a device or a recording.
bool from_outside(ConfigNode n) {
  const ConfigNode side = n.has("pair") ? n.map("pair").map("real") : n;
  return side.text_or("backend", "simulated") != "simulated";
}

/// A scanner turns by its own clock: its rate is what it is, and the loop sees its scans when they come.
bool turns_by_itself(ConfigNode n, SampleKind kind) {
  return kind == SampleKind::point_cloud && from_outside(n);
}

/// Nodes of a bus report these by signals, when they do.
bool comes_by_signals(ConfigNode n, SampleKind kind) {
  return (kind == SampleKind::pose || kind == SampleKind::imu || kind == SampleKind::nav_fix ||
          kind == SampleKind::odometry) &&
         from_outside(n);
}

Duration read_ms(ConfigNode n, std::string_view key, double fallback_ms,
                 Range range = {.min = 0, .max = 1e7}) {
  return seconds_from(n.number_or(key, fallback_ms, range) * 1e-3);
}

BackendChoice read_backend(ConfigNode n, const std::string& name) {
  BackendChoice b;
  b.backend = n.text("backend");
  b.emulated_by = n.text_or("emulated_by", name);
  b.params = n;
  return b;
}

LoopConfig read_loop(ConfigNode n) {
  LoopConfig l;
  l.period = read_rate_or(n, "rate_hz", l.period, {.min = 1, .max = 20000});
  l.spin = seconds_from(n.number_or("spin_us", 0, {.min = 0, .max = l.period.seconds() * 1e6}) * 1e-6);
  const std::string policy = n.choice_or("overrun", {"skip", "abort", "log"}, "skip");
  l.overrun = policy == "skip"    ? OverrunChoice::skip
              : policy == "abort" ? OverrunChoice::abort
                                  : OverrunChoice::log;
  l.fifo_priority = static_cast<int>(n.integer_or("fifo_priority", 80, {.min = 0, .max = 98}));
  l.cpu = static_cast<int>(n.integer_or("cpu", -1, {.min = -1, .max = 1023}));
  l.lock_memory = n.flag_or("lock_memory", true);
  l.dma_latency = n.flag_or("dma_latency", true);
  l.heartbeat_deadline = read_ms(n, "heartbeat_ms", 100, {.min = 1, .max = 60000});
  n.finish();
  return l;
}

/// The loop sees at most one sample in a cycle: what comes faster would be overtaken before anyone saw it.
Period read_channel_rate(const ConfigNode& n, SampleKind kind, const LoopConfig& loop) {
  const Period period = read_rate(n, "rate_hz", kRate_hz);
  if (period < loop.period && !turns_by_itself(n, kind))
    throw n.error("rate_hz", fmt::format("expected a rate of at most the loop's {} Hz, got {}; raise "
                                         "`loop.rate_hz`",
                                         rate_text(loop.period), rate_text(period)));
  return period;
}

ChannelEntry read_channel(ConfigNode n, const std::string& name, const LoopConfig& loop) {
  ChannelEntry c;
  c.name = name;
  c.node = n;
  c.kind = read_kind(n);
  if (n.has("rate_hz") || !(may_lack_a_rate(c.kind) || comes_by_signals(n, c.kind)))
    c.period = read_channel_rate(n, c.kind, loop);
  c.latency = read_ms(n, "latency_ms", 0);
  c.record = n.flag_or("record", true);
  if (c.kind == SampleKind::point_cloud) {
    std::vector<std::string> layouts;
    for (const auto& [word, layout] : kPointLayouts) layouts.emplace_back(word);
    c.points = *point_layout_named(n.choice_or("points", layouts, "rigor"));
    c.laser_scan = n.map_or_absent("laser_scan");
  }
  c.timing.period = c.period;
  const double default_tolerance_ms = std::max(c.period.seconds() * 100, loop.period.seconds() * 1e3);
  c.timing.tolerance = read_ms(n, "tolerance_ms", default_tolerance_ms);
  c.timing.lost_after = read_ms(n, "lost_after_ms", std::max(500.0, c.period.seconds() * 5e3));
  c.timing.on_late =
      n.choice_or("on_late", {"hold", "drop"}, "hold") == "drop" ? LatePolicy::drop : LatePolicy::hold;
  c.is_pair = n.has("pair");
  if (!c.is_pair) {
    c.source = read_backend(n, name);
    return c;
  }
  if (n.has("backend"))
    throw n.error("backend", "expected either `backend` or `pair`, got both; keep one of them");
  if (n.has("faults"))
    throw n.error("faults",
                  "expected the faults of a pair at one of its sides: `pair.real.faults`, or "
                  "`pair.simulated.faults`");
  c.pair = n.map("pair");
  for (const ConfigNode& item : c.pair.list_or_empty("switches")) {
    PairSwitch s;
    s.after_start = seconds_from(item.number("at_s", {.min = 0, .max = 1e7}));
    s.to_real = item.choice("active", {"real", "simulated"}) == "real";
    item.finish();
    if (!c.switches.empty() && s.after_start < c.switches.back().after_start)
      throw item.error("at_s", "expected the switches in the order of time");
    c.switches.push_back(s);
  }
  c.watch = read_pair_watch(c.pair, c.period);
  c.source = read_backend(c.pair.map("real"), name);
  c.simulated = read_backend(c.pair.map("simulated"), name);
  n.finish();
  return c;
}

SimulationConfig read_simulation(ConfigNode n) {
  SimulationConfig s;
  if (n.has("world")) s.world = n.base_dir() / n.text("world");
  s.plugins = named_files(n, "plugins");
  if (!s.plugins.empty() && s.world.empty())
    throw n.error("plugins", "expected a `world` for them, found none");
  s.workers = static_cast<int>(n.integer_or("workers", 1, {.min = 1, .max = 64}));
  s.device = n.text_or("device", "");
  s.weather = read_weather(n);
  if (n.has("weather") && s.world.empty()) throw n.error("weather", "expected a `world` for it, found none");
  if (ConfigNode joints = n.map_or_absent("joints"); joints.present())
    for (const std::string& joint : joints.keys()) {
      ConfigNode j = joints.map(joint);
      JointBinding b;
      b.joint = joint;
      b.channel = j.text("channel");
      b.position_name = j.text("position");
      b.rate_name = j.text_or("rate", "");
      b.scale_rad = j.choice_or("unit", {"deg", "rad"}, "deg") == "deg" ? std::numbers::pi / 180 : 1.0;
      j.finish();
      s.joints.push_back(std::move(b));
    }
  if (ConfigNode platforms = n.map_or_absent("platforms"); platforms.present())
    for (const std::string& name : platforms.keys()) {
      ConfigNode p = platforms.map(name);
      s.platforms.push_back({name, p.text("kind"), p.text_or("channel", ""), p});
      if (s.world.empty()) throw n.error("platforms", "expected a `world` for them, found none");
    }
  n.finish();
  return s;
}

FramesConfig read_frames(ConfigNode n) {
  FramesConfig f;
  f.publish = n.flag_or("publish", true);
  f.root = n.text_or("root", f.root);
  if (f.root.empty()) throw n.error("root", "expected the name of a frame, got an empty one");
  f.period = read_rate_or(n, "rate_hz", f.period, {.min = 0.1, .max = 20000});
  if (const ConfigNode mounts = n.map_or_absent("mounts"); mounts.present())
    for (const std::string& frame : mounts.keys()) {
      const ConfigNode m = mounts.map(frame);
      f.mounts.push_back({frame, m.text_or("parent", f.root), m});
    }
  for (const ConfigNode& pair : n.list_or_empty("stereo")) {
    f.stereo.push_back({pair.text("left"), pair.text("right"), pair});
    pair.finish();
  }
  n.finish();
  return f;
}

void check_names(const RigConfig& rig, ConfigNode root) {
  std::set<std::string> emulators;
  for (const auto& e : rig.emulators) emulators.insert(e.name);
  std::set<std::string> channels;
  for (const auto& c : rig.channels) channels.insert(c.name);
  for (const auto& s : rig.sinks)
    if (channels.contains(s.name))
      throw root.map("sinks").error(
          s.name,
          "expected a name of its own, got the name of a channel; call it " + s.name + "_command, say");
  for (const auto& j : rig.simulation.joints) {
    bool found = false;
    for (const auto& c : rig.channels) found |= c.name == j.channel && c.kind == SampleKind::register_block;
    if (!found)
      throw root.map("simulation")
          .map("joints")
          .map(j.joint)
          .error("channel", fmt::format("expected a channel of kind registers, got \"{}\"", j.channel));
  }
  for (const auto& p : rig.simulation.platforms) {
    bool found = p.channel.empty();
    for (const auto& c : rig.channels)
      found |= c.name == p.channel && (c.kind == SampleKind::pose || c.kind == SampleKind::register_block);
    if (!found)
      throw p.node.error("channel",
                         fmt::format("expected a channel of kind pose or registers, got \"{}\"", p.channel));
  }
  for (const FramesConfig::Stereo& pair : rig.frames.stereo)
    for (const auto& [key, name] : {std::pair{"left", pair.left}, std::pair{"right", pair.right}})
      if (std::none_of(rig.channels.begin(), rig.channels.end(), [&, &wanted = name](const ChannelEntry& c) {
            return c.name == wanted && c.kind == SampleKind::image;
          }))
        throw pair.node.error(key, fmt::format("expected a channel of kind image, got \"{}\"", name));
}

void check_name(ConfigNode parent, const std::string& name) {
  const bool ok =
      !name.empty() && name.size() <= 64 &&
      name.find_first_not_of("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-") ==
          std::string::npos;
  if (!ok)
    throw parent.error(
        name, "expected a name of letters, digits, `_` and `-`, at most 64 of them, got \"" + name + "\"");
}

/// How the application is called: by one of three keys.
std::string read_application(const ConfigNode& app) {
  std::string named_by;
  for (const char* key : {"name", "library", "command"}) {
    if (!app.has(key)) continue;
    if (!named_by.empty())
      throw app.error(key, "expected one of name, library and command, got both " + named_by + " and " + key);
    named_by = key;
  }
  if (named_by.empty())
    throw app.error("",
                    "expected `name` of an application of Rigor, `library` (a shared object) or `command` (a "
                    "program and its arguments), got none");
  if (named_by != "command") return app.text(named_by);
  std::string words;
  for (const ConfigNode& word : app.list("command")) words += (words.empty() ? "" : " ") + word.as_text();
  if (words.empty()) throw app.error("command", "expected a program and its arguments, got an empty list");
  return words;
}

}  // namespace

std::string_view kind_name(SampleKind kind) {
  for (const auto& [name, k] : kKinds)
    if (k == kind) return name;
  return "none";
}

const EmulatorEntry* RigConfig::emulator(std::string_view emulator_name) const {
  for (const auto& e : emulators)
    if (e.name == emulator_name) return &e;
  return nullptr;
}

Result<RigConfig> parse_rig(ConfigNode root, const std::filesystem::path& file) {
  return catch_config([&] {
    RigConfig rig;
    rig.file = file;
    rig.text = root.dump();
    rig.name = root.text_or("name", file.stem().string());
    rig.seed = static_cast<std::uint64_t>(root.integer_or("seed", 1, {.min = 0}));
    rig.clock = root.choice_or("clock", {"wall", "virtual"}, "wall") == "wall" ? ClockKind::wall
                                                                               : ClockKind::virtual_time;
    rig.duration = seconds_from(root.number_or("duration_s", 0, {.min = 0, .max = 1e7}));
    rig.start_emulators = root.flag_or("start_emulators", true);
    rig.loop = read_loop(root.map_or_absent("loop"));
    rig.simulation = read_simulation(root.map_or_absent("simulation"));
    rig.simulation.seed = rig.seed;
    ConfigNode channels = root.map_or_absent("channels");
    for (const auto& name : channels.keys()) {
      check_name(channels, name);
      rig.channels.push_back(read_channel(channels.map(name), name, rig.loop));
    }
    ConfigNode sinks = root.map_or_absent("sinks");
    for (const auto& name : sinks.keys()) {
      check_name(sinks, name);
      ConfigNode n = sinks.map(name);
      rig.sinks.push_back({name, read_ms(n, "latency_ms", 0), read_backend(n, name), n});
    }
    ConfigNode emulators = root.map_or_absent("emulators");
    for (const auto& name : emulators.keys()) {
      check_name(emulators, name);
      ConfigNode n = emulators.map(name);
      rig.emulators.push_back({name, read_backend(n, name), n});
    }
    ConfigNode plants = root.map_or_absent("plants");
    for (const auto& name : plants.keys()) {
      check_name(plants, name);
      rig.plants.push_back({name, plants.map(name)});
    }
    if (ConfigNode app = root.map_or_absent("application"); app.present()) {
      rig.application = read_application(app);
      rig.application_params = app;
    }
    rig.plugins = named_files(root, "plugins");
    rig.expect = root.list_or_empty("expect");
    ConfigNode analyses = root.map_or_absent("analyses");
    for (const auto& name : analyses.keys()) rig.analyses.push_back({name, analyses.map(name)});
    ConfigNode bridges = root.map_or_absent("bridges");
    for (const auto& name : bridges.keys()) rig.bridges.push_back({name, bridges.map(name)});
    if (ConfigNode r = root.map_or_absent("record"); r.present()) {
      rig.record.file = r.text("file");
      rig.record.compression = r.choice_or("compression", {"none", "lz4", "zstd"}, "zstd");
      rig.record.chunk_bytes =
          static_cast<std::size_t>(r.integer_or("chunk_kib", 4096, {.min = 4, .max = 65536})) << 10;
      rig.record.budget_bytes =
          static_cast<std::size_t>(r.integer_or("budget_mib", 256, {.min = 1, .max = 65536})) << 20;
      rig.record.fail_on_drop = r.flag_or("fail_on_drop", false);
      r.finish();
    }
    rig.frames = read_frames(root.map_or_absent("frames"));
    rig.report = root.text_or("report", "");
    root.finish();
    check_names(rig, root);
    return rig;
  });
}

Result<RigConfig> load_rig(const std::filesystem::path& file, const std::vector<ConfigOverride>& overrides) {
  auto root = ConfigDocument::load(file, overrides);
  if (!root) return tl::unexpected<Error>(root.error());
  auto rig = parse_rig(*root, file);
  if (rig)
    for (const ConfigOverride& o : overrides) rig->overrides.push_back(o.path + "=" + o.value);
  return rig;
}

}  // namespace rigor
