// Worlds: nodes by type and place, and their attributes as arrays.
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <fmt/format.h>

#include <limits>

#include "bench/files/installed_configs.h"
#include "bench/world/world_assembly.h"
#include "python/errors.h"
#include "python/module.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor::python {
namespace {

using world::NodeId;
using world::TypeId;
using world::Value;

Eigen::Matrix4d matrix_of(const world::Pose& pose) { return pose.matrix(); }

/// Flags, numbers and text as they are; vectors and lists as arrays; poses as 4 x 4 matrices.
py::object object_of(const Value& value) {
  switch (world::kind_of(value)) {
    case world::ValueKind::flag:
      return py::bool_(std::get<bool>(value));
    case world::ValueKind::integer:
      return py::int_(std::get<std::int64_t>(value));
    case world::ValueKind::number:
      return py::float_(std::get<double>(value));
    case world::ValueKind::text:
      return py::str(std::get<std::string>(value));
    case world::ValueKind::vector3:
      return py::cast(std::get<world::Vector3>(value));
    case world::ValueKind::pose:
      return py::cast(matrix_of(std::get<world::Pose>(value)));
    case world::ValueKind::motion:
      return py::cast(matrix_of(std::get<world::Motion>(value).T_parent_node));
    case world::ValueKind::numbers: {
      const auto numbers = std::get<world::Numbers>(value).span();
      return py::array_t<double>(static_cast<py::ssize_t>(numbers.size()), numbers.data());
    }
    case world::ValueKind::blob: {
      const auto bytes = std::get<world::Blob>(value).span();
      return py::bytes(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    }
  }
  return py::none();
}

Value value_from(const py::handle& object, world::ValueKind kind) {
  switch (kind) {
    case world::ValueKind::flag:
      return object.cast<bool>();
    case world::ValueKind::integer:
      return object.cast<std::int64_t>();
    case world::ValueKind::number:
      return object.cast<double>();
    case world::ValueKind::text:
      return object.cast<std::string>();
    case world::ValueKind::vector3:
      return object.cast<world::Vector3>();
    case world::ValueKind::pose:
      return world::Pose(object.cast<Eigen::Matrix4d>());
    case world::ValueKind::motion:
      return world::Motion{.T_parent_node = world::Pose(object.cast<Eigen::Matrix4d>())};
    case world::ValueKind::numbers:
      return world::Numbers(object.cast<std::vector<double>>());
    case world::ValueKind::blob: {
      const std::string bytes = object.cast<py::bytes>();
      const auto view = std::as_bytes(std::span<const char>(bytes.data(), bytes.size()));
      return world::Blob(std::vector<std::byte>(view.begin(), view.end()));
    }
  }
  throw std::invalid_argument("unknown kind of value");
}

class World {
 public:
  explicit World(const std::string& file) {
    Result<OpenedWorld> opened = [&] {
      const py::gil_scoped_release without_gil;
      return open_world(find_config(file));
    }();
    opened_ = value_of(std::move(opened));
    take_snapshot();
  }

  [[nodiscard]] std::size_t node_count() const { return now_.node_count(); }
  [[nodiscard]] std::uint64_t revision() const { return now_.revision(); }
  [[nodiscard]] const std::vector<std::string>& warnings() const { return opened_.warnings; }

  /// name -> (base, count with subtypes, meaning, abstract).
  [[nodiscard]] py::dict types() const {
    py::dict all;
    const world::Schema& schema = now_.schema();
    for (std::uint32_t t = 0; t < schema.type_count(); ++t) {
      const world::TypeSpec& spec = schema.type(TypeId{t});
      all[py::str(spec.name)] =
          py::make_tuple(t == 0 ? "" : spec.base, now_.count(TypeId{t}), spec.meaning, spec.abstract);
    }
    return all;
  }
  /// name -> (kind, unit, meaning).
  [[nodiscard]] py::dict attributes(const std::string& type) const {
    py::dict all;
    const world::Schema& schema = now_.schema();
    for (const auto id : schema.attributes(type_named(type))) {
      const world::AttributeInfo& info = schema.attribute(id);
      all[py::str(info.spec.name)] =
          py::make_tuple(std::string(world::name_of(info.kind())), info.spec.unit, info.spec.meaning);
    }
    return all;
  }

  [[nodiscard]] py::array_t<std::uint64_t> nodes(const std::string& type) const {
    return ids(now_.nodes(type_named(type)));
  }
  [[nodiscard]] py::array_t<std::uint64_t> in_radius(const std::string& type, const Eigen::Vector3d& centre,
                                                     double radius_m) const {
    return ids(now_.in_radius(type_named(type), centre, radius_m));
  }
  [[nodiscard]] py::array_t<std::uint64_t> in_box(const std::string& type, const Eigen::Vector3d& low,
                                                  const Eigen::Vector3d& high) const {
    return ids(now_.in_box(type_named(type), {low, high}));
  }
  [[nodiscard]] py::array_t<std::uint64_t> nearest(const std::string& type, const Eigen::Vector3d& centre,
                                                   std::size_t count) const {
    return ids(now_.nearest(type_named(type), centre, count));
  }

  [[nodiscard]] std::string type_of(std::uint64_t node) const {
    return now_.schema().type(type_id(node)).name;
  }
  [[nodiscard]] py::dict values(std::uint64_t node) const {
    py::dict all;
    const world::Schema& schema = now_.schema();
    for (const auto id : schema.attributes(type_id(node)))
      all[py::str(schema.attribute(id).spec.name)] = object_of(*now_.get(NodeId{node}, id));
    for (const auto& [name, value] : now_.dynamic_attributes(NodeId{node}))
      all[py::str(name)] = object_of(value);
    return all;
  }
  [[nodiscard]] py::object get(std::uint64_t node, const std::string& name) const {
    (void)type_id(node);
    const auto value = now_.get(NodeId{node}, name);
    if (!value) raise(no_attribute(node, name));
    return object_of(*value);
  }
  /// One attribute of many nodes: float64, int64, bool, (n, 3) or a list.
  [[nodiscard]] py::object column(const py::array_t<std::uint64_t>& nodes, const std::string& name) const {
    const auto id = nodes.unchecked<1>();
    const py::ssize_t n = id.shape(0);
    if (n == 0) return py::array_t<double>(py::ssize_t{0});
    py::list list;
    std::optional<world::ValueKind> kind;
    bool alike = true;
    for (py::ssize_t i = 0; i < n; ++i) {
      (void)type_id(id(i));
      const auto value = now_.get(NodeId{id(i)}, name);
      if (!value) raise(no_attribute(id(i), name));
      alike = alike && (!kind || *kind == world::kind_of(*value));
      kind = world::kind_of(*value);
      list.append(object_of(*value));
    }
    const bool plain = alike && (*kind == world::ValueKind::flag || *kind == world::ValueKind::integer ||
                                 *kind == world::ValueKind::number || *kind == world::ValueKind::vector3 ||
                                 *kind == world::ValueKind::pose);
    if (!plain) return list;
    return py::module_::import("numpy").attr("array")(list);
  }
  void set(std::uint64_t node, const std::string& name, const py::object& object) {
    const auto before = now_.get(NodeId{node}, name);
    (void)type_id(node);
    if (!before) raise(no_attribute(node, name));
    Value value = value_from(object, world::kind_of(*before));
    Status done;
    {
      const py::gil_scoped_release without_gil;
      world::Transaction tx = opened_.db->begin("set " + name);
      done = tx.set(NodeId{node}, name, std::move(value));
      if (done) done = tx.commit();
    }
    check(done);
    take_snapshot();
  }
  [[nodiscard]] Eigen::Matrix4d T_world_node(std::uint64_t node) const {
    (void)type_id(node);
    return matrix_of(now_.T_world_node(NodeId{node}, BenchTime{}));
  }

 private:
  void take_snapshot() { now_ = opened_.db->snapshot(); }
  [[nodiscard]] static py::array_t<std::uint64_t> ids(const std::vector<NodeId>& nodes) {
    py::array_t<std::uint64_t> array(static_cast<py::ssize_t>(nodes.size()));
    std::uint64_t* out = array.mutable_data();
    for (const NodeId n : nodes) *out++ = n.value;
    return array;
  }
  [[nodiscard]] TypeId type_named(const std::string& name) const {
    const world::Schema& schema = now_.schema();
    if (const auto type = schema.find_type(name)) return *type;
    std::vector<std::string> names;
    for (std::uint32_t t = 0; t < schema.type_count(); ++t) names.push_back(schema.type(TypeId{t}).name);
    raise({ErrorCode::bad_input, "type",
           fmt::format("expected a type of this world, got \"{}\"{}", name, did_you_mean(name, names))});
  }
  [[nodiscard]] TypeId type_id(std::uint64_t node) const {
    const auto type = now_.type_of(NodeId{node});
    if (!type)
      raise({ErrorCode::bad_input, "node", fmt::format("expected a node of this world, got {}", node)});
    return *type;
  }
  [[nodiscard]] Error no_attribute(std::uint64_t node, const std::string& name) const {
    std::vector<std::string> names;
    const world::Schema& schema = now_.schema();
    const TypeId type = type_id(node);
    for (const auto id : schema.attributes(type)) names.push_back(schema.attribute(id).spec.name);
    return {ErrorCode::bad_input, "attribute",
            fmt::format("expected an attribute of {}, got \"{}\"{}", schema.type(type).name, name,
                        did_you_mean(name, names))};
  }

  OpenedWorld opened_;
  world::Snapshot now_;
};

}  // namespace

void add_worlds(py::module_& m) {
  py::class_<World>(m, "World")
      .def(py::init<const std::string&>())
      .def_property_readonly("node_count", &World::node_count)
      .def_property_readonly("revision", &World::revision)
      .def_property_readonly("warnings", &World::warnings)
      .def("types", &World::types)
      .def("attributes", &World::attributes)
      .def("nodes", &World::nodes)
      .def("in_radius", &World::in_radius)
      .def("in_box", &World::in_box)
      .def("nearest", &World::nearest)
      .def("type_of", &World::type_of)
      .def("values", &World::values)
      .def("get", &World::get)
      .def("column", &World::column)
      .def("set", &World::set)
      .def("T_world_node", &World::T_world_node);
}

}  // namespace rigor::python
