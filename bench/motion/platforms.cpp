#include "bench/motion/platforms.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/sample_codec.h"
#include "sim/platform/harvester.h"
#include "sim/platform/platform_yaml.h"
#include "sim/platform/trajectory.h"

namespace rigor {
namespace {

PlatformStart read_start(const PlatformEntry& entry, std::uint64_t seed) {
  PlatformStart start;
  start.seed = seed;
  start.name = entry.name;
  ConfigNode n = entry.node.map_or_absent("T_world_start");
  const std::vector<double> position = n.numbers_or("position_m", {0, 0});
  start.x_m = position[0];
  start.y_m = position[1];
  start.yaw_rad = n.number_or("yaw_deg", 0) * std::numbers::pi / 180;
  n.finish();
  return start;
}

Result<std::vector<TimedPose>> recorded_poses(const std::string& file, const std::string& channel) {
  auto reader = record::McapReader::open(file);
  if (!reader) return tl::unexpected<Error>(reader.error());
  std::vector<TimedPose> poses;
  std::set<std::string> topics, all;
  for (const auto& [id, c] : (*reader)->channels()) {
    all.insert(c.topic);
    if (c.topic.starts_with("/" + channel + "/")) topics.insert(c.topic);
  }
  for (const std::string& topic : topics) {
    record::SampleDecoder decoder(topic);
    auto cursor = (*reader)->messages({.topics = {topic}, .order = record::MessageOrder::file});
    record::MessageView view;
    Sample sample;
    BenchTime first;
    while (true) {
      const auto more = cursor.next(view);
      if (!more) return tl::unexpected<Error>(more.error());
      if (!*more) break;
      const auto whole = decoder.take(view);
      if (!whole) break;  // not a topic of samples
      if (!*whole) continue;
      if (auto s = decoder.fill(sample); !s) return tl::unexpected<Error>(s.error());
      const auto* pose = sample.as<Pose>();
      if (!pose) break;
      if (poses.empty()) first = decoder.stamp().t_capture;
      const double t_s = (decoder.stamp().t_capture - first).seconds();
      if (poses.empty() || t_s > poses.back().t_s) poses.push_back({t_s, *pose});
    }
    if (!poses.empty()) return poses;
  }
  return fail(ErrorCode::bad_input, file,
              fmt::format("expected poses of a channel {}, found none; the topics are: {}", channel,
                          fmt::join(all, ", ")));
}

std::shared_ptr<Platform> make_trajectory(const PlatformEntry& entry) {
  const ConfigNode& n = entry.node;
  auto poses = n.has("recording")
                   ? recorded_poses((n.base_dir() / n.text("recording")).string(), n.text("poses_of"))
                   : read_poses_csv(n.base_dir() / n.text("poses"));
  if (!poses) throw n.error(n.has("recording") ? "recording" : "poses", poses.error().text());
  const bool quintic = n.choice_or("spline", {"cubic", "quintic"}, "cubic") == "quintic";
  auto path = Trajectory::make(*poses, quintic ? PathSpline::quintic : PathSpline::cubic);
  if (!path) throw n.error("", path.error().text());
  return std::make_shared<TrajectoryPlatform>(std::move(*path));
}

template <class Config>
Config model_or_default(const ConfigNode& n, Result<Config> (*load)(const std::filesystem::path&)) {
  if (!n.has("model")) return Config{};
  auto platform_model = load(n.base_dir() / n.text("model"));
  if (!platform_model) throw ConfigError(platform_model.error());
  return std::move(*platform_model);
}

std::shared_ptr<Platform> make_one(const PlatformEntry& entry, std::uint64_t seed, const Ground& ground,
                                   const std::vector<Stem>& stems) {
  const ConfigNode& n = entry.node;
  const std::string model = n.choice("kind", {"skid-steer", "harvester", "trajectory"});
  if (model == "trajectory") return make_trajectory(entry);
  const PlatformStart start = read_start(entry, seed);
  if (std::isnan(ground.height_m(start.x_m, start.y_m)))
    throw n.error(
        "T_world_start",
        fmt::format("expected a place on the terrain, got {:g}, {:g}, where there is none; `rigor world "
                    "info` says how far it reaches",
                    start.x_m, start.y_m));
  if (model == "harvester")
    return std::make_shared<Harvester>(model_or_default(n, load_harvester), start, ground, stems);
  return std::make_shared<SkidSteer>(model_or_default(n, load_skid_steer), start, ground);
}

class PoseProvider final : public SampleProvider {
 public:
  PoseProvider(std::size_t body, std::string frame_id) : body_(body), frame_id_(std::move(frame_id)) {}
  [[nodiscard]] Geometry geometry() const override { return {SampleKind::pose, 0, 0, 0, frame_id_}; }
  [[nodiscard]] Status capture(const Request& request, Sample& sample) override {
    if (body_ >= request.motion.body_count)
      return fail(ErrorCode::internal, frame_id_,
                  "a pose was asked of a platform that the motion does not have");
    sample.info = request.motion.body[body_].at(request.t_capture);
    sample.size_bytes = 0;
    return {};
  }

 private:
  std::size_t body_;
  std::string frame_id_;
};

}  // namespace

Result<std::vector<WorldPlatform>> make_platforms(const SimulationConfig& config, const Ground& ground,
                                                  const std::vector<Stem>& stems, std::size_t world_joints) {
  return catch_config([&] {
    std::vector<WorldPlatform> all;
    std::size_t joints = world_joints;
    for (const PlatformEntry& entry : config.platforms) {
      const ConfigNode& n = entry.node;
      if (all.size() == WorldMotion::kMaxBodies)
        throw n.error("", fmt::format("expected at most {} platforms", WorldMotion::kMaxBodies));
      WorldPlatform p;
      p.name = entry.name;
      p.visible = n.flag_or("visible", true);
      p.model = make_one(entry, config.seed, ground, stems);
      p.first_joint = static_cast<std::uint32_t>(joints);
      joints += p.model->joint_names().size();
      if (joints > WorldMotion::kMax)
        throw n.error("", fmt::format("expected at most {} joints of the world and its platforms, got {}",
                                      WorldMotion::kMax, joints));
      (void)n.text_or("channel", "");
      (void)n.text_or("felled", "");
      n.finish();
      all.push_back(std::move(p));
    }
    return all;
  });
}

void add_platform_motion(WorldMotion& motion, const WorldPlatform& platform, std::size_t body,
                         BenchTime t) noexcept {
  const PlatformMotion m = platform.model->motion_at(t);
  motion.body[body] = m.body;
  motion.body_count = std::max(motion.body_count, static_cast<std::uint32_t>(body + 1));
  for (std::uint32_t i = 0; i < m.joint_count; ++i) motion.joint[platform.first_joint + i] = m.joint[i];
  motion.count = std::max(motion.count, platform.first_joint + m.joint_count);
}

std::shared_ptr<SampleProvider> make_pose_provider(std::size_t body, std::string frame_id) {
  return std::make_shared<PoseProvider>(body, std::move(frame_id));
}

}  // namespace rigor
