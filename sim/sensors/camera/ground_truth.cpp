#include "sim/sensors/camera/ground_truth.h"

#include <tbb/parallel_for.h>

#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <unordered_map>

namespace rigor {
namespace {

using render::NodeId;

/// Half of the step of the difference that flow is.
constexpr Duration kFlowStep = microseconds(500);

/// Where nodes are at three instants of a row. Asked once per node and row, nodes that stand still once.
class NodePoses {
 public:
  NodePoses(const render::SensorView& view, const ExposureTiming& timing) : view_(view), timing_(timing) {}

  /// Where a point of the node that is at p at the row's instant is one flow step before and after.
  struct Step {
    Eigen::Isometry3d before = Eigen::Isometry3d::Identity(), after = before;
    bool still = true;
  };
  const Step& at(NodeId node, int row) {
    if (const auto known = still_.find(node.value); known != still_.end()) {
      if (known->second) return none_;
    } else {
      const Eigen::Matrix4d a = pose(node, timing_.begin() - kFlowStep),
                            b = pose(node, timing_.end() + kFlowStep);
      const bool still = a == b && a == pose(node, timing_.at(0.5));
      still_[node.value] = still;
      if (still) return none_;
    }
    const int key = timing_.instant_of(0) == timing_.instant_of(row) ? 0 : row;
    auto [it, fresh] = moving_.try_emplace({node.value, key});
    if (fresh) {
      const BenchTime t = timing_.instant_of(row);
      const Eigen::Isometry3d T_node_world = view_.world.T_world_node(node, t).inverse();
      it->second.before = view_.world.T_world_node(node, t - kFlowStep) * T_node_world;
      it->second.after = view_.world.T_world_node(node, t + kFlowStep) * T_node_world;
      it->second.still = false;
    }
    return it->second;
  }

 private:
  Eigen::Matrix4d pose(NodeId node, BenchTime t) const { return view_.world.T_world_node(node, t).matrix(); }
  const render::SensorView& view_;
  const ExposureTiming& timing_;
  Step none_;
  std::unordered_map<std::uint64_t, bool> still_;
  std::map<std::pair<std::uint64_t, int>, Step> moving_;
};

}  // namespace

Status measure_truth(const TruthRequest& q, render::RayEngine& engine, const render::ContentWindow& window,
                     const render::SensorView& view, GroundTruth& out) {
  const auto& r = q.region;
  const auto width = static_cast<std::size_t>(r.width_px), height = static_cast<std::size_t>(r.height_px);
  const std::size_t n = width * height;
  const Eigen::Vector3d origin = q.motion.middle();
  std::vector<Eigen::Isometry3d> T_world_sensor(height);
  std::vector<float> time(height);
  for (std::size_t v = 0; v < height; ++v) {
    const int row = r.y_px + static_cast<int>(v);
    T_world_sensor[v] = q.motion.at(q.timing.middle_of(row));
    time[v] = static_cast<float>(window.time_of(q.timing.instant_of(row)));
  }
  std::vector<render::Ray> rays(n);
  tbb::parallel_for(std::size_t{0}, height, [&](std::size_t v) {
    const Eigen::Matrix3f turn = T_world_sensor[v].linear().cast<float>();
    const Eigen::Vector3f from = (T_world_sensor[v].translation() - origin).cast<float>();
    for (std::size_t u = 0; u < width; ++u) {
      render::Ray& ray = rays[v * width + u];
      const auto& pixel = q.lens.at(r.x_px + static_cast<int>(u), r.y_px + static_cast<int>(v));
      const Eigen::Vector3f d = pixel.lit()
                                    ? Eigen::Vector3f((turn * pixel.ray).normalized())
                                    : Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN());
      for (int i = 0; i < 3; ++i) {
        ray.origin[i] = from[i];
        ray.direction[i] = d[i];
      }
      ray.time = time[v];
    }
  });
  std::vector<render::Hit> hits(n);
  if (auto s = engine.cast({.origin = origin, .rays = rays}, hits); !s) return s;

  out.width = static_cast<std::uint32_t>(width);
  out.height = static_cast<std::uint32_t>(height);
  out.node.assign(n, 0);
  out.class_index.assign(n, 0);
  out.class_names.assign(1, "");
  out.range_m.assign(n, std::numeric_limits<float>::infinity());
  out.normal.assign(3 * n, 0.0F);
  out.flow_px.assign(2 * n, 0.0F);
  std::unordered_map<std::uint64_t, std::uint16_t> class_of;
  std::map<std::string, std::uint16_t, std::less<>> class_named{{"", std::uint16_t{0}}};
  NodePoses nodes(view, q.timing);
  Eigen::Isometry3d T_before_world, T_after_world;
  for (std::size_t v = 0; v < height; ++v) {
    const int row = r.y_px + static_cast<int>(v);
    const BenchTime t = q.timing.instant_of(row);
    // Asked of the pose function itself: differences of interpolated poses would say too little.
    const bool first = v == 0 || t != q.timing.instant_of(row - 1);
    if (first) {
      T_before_world = view.T_world_sensor(t - kFlowStep).inverse();
      T_after_world = view.T_world_sensor(t + kFlowStep).inverse();
    }
    const Eigen::Matrix3f to_sensor = T_world_sensor[v].linear().transpose().cast<float>();
    for (std::size_t u = 0; u < width; ++u) {
      const std::size_t i = v * width + u;
      const auto& pixel = q.lens.at(r.x_px + static_cast<int>(u), row);
      if (!pixel.lit()) {
        out.flow_px[2 * i] = out.flow_px[2 * i + 1] = std::numeric_limits<float>::quiet_NaN();
        continue;
      }
      const render::Hit& hit = hits[i];
      const Eigen::Vector3d d = T_world_sensor[v].linear() * pixel.ray.cast<double>();
      Eigen::Vector3d before, after;  // directions in the sensor's frame then
      if (hit.nothing()) {
        before = T_before_world.linear() * d;
        after = T_after_world.linear() * d;
      } else {
        out.range_m[i] = hit.range_m;
        out.node[i] = hit.node.value;
        auto known = class_of.find(hit.node.value);
        if (known == class_of.end()) {
          const std::string name = view.world.type_name(hit.node);
          const auto it =
              class_named.try_emplace(name, static_cast<std::uint16_t>(out.class_names.size())).first;
          if (it->second == out.class_names.size()) out.class_names.push_back(name);
          known = class_of.emplace(hit.node.value, it->second).first;
        }
        out.class_index[i] = known->second;
        const Eigen::Vector3f normal = to_sensor * Eigen::Map<const Eigen::Vector3f>(hit.normal);
        for (int k = 0; k < 3; ++k) out.normal[3 * i + static_cast<std::size_t>(k)] = normal[k];
        const Eigen::Vector3d p = T_world_sensor[v].translation() + static_cast<double>(hit.range_m) * d;
        const auto& step = nodes.at(hit.node, row);
        before = T_before_world * (step.still ? p : step.before * p);
        after = T_after_world * (step.still ? p : step.after * p);
      }
      const Eigen::Vector2d flow =
          (image_of(q.camera, after, kReferenceChannel) - image_of(q.camera, before, kReferenceChannel)) /
          (2 * kFlowStep.seconds());
      out.flow_px[2 * i] = static_cast<float>(flow.x());
      out.flow_px[2 * i + 1] = static_cast<float>(flow.y());
    }
  }
  return {};
}

}  // namespace rigor
