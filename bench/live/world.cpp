#include "bench/live/world.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/files/picture.h"
#include "bench/live/world_values.h"
#include "sensor-hal/channel/event_text.h"
#include "sensor-hal/config/json_text.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sim/world/pose.h"
#include "sim/world/semantic_types.h"
#include "sim/world/store/value_codec.h"

namespace rigor::live {
namespace {

using nlohmann::json;

Result<double> number_in(const json& request, const char* key) {
  const auto it = request.find(key);
  if (it == request.end() || !it->is_number())
    return fail(ErrorCode::bad_input, key,
                "expected a number, got " + (it == request.end() ? "nothing" : it->dump().substr(0, 100)));
  return it->get<double>();
}

Result<world::NodeId> node_in(const json& request, const world::Snapshot& world) {
  const auto it = request.find("id");
  if (it == request.end() || !it->is_number_unsigned())
    return fail(ErrorCode::bad_input, "id", "expected the number of a node");
  const world::NodeId node{it->get<std::uint64_t>()};
  if (!world.contains(node))
    return fail(ErrorCode::not_found, "id", fmt::format("there is no node {}", node.value));
  return node;
}

/// west, east, south, north; empty: there is nothing.
struct Extent {
  double west = INFINITY, east = -INFINITY, south = INFINITY, north = -INFINITY;
  void add(double x, double y) {
    if (!std::isfinite(x + y)) return;
    west = std::min(west, x), east = std::max(east, x), south = std::min(south, y),
    north = std::max(north, y);
  }
  [[nodiscard]] bool empty() const { return !(west <= east); }
};

void add_shape(Extent& e, const Shape& s) {
  if (leans(s)) {
    const std::vector<double> ring = ground_plan(s);
    for (std::size_t i = 0; i + 1 < ring.size(); i += 2) e.add(ring[i], ring[i + 1]);
    return;
  }
  const auto at = s.T_world_node.translation();
  const double r = s.kind == Shape::Kind::plane  ? 0.5 * s.size_m.x()
                   : s.kind == Shape::Kind::tree ? s.crown_radius_m
                                                 : 0.5 * s.size_m.head<2>().norm();
  e.add(at.x() - r, at.y() - r);
  e.add(at.x() + r, at.y() + r);
  for (std::size_t i = 0; i + 1 < s.outline_m.size(); i += 2) e.add(s.outline_m[i], s.outline_m[i + 1]);
}

world::NodeId terrain_of(const world::Snapshot& world) {
  const auto nodes = world.nodes(world::types::Terrain(world.schema()).type);
  return nodes.empty() ? world::NodeId{} : nodes.front();
}

void add_terrain(Extent& e, const world::Snapshot& world) {
  const world::types::Terrain t(world.schema());
  world.for_each(t.type, [&](world::NodeId n) {
    const double x = *world.get(n, t.x_m), y = *world.get(n, t.y_m), s = *world.get(n, t.spacing_m);
    e.add(x, y);
    e.add(x + static_cast<double>(*world.get(n, t.columns) - 1) * s,
          y - static_cast<double>(*world.get(n, t.rows) - 1) * s);
  });
}

Result<Extent> area_in(const json& request) {
  Extent e;
  const auto it = request.find("area");
  if (it == request.end() || it->is_null()) return e;
  const auto pair = [&](const char* key, double& from, double& to) {
    if (!it->is_object() || !it->contains(key)) return false;
    const json& j = (*it)[key];
    if (!j.is_array() || j.size() != 2 || !j[0].is_number() || !j[1].is_number()) return false;
    from = j[0], to = j[1];
    return from < to && to - from < 1e6;
  };
  if (pair("x_m", e.west, e.east) && pair("y_m", e.south, e.north)) return e;
  return fail(ErrorCode::bad_input, "area",
              "expected {\"x_m\": [WEST, EAST], \"y_m\": [SOUTH, NORTH]} with less than 1000 km a side");
}

bool marked(const world::Snapshot& world, world::NodeId node) {
  const auto value = world.get(node, "marked");
  const bool* flag = value ? std::get_if<bool>(&*value) : nullptr;
  return flag && *flag;
}

std::vector<double> millimetres(std::vector<double> metres) {
  for (double& m : metres) m = std::round(1e3 * m) / 1e3;
  return metres;
}

double yaw_of(const Eigen::Vector3d& forward) { return std::atan2(forward.y(), forward.x()); }

}  // namespace

LiveWorld::LiveWorld(Simulation& simulation, const RunParts& parts, LiveTap& tap)
    : simulation_(simulation), tap_(tap), platforms_(simulation.world().platform_nodes()) {
  for (const auto& [name, node] : platforms_) platform_nodes_.insert(node);
  joints_ = simulation.world().joint_names();
  for (const WorldPlatform& p : simulation.platforms())
    for (const std::string& joint : p.model->joint_names()) joints_.push_back(p.name + "." + joint);
  for (const auto& c : parts.channels) {
    const ChannelEntry& entry = *c->entry;
    const BackendChoice& choice = entry.is_pair ? entry.simulated : entry.source;
    const bool lidar = entry.kind == SampleKind::point_cloud;
    if (choice.backend != "simulated" ||
        (!lidar && entry.kind != SampleKind::image && entry.kind != SampleKind::range_image))
      continue;
    Sensor s;
    s.channel = entry.name;
    s.optical = !lidar;
    const auto mount = catch_config([&] {
      return read_mount(choice.params, simulation.world(), lidar ? SensorAxes::forward : SensorAxes::optical);
    });
    if (!mount) continue;  // the assembly has refused it before
    s.mount = *mount;
    if (entry.kind == SampleKind::image)
      if (const auto sensor_model = load_camera(choice.params.base_dir() / choice.params.text("sensor")))
        s.camera = sensor_model->model;
    sensors_.push_back(std::move(s));
  }
}

world::Pose LiveWorld::T_world_sensor(const Sensor& sensor, const LiveTap::MotionAt& at,
                                      const world::Snapshot& world) const {
  const world::Pose T_parent = sensor.mount.at(at.t - tap_.t0());
  const int body = sensor.mount.body;
  if (body >= 0 && static_cast<std::uint32_t>(body) < at.motion.body_count)
    return isometry_of(at.motion.body[static_cast<std::size_t>(body)].at(at.t)) * T_parent;
  return sensor.mount.parent ? world.T_world_node(sensor.mount.parent, at.t) * T_parent : T_parent;
}

// ------------------------------------------------------------------ what moves

json LiveWorld::moving() const {
  const LiveTap::MotionAt at = tap_.motion();
  const world::Snapshot world = simulation_.world().snapshot();
  json j{{"bench_ns", at.t.ns()},
         {"t_s", at.count > 0 ? (at.t - tap_.t0()).seconds() : 0.0},
         {"revision", simulation_.world().changes()},
         {"bodies", json::array()},
         {"joints", json::array()},
         {"sensors", json::array()}};
  for (std::size_t i = 0; i < platforms_.size() && i < at.motion.body_count; ++i) {
    const BodyState& b = at.motion.body[i];
    const Pose pose = b.at(at.t);
    json parts = json::array();
    const world::NodeId root = platforms_[i].second;
    // The world is as a sensor measured it last: of its parts counts how they stand to the body.
    const world::Pose T = isometry_of(pose) * world.T_world_node(root, at.t).inverse();
    for (Shape& part : parts_of(world, at.t, root)) {
      part.T_world_node = T * part.T_world_node;
      parts.push_back(millimetres(ground_plan(part)));
    }
    j["bodies"].push_back({{"id", root.value},
                           {"name", platforms_[i].first},
                           {"x_m", pose.position_m[0]},
                           {"y_m", pose.position_m[1]},
                           {"z_m", pose.position_m[2]},
                           {"yaw_rad", yaw_of(isometry_of(pose).linear().col(0))},
                           {"quaternion_wxyz", pose.orientation_wxyz},
                           {"velocity_mps", b.velocity_mps},
                           {"parts_m", std::move(parts)}});
  }
  for (std::size_t i = 0; i < joints_.size() && i < at.motion.count; ++i)
    j["joints"].push_back({{"name", joints_[i]},
                           {"position_rad", at.motion.joint[i].at(at.t)},
                           {"rate_radps", at.motion.joint[i].rate_radps}});
  for (const Sensor& s : sensors_) {
    const world::Pose T = T_world_sensor(s, at, world);
    json sensor{{"channel", s.channel},
                {"x_m", T.translation().x()},
                {"y_m", T.translation().y()},
                {"z_m", T.translation().z()},
                {"yaw_rad", yaw_of(T.linear().col(s.optical ? 2 : 0))},
                {"horizontal_fov_rad", nullptr}};
    if (s.camera) {
      const auto edge = [&](double u) { return unproject_ray(*s.camera, {u, s.camera->cy_px}); };
      const auto left = edge(0), right = edge(s.camera->width_px - 1.0);
      if (left && right)
        sensor["horizontal_fov_rad"] = std::atan2(right->x, right->z) - std::atan2(left->x, left->z);
    }
    j["sensors"].push_back(std::move(sensor));
  }
  return j;
}

std::string LiveWorld::moving_key() const {
  json j = moving();
  j.erase("bench_ns");
  j.erase("t_s");
  return j.dump();
}

// ------------------------------------------------------------------ map

json LiveWorld::shape_json(const world::Snapshot& world, const Shape& s) const {
  const auto at = s.T_world_node.translation();
  json j{{"id", s.node.value}, {"type", type_name_of(world, s.node)}, {"name", name_of_node(world, s.node)}};
  j["x_m"] = at.x(), j["y_m"] = at.y(), j["z_m"] = at.z();
  if (leans(s)) {
    j["shape"] = "outline";
    j["outline_m"] = ground_plan(s);
    return j;
  }
  switch (s.kind) {
    case Shape::Kind::box:
    case Shape::Kind::cylinder:
    case Shape::Kind::plane:
      j["shape"] = s.kind == Shape::Kind::cylinder ? "cylinder" : "box";
      j["yaw_rad"] = yaw_of(s.T_world_node.linear().col(0));
      j["size_m"] = {s.size_m.x(), s.size_m.y(), s.size_m.z()};
      break;
    case Shape::Kind::tree: {
      const world::types::Tree tree(world.schema());
      j["shape"] = "tree";
      j["radius_m"] = s.radius_m;
      j["crown_radius_m"] = s.crown_radius_m;
      j["height_m"] = s.height_m;
      j["species"] = world.get_or_default(s.node, tree.species);
      j["dead"] = world.get_or_default(s.node, tree.dead);
      j["marked"] = marked(world, s.node);
      break;
    }
    case Shape::Kind::outline:
      j["shape"] = "outline";
      j["outline_m"] = s.outline_m;
      j["height_m"] = s.height_m;
      break;
    case Shape::Kind::line:
      j["shape"] = "line";
      j["outline_m"] = s.outline_m;
      j["width_m"] = s.width_m;
      break;
    case Shape::Kind::point:
      j["shape"] = "point";
      break;
  }
  return j;
}

json LiveWorld::ground_picture(const std::array<double, 4>& area, int size_px,
                               const GroundHeight& ground) const {
  const auto [west, east, south, north] = area;
  const double step = std::max(east - west, north - south) / size_px;
  const int width = std::max(1, static_cast<int>(std::lround((east - west) / step)));
  const int height = std::max(1, static_cast<int>(std::lround((north - south) / step)));
  const double dx = (east - west) / width, dy = (north - south) / height;
  std::vector<double> z(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  double low = INFINITY, high = -INFINITY;
  for (int row = 0; row < height; ++row)
    for (int column = 0; column < width; ++column) {
      const double v = ground(west + (column + 0.5) * dx, north - (row + 0.5) * dy);
      z[static_cast<std::size_t>(row * width + column)] = v;
      if (!std::isnan(v)) low = std::min(low, v), high = std::max(high, v);
    }
  if (!(low <= high)) return nullptr;
  // Lambert's shading with light from the north-west at 45°, which maps have, beside the height itself.
  std::vector<std::uint8_t> grey(z.size(), 0);
  const auto at = [&](int row, int column) {
    return z[static_cast<std::size_t>(std::clamp(row, 0, height - 1) * width +
                                      std::clamp(column, 0, width - 1))];
  };
  const Eigen::Vector3d light = Eigen::Vector3d(-1, 1, std::sqrt(2.0)).normalized();
  for (int row = 0; row < height; ++row)
    for (int column = 0; column < width; ++column) {
      const double slope_x = (at(row, column + 1) - at(row, column - 1)) / (2 * dx);
      const double slope_y = (at(row - 1, column) - at(row + 1, column)) / (2 * dy);
      const double lit = Eigen::Vector3d(-slope_x, -slope_y, 1).normalized().dot(light);
      const double shade =
          40 + 170 * std::max(0.0, lit) + 45 * (at(row, column) - low) / std::max(high - low, 1e-9);
      if (!std::isnan(shade))
        grey[static_cast<std::size_t>(row * width + column)] =
            static_cast<std::uint8_t>(std::clamp(shade, 1.0, 255.0));
    }
  const std::vector<std::uint8_t> png = png_of(grey, width, height, 1);
  return {{"x_m", {west, east}},
          {"y_m", {south, north}},
          {"z_m", {low, high}},
          {"width_px", width},
          {"height_px", height},
          {"png", world::store::base64(std::as_bytes(std::span<const std::uint8_t>(png)))}};
}

Result<json> LiveWorld::map(const json& request) const {
  auto area = area_in(request);
  if (!area) return tl::unexpected<Error>(area.error());
  // As a double first: what does not fit an int is not to be made one.
  const int size_px = static_cast<int>(
      std::clamp(request.value("ground_px", 256.0), 16.0, static_cast<double>(kMostGround_px)));
  const world::Snapshot world = simulation_.world().snapshot();
  const Ground ground = simulation_.world().ground();
  const GroundHeight height = [&](double x, double y) { return ground.height_m(x, y); };
  const bool everything = area->empty();
  Extent extent;
  json objects = json::array();
  std::size_t left_out = 0;
  for (const Shape& s : shapes_of(world, tap_.motion().t, height, platform_nodes_)) {
    Extent own;
    add_shape(own, s);
    if (!everything && (own.east < area->west || own.west > area->east || own.north < area->south ||
                        own.south > area->north))
      continue;
    extent.add(own.west, own.south);
    extent.add(own.east, own.north);
    if (objects.size() < kMostObjects)
      objects.push_back(shape_json(world, s));
    else
      ++left_out;
  }
  add_terrain(extent, world);
  if (everything && !extent.empty()) *area = extent;
  if (area->empty()) area->west = area->south = -10, area->east = area->north = 10;
  json j{{"extent", {{"x_m", {area->west, area->east}}, {"y_m", {area->south, area->north}}}},
         {"ground", nullptr},
         {"revision", simulation_.world().changes()},
         {"objects", std::move(objects)},
         {"left_out", left_out}};
  if (terrain_of(world))
    j["ground"] = ground_picture({area->west, area->east, area->south, area->north}, size_px, height);
  return j;
}

// ------------------------------------------------------------------ one node

Result<Hit> LiveWorld::pick_in_picture(const json& request, const world::Snapshot& world,
                                       const GroundHeight& ground) const {
  const std::string channel = request.value("channel", "");
  const auto u = number_in(request, "u_px"), v = number_in(request, "v_px");
  if (!u) return tl::unexpected<Error>(u.error());
  if (!v) return tl::unexpected<Error>(v.error());
  const Sensor* sensor = nullptr;
  std::vector<std::string> names;
  for (const Sensor& s : sensors_) {
    if (!s.camera) continue;
    names.push_back(s.channel);
    if (s.channel == channel) sensor = &s;
  }
  if (!sensor) {
    const std::string near = nearest(channel, names);
    return fail(ErrorCode::bad_input, "channel",
                fmt::format("expected a simulated camera or a pair with one, got \"{}\"{}", channel,
                            near.empty() ? "" : "; did you mean " + near + "?"));
  }
  const auto ray = unproject_ray(*sensor->camera, {*u, *v});
  if (!ray) return Hit{};  // no light comes there
  const LiveTap::MotionAt at = tap_.motion();
  const world::Pose T = T_world_sensor(*sensor, at, world);
  const Eigen::Vector3d direction = T.linear() * Eigen::Vector3d(ray->x, ray->y, ray->z);
  // From a little in front: what the sensor is mounted in is not what it looks at.
  constexpr double kNear_m = 0.01;
  const auto hit = first_hit(shapes_of(world, at.t, ground, {}), T.translation() + kNear_m * direction,
                             direction.normalized(), ground, terrain_of(world));
  return hit.value_or(Hit{});
}

Result<json> LiveWorld::pick(const json& request) const {
  const world::Snapshot world = simulation_.world().snapshot();
  const Ground terrain = simulation_.world().ground();
  const GroundHeight ground = [&](double x, double y) { return terrain.height_m(x, y); };
  Hit hit;
  if (request.contains("channel")) {
    auto found = pick_in_picture(request, world, ground);
    if (!found) return tl::unexpected<Error>(found.error());
    hit = *found;
  } else {
    const auto x = number_in(request, "x_m"), y = number_in(request, "y_m");
    if (!x) return tl::unexpected<Error>(x.error());
    if (!y) return tl::unexpected<Error>(y.error());
    hit = at_place(shapes_of(world, tap_.motion().t, ground, {}), *x, *y, ground, terrain_of(world))
              .value_or(Hit{});
  }
  if (!hit.node) return json{{"id", 0}};
  return json{{"id", hit.node.value},
              {"type", type_name_of(world, hit.node)},
              {"name", name_of_node(world, hit.node)},
              {"distance_m", hit.distance_m},
              {"point_m", {hit.point_m.x(), hit.point_m.y(), hit.point_m.z()}}};
}

Result<json> LiveWorld::node(const json& request) const {
  const world::Snapshot world = simulation_.world().snapshot();
  const auto node = node_in(request, world);
  if (!node) return tl::unexpected<Error>(node.error());
  return node_json(world, *node);
}

Result<json> LiveWorld::set(const json& request) {
  const world::Snapshot world = simulation_.world().snapshot();
  const auto node = node_in(request, world);
  if (!node) return tl::unexpected<Error>(node.error());
  if (!request.contains("attribute") || !request["attribute"].is_string() || !request.contains("value"))
    return fail(ErrorCode::bad_input, "", "expected an `attribute` by its name and a `value`");
  const std::string attribute = request["attribute"];
  const auto kind = kind_of_attribute(world, *node, attribute);
  if (!kind) return tl::unexpected<Error>(kind.error());
  auto value = value_from(request["value"], *kind, attribute);
  if (!value) return tl::unexpected<Error>(value.error());
  const auto before = world.get(*node, attribute);
  if (auto s = simulation_.edit(*node, attribute, *value); !s) return tl::unexpected<Error>(s.error());
  const auto text = [](const world::Value& v) {
    return value_json(v).dump(-1, ' ', false, json::error_handler_t::replace);
  };
  (void)tap_.note(kEventWorldEdit, static_cast<double>(node->value),
                  fmt::format("node {} ({} {}): {} = {}, was {}", node->value, type_name_of(world, *node),
                              name_of_node(world, *node), attribute, text(*value).substr(0, 120),
                              before ? text(*before).substr(0, 120) : "nothing"));
  return json{{"revision", simulation_.world().changes()}, {"value", value_json(*value)}};
}

// ------------------------------------------------------------------ services

std::string service_answer(const std::string& request,
                           const std::function<Result<json>(const json&)>& answer) {
  const auto answered = [&]() -> Result<json> {
    const auto j = parse_json(request);
    if (!j) return tl::unexpected<Error>(j.error());
    if (!j->is_object()) return fail(ErrorCode::bad_input, "", "expected an object");
    try {
      return answer(*j);
    } catch (const json::exception& e) {  // a key of another type than expected
      return fail(ErrorCode::bad_input, "", std::string("the request is not as expected: ") + e.what());
    } catch (const std::exception& e) {
      return fail(ErrorCode::internal, "", e.what());
    }
  };
  const auto result = answered();
  const json reply = result ? json{{"ok", true}, {"result", *result}}
                            : json{{"ok", false},
                                   {"error",
                                    {{"code", result.error().code == ErrorCode::not_found   ? "not_found"
                                              : result.error().code == ErrorCode::bad_input ? "bad_input"
                                                                                            : "failed"},
                                     {"message", result.error().text()}}}};
  return reply.dump(-1, ' ', false, json::error_handler_t::replace);
}

}  // namespace rigor::live
