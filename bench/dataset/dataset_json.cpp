#include "bench/dataset/dataset_json.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/dataset/coco_rle.h"
#include "sensor-hal/rig/rig.h"

namespace rigor::dataset {
namespace {

using nlohmann::json;

json pose_json(const Eigen::Isometry3d& T) {
  const Eigen::Quaterniond q(T.linear());
  return {{"position_m", {T.translation().x(), T.translation().y(), T.translation().z()}},
          {"quaternion_wxyz", {q.w(), q.x(), q.y(), q.z()}}};
}

json lens_json(const CameraModel& m) {
  json j{{"width_px", m.width_px}, {"height_px", m.height_px}, {"fx_px", m.fx_px},
         {"fy_px", m.fy_px},       {"cx_px", m.cx_px},         {"cy_px", m.cy_px}};
  if (m.projection == Projection::opencv) {
    j["projection"] = "opencv";
    j["distortion"] = {m.lens.k1, m.lens.k2, m.lens.p1, m.lens.p2,
                       m.lens.k3, m.lens.k4, m.lens.k5, m.lens.k6};
  } else {
    j["projection"] = "kannala_brandt";
    j["distortion"] = {m.fisheye.k1, m.fisheye.k2, m.fisheye.k3, m.fisheye.k4};
  }
  return j;
}

json instances_json(const DatasetView& view, std::uint32_t min_area_px) {
  json instances = json::array();
  const auto runs =
      coco::runs_of(view.labels.instance, view.width, view.height, view.labels.instances.size());
  for (const DatasetInstance& i : view.labels.instances) {
    json j{{"id", i.id},       {"node", i.node},    {"category_id", i.category},
           {"bbox", i.box_px}, {"area", i.area_px}, {"cut_off", i.cut_off}};
    if (!i.name.empty()) j["name"] = i.name;
    if (std::isfinite(i.median_depth_m)) j["depth_m"] = i.median_depth_m;
    if (i.area_px >= min_area_px) j["counts"] = coco::compress(runs[i.id - 1]);
    instances.push_back(std::move(j));
  }
  return instances;
}

}  // namespace

json described(const DatasetSample& sample) {
  json conditions = json::object();
  for (const auto& [key, value] : sample.conditions)
    if (!value.empty()) conditions[key] = value;
  json rejected = json::array();
  for (const DatasetRejection& r : sample.rejected)
    rejected.push_back({{"position_m", {r.position_m.x(), r.position_m.y(), r.position_m.z()}},
                        {"reason", r.reason},
                        {"detail", r.detail}});
  json j{
      {"sample", sample.index}, {"split", sample.split}, {"conditions", conditions}, {"rejected", rejected}};
  if (!sample.views.empty()) j["T_world_carrier"] = pose_json(sample.T_world_carrier);
  return j;
}

json described(const DatasetView& view, bool truth, std::uint32_t min_area_px) {
  json j{{"kind", kind_name(view.kind)}, {"T_world_sensor", pose_json(view.T_world_sensor)}};
  if (view.device != 0) j["device"] = view.device;
  if (view.lens) j["intrinsics"] = lens_json(*view.lens);
  if (view.kind == SampleKind::point_cloud) {
    j["points"] = view.points.size();
    return j;
  }
  if (view.kind == SampleKind::image) {
    j["exposure_us"] = view.image.exposure.seconds() * 1e6;
    j["gain_db"] = view.image.gain_db;
  }
  if (truth) j["instances"] = instances_json(view, min_area_px);
  return j;
}

}  // namespace rigor::dataset
