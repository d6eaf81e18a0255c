#include "bench/dataset/dataset.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "bench/dataset/carrier.h"
#include "bench/dataset/dataset_device.h"
#include "bench/files/manifest.h"
#include "sensor-hal/models/philox.h"
#include "sensor-hal/rig/rig.h"
#include "sim/platform/ground.h"

namespace rigor {
namespace {

using dataset::Draw;
using dataset::Variation;

class Seconds {
 public:
  explicit Seconds(double& sum) : sum_(sum), begin_(std::chrono::steady_clock::now()) {}
  ~Seconds() { sum_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count(); }
  Seconds(const Seconds&) = delete;
  Seconds& operator=(const Seconds&) = delete;

 private:
  double& sum_;
  std::chrono::steady_clock::time_point begin_;
};

bool looks(SampleKind kind) {
  return kind == SampleKind::image || kind == SampleKind::range_image || kind == SampleKind::point_cloud;
}

const BackendChoice& simulated_side(const ChannelEntry& c) { return c.is_pair ? c.simulated : c.source; }

Result<std::vector<const ChannelEntry*>> find_channels(const RigConfig& rig,
                                                       const std::vector<std::string>& wanted) {
  std::vector<const ChannelEntry*> out;
  std::vector<std::string> names;
  for (const ChannelEntry& c : rig.channels)
    if (looks(c.kind) && simulated_side(c).backend == "simulated") {
      names.push_back(c.name);
      if (wanted.empty()) out.push_back(&c);
    }
  if (names.empty())
    return fail(ErrorCode::bad_input, rig.file.string(),
                "expected a simulated channel of kind image, range_image or point_cloud, found none");
  for (const std::string& name : wanted) {
    if (std::find(names.begin(), names.end(), name) == names.end())
      return fail(ErrorCode::bad_input, "channels",
                  fmt::format("expected simulated channels that look ({}), got \"{}\"",
                              fmt::join(names, ", "), name));
    if (std::count(wanted.begin(), wanted.end(), name) > 1)
      return fail(ErrorCode::bad_input, "channels",
                  fmt::format("expected each channel once, got \"{}\" again", name));
    for (const ChannelEntry& c : rig.channels)
      if (c.name == name) out.push_back(&c);
  }
  return out;
}

}  // namespace

struct Dataset::Impl {
  DatasetOptions options;
  RigConfig rig;
  std::unique_ptr<Simulation> simulation;
  std::vector<DatasetCategory> categories;
  std::vector<Channel> channels;
  std::vector<std::unique_ptr<dataset::Device>> devices;  ///< by channel
  std::optional<dataset::Carrier> carrier;
  dataset::PoseSource poses;
  std::unique_ptr<ClearanceProbe> probe;
  std::optional<Ground> ground;
  /// Attributes that variations set, as they are in the world itself: `Atmosphere.wetness` and its value.
  std::vector<std::pair<std::string, std::string>> as_opened;
  std::vector<std::pair<std::string, std::string>> assigned;  ///< as they are now
  std::uint64_t size = 0, next = 0;
  DatasetTimes times;

  Status open();
  Status read_variations();
  Result<std::string> value_in_world(const Variation& v, const std::string& attribute) const;
  Status set_conditions(const std::vector<std::pair<std::string, std::string>>& conditions,
                        WorldMotion& motion);
  Result<bool> place(DatasetSample& sample, WorldMotion& motion);
  Result<std::optional<DatasetRejection>> judge(const Eigen::Isometry3d& T_world_carrier, bool on_ground,
                                                const WorldMotion& motion);
};

/// What an attribute has in the world, as text; so that a sample can have it again.
Result<std::string> Dataset::Impl::value_in_world(const Variation& v, const std::string& key) const {
  const world::Snapshot world = simulation->world().snapshot();
  const auto dot = key.find('.');
  const std::string type_name = key.substr(0, dot), name = key.substr(dot + 1);
  const auto wrong = [&](std::string what) {
    return fail(ErrorCode::bad_input, v.written.where, std::move(what));
  };
  const auto type = world.schema().find_type(type_name);
  if (!type) {
    std::vector<std::string> names;
    for (std::uint32_t i = 0; i < world.schema().type_count(); ++i)
      names.push_back(world.schema().type(world::TypeId{i}).name);
    const std::string near = nearest(type_name, names);
    return wrong(fmt::format("expected a type of the world, got {}{}", type_name,
                             near.empty() ? "" : "; did you mean " + near + "?"));
  }
  const auto attribute = world.schema().find_attribute(*type, name);
  if (!attribute) {
    std::vector<std::string> names;
    for (const world::AttributeId a : world.schema().attributes(*type))
      names.push_back(world.schema().attribute(a).spec.name);
    const std::string near = nearest(name, names);
    return wrong(fmt::format("expected an attribute of {} ({}), got {}{}", type_name, fmt::join(names, ", "),
                             name, near.empty() ? "" : "; did you mean " + near + "?"));
  }
  const world::AttributeInfo& info = world.schema().attribute(*attribute);
  world::Value value = info.spec.default_value;
  const auto nodes = world.nodes(*type);
  if (nodes.empty() && type_name != "Atmosphere")
    return wrong(fmt::format("expected a node of type {} in the world, found none", type_name));
  if (!nodes.empty()) value = *world.get(nodes.front(), *attribute);
  if (const auto* number = std::get_if<double>(&value)) return fmt::format("{:.17g}", *number);
  if (const auto* number = std::get_if<std::int64_t>(&value)) return fmt::format("{}", *number);
  if (const auto* flag = std::get_if<bool>(&value)) return std::string(*flag ? "true" : "false");
  if (const auto* text = std::get_if<std::string>(&value)) return *text;
  return wrong(
      fmt::format("expected an attribute that is a number, a flag or a word, {} is of another kind", name));
}

Status Dataset::Impl::read_variations() {
  const auto add = [&](const Variation& v, const std::string& key) -> Status {
    for (const auto& [known, value] : as_opened)
      if (known == key) return {};
    auto value = value_in_world(v, key);
    if (!value) return tl::unexpected<Error>(value.error());
    as_opened.emplace_back(key, *value);
    return {};
  };
  for (std::size_t i = 0; i < options.vary.size(); ++i) {
    const Variation& v = options.vary[i];
    for (std::size_t k = 0; k < i; ++k)
      if (options.vary[k].key == v.key)
        return fail(ErrorCode::bad_input, v.written.where, "expected each key once, got " + v.key + " again");
    switch (v.of) {
      case Variation::Of::weather:
        for (const auto& [attribute, value] : dataset::weather_texts("clear"))
          if (auto s = add(v, "Atmosphere." + attribute); !s) return s;
        break;
      case Variation::Of::attribute: {
        if (auto s = add(v, v.key); !s) return s;
        // Values that the world refuses are found now.
        std::vector<std::string> tried{v.key + "=" + v.values.at(0), v.key + "=" + v.values.at(1)};
        for (const std::string& word : v.values.words()) tried.push_back(v.key + "=" + word);
        for (const std::string& assignment : tried)
          if (auto s = simulation->assign({assignment}); !s)
            return fail(ErrorCode::bad_input, v.written.where, s.error().message);
        break;
      }
      case Variation::Of::joint:
        if (auto joint = simulation->joint(v.name); !joint)
          return fail(ErrorCode::bad_input, v.written.where, joint.error().message);
        break;
      case Variation::Of::channel: {
        const auto it = std::find_if(channels.begin(), channels.end(),
                                     [&](const Channel& c) { return c.name == v.name; });
        if (it == channels.end() || it->kind != SampleKind::image)
          return fail(ErrorCode::bad_input, v.written.where,
                      fmt::format("expected a channel of the dataset of kind image, got \"{}\"", v.name));
        break;
      }
    }
  }
  return {};
}

Status Dataset::Impl::open() {
  auto loaded = load_rig(options.rig, options.overrides);
  if (!loaded) return tl::unexpected<Error>(loaded.error());
  rig = std::move(*loaded);
  if (rig.simulation.world.empty())
    return fail(ErrorCode::bad_input, options.rig.string(), "expected `simulation.world`, found none");
  const auto entries = find_channels(rig, options.channels);
  if (!entries) return tl::unexpected<Error>(entries.error());
  auto source = dataset::PoseSource::create(options.poses);
  if (!source) return tl::unexpected<Error>(source.error());
  poses = std::move(*source);
  size = options.samples > 0 ? options.samples : poses.listed();
  if (size == 0)
    return fail(ErrorCode::bad_input, "samples", "expected how many samples, got nothing; give --sample N");

  auto opened = Simulation::open(rig.simulation);
  if (!opened) return tl::unexpected<Error>(opened.error());
  simulation = std::move(*opened);
  ground.emplace(simulation->world().ground());

  std::vector<dataset::MountedChannel> mounted;
  for (const ChannelEntry* entry : *entries)
    mounted.push_back({entry->name, entry->kind, simulated_side(*entry).params});
  auto on = dataset::Carrier::of(mounted, *simulation);
  if (!on) return tl::unexpected<Error>(on.error());
  carrier.emplace(std::move(*on));

  bool any_drawn = false;
  Error not_drawn;
  for (std::size_t i = 0; i < entries->size(); ++i) {
    const ChannelEntry& entry = *(*entries)[i];
    auto device = dataset::Device::create({.rig = rig,
                                           .entry = entry,
                                           .params = simulated_side(entry).params,
                                           .simulation = *simulation,
                                           .mount = carrier->mount(i),
                                           .seed = options.seed,
                                           .renderer = options.renderer,
                                           .truth = options.truth});
    if (!device) return tl::unexpected<Error>(device.error());
    channels.push_back({entry.name, entry.kind, false});
    if (options.draw_devices) {
      const auto drawn = (*device)->can_be_drawn();
      channels.back().drawn = drawn.has_value();
      if (drawn)
        any_drawn = true;
      else
        not_drawn = drawn.error();
    }
    devices.push_back(std::move(*device));
  }
  if (options.draw_devices && !any_drawn) return tl::unexpected<Error>(not_drawn);
  if (options.clearance_m > 0 && options.poses.kind != dataset::PoseChoice::Kind::rig) {
    auto made = simulation->clearance_probe();
    if (!made) return tl::unexpected<Error>(made.error());
    probe = std::move(*made);
  }
  if (auto s = read_variations(); !s) return s;
  categories = dataset_categories(simulation->world().snapshot());
  return {};
}

Status Dataset::Impl::set_conditions(const std::vector<std::pair<std::string, std::string>>& conditions,
                                     WorldMotion& motion) {
  std::vector<std::pair<std::string, std::string>> wanted = as_opened;
  const auto set = [&](const std::string& key, const std::string& value) {
    for (auto& [name, now] : wanted)
      if (name == key) now = value;
  };
  for (std::size_t i = 0; i < conditions.size(); ++i)
    if (options.vary[i].of == Variation::Of::weather)
      for (const auto& [attribute, value] : dataset::weather_texts(conditions[i].second))
        set("Atmosphere." + attribute, value);
  for (std::size_t i = 0; i < conditions.size(); ++i) {
    const Variation& v = options.vary[i];
    const std::string& value = conditions[i].second;
    if (v.of == Variation::Of::attribute && !value.empty()) set(v.key, value);
    if (v.of == Variation::Of::joint) {
      const auto joint = simulation->joint(v.name);
      if (!joint) return tl::unexpected<Error>(joint.error());
      motion.joint[*joint].position_rad = std::stod(value) * std::numbers::pi / 180;
    }
  }
  std::vector<std::string> assignments;
  for (std::size_t i = 0; i < wanted.size(); ++i)
    if (assigned.empty() || assigned[i].second != wanted[i].second)
      assignments.push_back(wanted[i].first + "=" + wanted[i].second);
  if (assignments.empty()) return {};
  if (auto s = simulation->assign(assignments); !s) return s;
  assigned = std::move(wanted);
  return {};
}

Result<std::optional<DatasetRejection>> Dataset::Impl::judge(const Eigen::Isometry3d& T, bool on_ground,
                                                             const WorldMotion& motion) {
  const Eigen::Vector3d& p = T.translation();
  if (!p.allFinite()) return std::optional(DatasetRejection{{p.x(), p.y(), 0}, "off the terrain", ""});
  if (!on_ground) {
    const double ground_m = ground->height_m(p.x(), p.y());
    if (p.z() < ground_m)
      return std::optional(
          DatasetRejection{p, "below the ground", fmt::format("by {:.3g} m", ground_m - p.z())});
  }
  if (!probe) return std::optional<DatasetRejection>{};
  for (std::size_t i = 0; i < devices.size(); ++i) {
    const Eigen::Vector3d eye = (T * carrier->T_carrier_sensor(i)).translation();
    auto near = probe->nearest(motion, eye, options.clearance_m, carrier->platform());
    if (!near) return tl::unexpected<Error>(near.error());
    if (!*near) continue;
    const ClearanceProbe::Obstacle& o = **near;
    if (o.range_m == 0)
      return std::optional(
          DatasetRejection{p, "inside " + o.type, fmt::format("{} {}", o.type, o.node.value)});
    return std::optional(DatasetRejection{p, "near " + o.type,
                                          fmt::format("{} {} at {:.2f} m", o.type, o.node.value, o.range_m)});
  }
  return std::optional<DatasetRejection>{};
}

/// False: every pose was rejected.
Result<bool> Dataset::Impl::place(DatasetSample& sample, WorldMotion& motion) {
  if (options.poses.kind == dataset::PoseChoice::Kind::rig) {
    sample.T_world_carrier = carrier->T_world_rig();
    carrier->move(sample.T_world_carrier, motion);
    return true;
  }
  const bool drawn = poses.listed() == 0;
  for (std::uint32_t attempt = 0; attempt < (drawn ? kAttempts : 1); ++attempt) {
    const dataset::WantedPose wanted = poses.at(options.seed, sample.index, attempt);
    const Eigen::Isometry3d T = carrier->stand(wanted, *ground);
    carrier->move(T, motion);
    auto rejection = judge(T, !wanted.z_m.has_value(), motion);
    if (!rejection) return tl::unexpected<Error>(rejection.error());
    if (!*rejection) {
      sample.T_world_carrier = T;
      return true;
    }
    sample.rejected.push_back(std::move(**rejection));
  }
  return false;
}

Dataset::Dataset(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Dataset::~Dataset() = default;

Result<std::unique_ptr<Dataset>> Dataset::create(const DatasetOptions& options) {
  auto impl = std::make_unique<Impl>();
  impl->options = options;
  if (auto s = impl->open(); !s) return tl::unexpected<Error>(s.error());
  return std::unique_ptr<Dataset>(new Dataset(std::move(impl)));
}

const DatasetOptions& Dataset::options() const { return impl_->options; }
std::uint64_t Dataset::size() const { return impl_->size; }
const std::vector<DatasetCategory>& Dataset::categories() const { return impl_->categories; }
const std::vector<Dataset::Channel>& Dataset::channels() const { return impl_->channels; }
const RigConfig& Dataset::rig() const { return impl_->rig; }
const DatasetTimes& Dataset::times() const { return impl_->times; }
void Dataset::seek(std::uint64_t index) { impl_->next = index; }

Result<DatasetSample> Dataset::sample(std::uint64_t index) {
  Impl& d = *impl_;
  if (index >= d.size)
    return fail(ErrorCode::bad_input, "sample",
                fmt::format("expected one of 0 to {}, got {}", d.size - 1, index));
  DatasetSample sample;
  sample.index = index;
  const double u = dataset::draw(d.options.seed, Draw::split, index, 0)[0];
  const auto& weights = d.options.split;
  const double whole = weights[0] + weights[1] + weights[2];
  sample.split = u * whole < weights[0] ? "train" : u * whole < weights[0] + weights[1] ? "val" : "test";
  sample.conditions = dataset::draw_conditions(d.options.vary, d.options.seed, index);

  WorldMotion motion = d.simulation->motion_at_rest();
  {
    const Seconds time(d.times.world_s);
    if (auto s = d.set_conditions(sample.conditions, motion); !s) return tl::unexpected<Error>(s.error());
  }
  {
    const Seconds time(d.times.pose_s);
    auto placed = d.place(sample, motion);
    if (!placed) return tl::unexpected<Error>(placed.error());
    if (!*placed) return sample;
  }
  for (std::size_t i = 0; i < d.devices.size(); ++i) {
    dataset::Device& device = *d.devices[i];
    std::uint64_t draw = 0;
    if (d.channels[i].drawn)
      draw =
          1 + static_cast<std::uint64_t>(dataset::draw(d.options.seed, Draw::device, index,
                                                       models::channel_id_from_name(d.channels[i].name))[0] *
                                         2147483648.0);
    dataset::Exposure exposure;
    for (std::size_t k = 0; k < d.options.vary.size(); ++k) {
      const Variation& v = d.options.vary[k];
      if (v.of != Variation::Of::channel || v.name != d.channels[i].name) continue;
      (v.attribute == "gain_db" ? exposure.gain_db : exposure.exposure_us) =
          std::stod(sample.conditions[k].second);
    }
    {
      const Seconds time(d.times.world_s);
      if (auto s = device.become(draw); !s) return tl::unexpected<Error>(s.error());
    }
    DatasetView view;
    {
      const Seconds time(d.times.capture_s);
      if (auto s = device.capture(index, motion, exposure, view); !s) return tl::unexpected<Error>(s.error());
    }
    view.T_world_sensor = sample.T_world_carrier * d.carrier->T_carrier_sensor(i);
    const Seconds time(d.times.label_s);
    if (d.options.truth) {
      if (view.lens) view.depth_m = device.depth_of(view.truth);
      view.labels = label(view.truth, view.depth_m, d.categories, d.simulation->world().snapshot());
      if (view.kind == SampleKind::point_cloud) view.labels.instances.clear();
    }
    sample.views.push_back(std::move(view));
  }
  return sample;
}

Result<std::optional<DatasetSample>> Dataset::next() {
  while (impl_->next < impl_->size) {
    auto made = sample(impl_->next++);
    if (!made) return tl::unexpected<Error>(made.error());
    if (!made->views.empty()) return std::optional<DatasetSample>(std::move(*made));
  }
  return std::optional<DatasetSample>{};
}

nlohmann::json Dataset::manifest() const {
  InputFiles files;
  files.add_rig(impl_->rig);
  if (!impl_->options.poses.file.empty()) files.add("poses", impl_->options.poses.file);
  const nlohmann::json inputs = input_digests(files, impl_->rig.file);
  nlohmann::json channels = nlohmann::json::array();
  for (const Channel& c : impl_->channels)
    channels.push_back({{"name", c.name}, {"kind", kind_name(c.kind)}, {"drawn", c.drawn}});
  return {{"format", "rigor dataset"},
          {"format_version", 1},
          {"rigor_version", RIGOR_VERSION},
          {"options", impl_->options.json()},
          {"samples", impl_->size},
          {"inputs", inputs},
          {"channels", channels}};
}

}  // namespace rigor
