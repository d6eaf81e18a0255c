// Thousands of random transactions against a naive model: full state, old snapshots, change sets, undo and
// redo, queries of space.
#include <gtest/gtest.h>

#include <cmath>
#include <deque>
#include <limits>
#include <random>

#include "rt-core/sanitizers.h"
#include "tests/sim/world/graph/model.h"

namespace rigor::world {
namespace {

using testing_model::apply;
using testing_model::difference;
using testing_model::Model;
using testing_model::ModelNode;

constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

void define(Database& db) {
  ASSERT_TRUE(db.add_attribute(TypeId{0}, {.name = "name", .default_value = std::string()}));
  ASSERT_TRUE(db.define(
      TypeSpec{.name = "Thing",
               .abstract = true,
               .attributes = {{.name = "count", .default_value = std::int64_t{0}, .min = -5, .max = 50},
                              {.name = "load", .default_value = 1.5, .transient = true},
                              {.name = "on", .default_value = false}}}));
  ASSERT_TRUE(db.define(TypeSpec{
      .name = "Dot",
      .base = "Thing",
      .attributes = {{.name = "position", .default_value = Vector3(0, 0, 0), .nan_is_unknown = true},
                     {.name = "weights", .default_value = Numbers{1, 2}},
                     {.name = "word", .default_value = std::string("a"), .choices = {"a", "b", "c"}}},
      .place_attribute = "position"}));
  ASSERT_TRUE(db.define(
      TypeSpec{.name = "BigDot", .base = "Dot", .attributes = {{.name = "bytes", .default_value = Blob{}}}}));
  ASSERT_TRUE(
      db.define(TypeSpec{.name = "Body",
                         .base = "Thing",
                         .attributes = {{.name = "pose", .default_value = Pose(Pose::Identity())},
                                        {.name = "motion", .default_value = Motion{}, .transient = true}},
                         .place_attribute = "pose"}));
  using enum Cardinality;
  ASSERT_TRUE(db.define(
      EdgeSpec{.name = "part_of", .targets_per_source = one, .acyclic = true, .removes_sources = true}));
  ASSERT_TRUE(db.define(EdgeSpec{.name = "sees", .from = "Thing", .to = "Dot"}));
  ASSERT_TRUE(db.define(EdgeSpec{.name = "wed_to", .targets_per_source = one, .sources_per_target = one}));
  ASSERT_TRUE(db.define(EdgeSpec{.name = "after", .acyclic = true}));
}

class Play {
 public:
  explicit Play(std::uint32_t seed) : random_(seed), db(Database::create({.undo_steps = 1'000'000})) {
    define(*db);
    model.schema = mirror.schema = &db->schema();
    watch_ = db->subscribe({}, [this](const ChangeSet& set, std::span<const Change> mine) {
      ++told;
      EXPECT_EQ(mine.size(), set.changes.size());
      check_minimal(set);
      apply(mirror, set);
      EXPECT_EQ(difference(mirror, set.after, false), "");
    });
  }

  std::size_t below(std::size_t n) { return n == 0 ? 0 : random_() % n; }
  bool chance(int percent) { return below(100) < static_cast<std::size_t>(percent); }
  NodeId some_node() {
    if (model.nodes.empty() || chance(2)) return NodeId{below(400)};
    return std::next(model.nodes.begin(), static_cast<long>(below(model.nodes.size())))->first;
  }
  double some_number() {
    switch (below(12)) {
      case 0:
        return kNaN;
      case 1:
        return kInf;
      case 2:
        return 1e300;
      case 3:
        return 5'000'000.0 + static_cast<double>(below(10)) * 0.25;
      case 4:
        return -0.0;
      default:
        return static_cast<double>(below(2000)) / 100 - 10;
    }
  }
  Vector3 some_place() {
    if (chance(30)) return Vector3(static_cast<double>(below(3)), 0, 0);  // many share it
    if (chance(10)) return Vector3(5e6, -5e6, 100) + Vector3::Constant(static_cast<double>(below(8)) * 1e-3);
    return {some_number(), some_number(), some_number()};
  }
  Value some_value(ValueKind kind) {
    switch (kind) {
      case ValueKind::flag:
        return chance(50);
      case ValueKind::integer:
        return static_cast<std::int64_t>(below(60)) - 6;
      case ValueKind::number:
        return some_number();
      case ValueKind::text:
        return std::string(1, static_cast<char>('a' + below(5))) + (chance(20) ? std::string(40, 'x') : "");
      case ValueKind::vector3:
        return some_place();
      case ValueKind::pose:
        return Pose(Eigen::Translation3d(some_place()));
      case ValueKind::motion:
        return Motion{.T_parent_node = Pose(Eigen::Translation3d(some_place()))};
      case ValueKind::numbers:
        return Numbers(std::vector<double>(below(4), static_cast<double>(below(3))));
      case ValueKind::blob:
        return Blob(std::vector<std::byte>(below(5), std::byte(below(2))));
    }
    return false;
  }
  static bool number_ok(const AttributeSpec& s, double v) {
    return std::isnan(v) ? s.nan_is_unknown : v >= s.min && v <= s.max;
  }
  static bool allowed(const AttributeSpec& s, const Value& v) {
    if (v.index() != s.default_value.index()) return false;
    if (auto* i = std::get_if<std::int64_t>(&v)) return number_ok(s, static_cast<double>(*i));
    if (auto* d = std::get_if<double>(&v)) return number_ok(s, *d);
    if (auto* p = std::get_if<Vector3>(&v))
      return number_ok(s, p->x()) && number_ok(s, p->y()) && number_ok(s, p->z());
    if (auto* t = std::get_if<std::string>(&v))
      return s.choices.empty() || std::find(s.choices.begin(), s.choices.end(), *t) != s.choices.end();
    return true;
  }

  void write(Transaction& tx) {
    const auto what = below(100);
    if (what < 22) {
      const TypeId type{static_cast<std::uint32_t>(below(db->schema().type_count()))};
      if (chance(10)) {
        const NodeId id{1 + below(1000)};
        const bool ok = type.value != 1 && !ever.contains(id) && !model.has(id);
        ASSERT_EQ(tx.create_as(id, type).has_value(), ok) << id.value;
        if (ok) made(id, type);
      } else {
        const auto id = tx.create(type);
        ASSERT_EQ(id.has_value(), type.value != 1);
        if (id) {
          ASSERT_FALSE(ever.contains(*id)) << "an id came twice";
          made(*id, type);
        }
      }
    } else if (what < 29) {
      const NodeId n = some_node();
      ASSERT_EQ(tx.remove(n).has_value(), model.has(n));
      if (model.has(n))
        for (auto& [id, node] : model.remove(n)) graveyard[id] = node;
    } else if (what < 65) {
      const NodeId n = some_node();
      const AttributeId a{static_cast<std::uint32_t>(below(db->schema().attribute_count()))};
      const AttributeSpec& spec = db->schema().attribute(a).spec;
      const Value v = some_value(chance(3) ? ValueKind::text : kind_of(spec.default_value));
      const bool ok = model.has(n) && model.nodes[n].values.contains(a.value) && allowed(spec, v);
      const Status s =
          chance(50) && model.has(n) && !spec.name.empty() && model.nodes[n].values.contains(a.value)
              ? tx.set(n, spec.name, v)
              : tx.set(n, a, v);
      ASSERT_EQ(s.has_value(), ok) << (s ? "" : s.error().text());
      if (ok) model.nodes[n].values[a.value] = v;
    } else if (what < 73) {
      const NodeId n = some_node();
      const std::string name = "extra" + std::to_string(below(3));
      if (chance(70)) {
        const Value v = some_value(static_cast<ValueKind>(below(9)));
        ASSERT_EQ(tx.set_dynamic(n, name, v).has_value(), model.has(n));
        if (model.has(n)) model.nodes[n].dynamic.insert_or_assign(name, v);
      } else {
        const bool ok = model.has(n) && model.nodes[n].dynamic.contains(name);
        ASSERT_EQ(tx.erase_dynamic(n, name).has_value(), ok);
        if (ok) model.nodes[n].dynamic.erase(name);
      }
    } else if (what < 90) {
      const NodeId s = some_node(), t = some_node();
      const auto e = static_cast<std::uint32_t>(below(4));
      const EdgeSpec& spec = db->schema().edge(EdgeTypeId{e});
      const auto is = [&](NodeId n, const std::string& type) {
        return model.has(n) && db->schema().is_a(model.nodes[n].type, db->schema().require_type(type));
      };
      bool ok = is(s, spec.from) && is(t, spec.to);
      const bool there = ok && model.connected(s, e, t);
      if (ok && !there) {
        if (spec.targets_per_source == Cardinality::one && !model.targets(e, s).empty()) ok = false;
        if (spec.sources_per_target == Cardinality::one && !model.sources(e, t).empty()) ok = false;
        if (spec.acyclic && model.reaches(e, t, s)) ok = false;
      }
      ASSERT_EQ(tx.connect(s, EdgeTypeId{e}, t).has_value(), ok);
      if (ok && !there) model.join(s, e, t);
    } else {
      NodeId s = some_node(), t = some_node();
      const auto e = static_cast<std::uint32_t>(below(4));
      if (const auto list = model.targets(e, s); !list.empty() && chance(80)) t = list[below(list.size())];
      const bool ok = model.has(s) && model.connected(s, e, t);
      ASSERT_EQ(tx.disconnect(s, EdgeTypeId{e}, t).has_value(), ok);
      if (ok) model.cut(s, e, t);
    }
  }

  void made(NodeId id, TypeId type) {
    ever.insert(id);
    open_made.insert(id);
    model.create(id, type);
  }

  /// What undo steps count: all but transient attributes.
  bool lasting_difference(const Model& a, const Model& b) { return !same_but_transient(a, b); }
  bool same_but_transient(const Model& a, const Model& b) {
    if (a.nodes.size() != b.nodes.size() || a.out != b.out || a.in != b.in) return false;
    for (const auto& [id, n] : a.nodes) {
      const auto it = b.nodes.find(id);
      if (it == b.nodes.end() || it->second.type != n.type ||
          !testing_model::same_map(n.dynamic, it->second.dynamic))
        return false;
      for (const auto& [k, v] : n.values)
        if (!db->schema().attribute(AttributeId{k}).spec.transient && !same_value(v, it->second.values.at(k)))
          return false;
    }
    return true;
  }

  /// To the world of `to`, with transient attributes as they are now.
  void go_to(Model to) {
    for (auto& [id, n] : to.nodes)
      for (auto& [a, v] : n.values)
        if (db->schema().attribute(AttributeId{a}).spec.transient)
          v = model.has(id) ? model.nodes[id].values[a] : graveyard.at(id).values.at(a);
    for (const auto& [id, n] : model.nodes)
      if (!to.has(id)) graveyard[id] = n;
    model = std::move(to);
  }

  void check_minimal(const ChangeSet& set) {
    std::set<std::string> keys;
    for (const Change& c : set.changes) {
      std::string key = std::to_string(c.node.value) + "/" + std::to_string(c.attribute.value) + "/" +
                        std::to_string(c.edge.value) + "/" + std::to_string(c.other.value) + "/" + c.dynamic;
      EXPECT_TRUE(keys.insert(key).second) << "told twice: " << key;
      switch (c.kind) {
        case ChangeKind::created:
          EXPECT_TRUE(!set.before.contains(c.node) && set.after.contains(c.node));
          break;
        case ChangeKind::removed:
          EXPECT_TRUE(set.before.contains(c.node) && !set.after.contains(c.node));
          break;
        case ChangeKind::changed:
          EXPECT_TRUE(set.before.contains(c.node) && set.after.contains(c.node));
          if (c.dynamic.empty()) {
            EXPECT_FALSE(
                same_value(*set.before.get(c.node, c.attribute), *set.after.get(c.node, c.attribute)));
          }
          break;
        default:
          break;
      }
    }
  }

  void check_space(const Snapshot& s) {
    const TypeId type{static_cast<std::uint32_t>(below(db->schema().type_count()))};
    std::vector<std::pair<NodeId, Vector3>> places;
    const auto position = *db->schema().find_attribute(db->schema().require_type("Dot"), "position");
    const auto pose = *db->schema().find_attribute(db->schema().require_type("Body"), "pose");
    for (const auto& [id, n] : model.nodes) {
      if (!db->schema().is_a(n.type, type)) continue;
      Vector3 p;
      if (n.values.contains(position.value))
        p = std::get<Vector3>(n.values.at(position.value));
      else if (n.values.contains(pose.value) && model.targets(0, id).empty())
        p = std::get<Pose>(n.values.at(pose.value)).translation();
      else
        continue;
      if (p.allFinite()) places.emplace_back(id, p);
    }
    Vector3 centre = some_place();
    if (!places.empty() && chance(60)) centre = places[below(places.size())].second;
    double radius = chance(10)   ? kInf
                    : chance(10) ? 0.0
                    : chance(10) ? -1.0
                    : chance(10) ? 1e301
                                 : static_cast<double>(below(1000)) / 100;
    if (chance(3)) radius = kNaN;
    std::vector<std::pair<double, NodeId>> all;
    for (const auto& [id, p] : places) all.emplace_back((p - centre).norm(), id);
    std::sort(all.begin(), all.end());
    std::vector<NodeId> expected;
    if (centre.allFinite())  // from nowhere, nothing is near
      for (const auto& [d, id] : all)
        if (d <= radius) expected.push_back(id);
    EXPECT_EQ(s.in_radius(type, centre, radius), expected) << centre.transpose() << " radius " << radius;
    const std::size_t k = chance(10) ? 1000 : below(8);
    expected.clear();
    if (centre.allFinite())
      for (std::size_t i = 0; i < std::min(k, all.size()); ++i) expected.push_back(all[i].second);
    EXPECT_EQ(s.nearest(type, centre, k), expected) << centre.transpose();
    const Box3 box{centre, some_place()};
    expected.clear();
    for (const auto& [id, p] : places)
      if ((p.array() >= box.min.array()).all() && (p.array() <= box.max.array()).all())
        expected.push_back(id);
    EXPECT_EQ(s.in_box(type, box), expected) << box.min.transpose() << " to " << box.max.transpose();
  }

  void step() {
    if (chance(25)) {
      const bool back = chance(60);
      auto& from = back ? done : undone;
      auto& to = back ? undone : done;
      const Status s = back ? db->undo() : db->redo();
      ASSERT_EQ(s.has_value(), !from.empty());
      if (s) {
        Model now = model;
        go_to(std::move(from.back()));
        from.pop_back();
        to.push_back(std::move(now));
      }
    } else {
      const Model before = model;
      const auto graves = graveyard;
      open_made.clear();
      Transaction tx = db->begin("step");
      const std::size_t writes = chance(5) ? 60 : below(8);
      for (std::size_t i = 0; i < writes; ++i) {
        write(tx);
        if (chance(5)) {
          const Snapshot view = tx.view();
          ASSERT_EQ(difference(model, view), "");
          check_space(view);
        }
      }
      if (chance(25)) {
        tx.rollback();
        model = before;
        graveyard = graves;
        // What never was may be given out by create_as again.
        for (const NodeId n : open_made) ever.erase(n);
      } else {
        const std::size_t steps_before = db->undo_labels().size();
        ASSERT_TRUE(tx.commit());
        // Whether edges that were cut and joined again count as a step is the database's business.
        const bool is_step = db->undo_labels().size() > steps_before;
        if (lasting_difference(before, model)) {
          ASSERT_TRUE(is_step);
        }
        if (is_step) {
          done.push_back(before);
          undone.clear();
        }
      }
    }
    const Snapshot s = db->snapshot();
    ASSERT_EQ(difference(model, s), "");
    ASSERT_EQ(difference(mirror, s, false), "");
    check_space(s);
    if (chance(5)) kept.emplace_back(s, model);
    if (kept.size() > 6) kept.erase(kept.begin() + static_cast<long>(below(kept.size())));
    if (chance(10)) {
      for (const auto& [old, m] : kept) ASSERT_EQ(difference(m, old), "");
    }
  }

  std::mt19937 random_;
  std::unique_ptr<Database> db;
  Model model, mirror;
  std::deque<Model> done, undone;
  std::set<NodeId> ever, open_made;
  std::map<NodeId, ModelNode> graveyard;
  std::vector<std::pair<Snapshot, Model>> kept;
  std::size_t told = 0;
  Subscription watch_;
};

class GraphModel : public testing::TestWithParam<std::uint32_t> {};

// Under a sanitizer a step takes twenty times as long; the thread sanitizer has one thread to watch here.
#if defined(RIGOR_THREAD_SANITIZER)
constexpr int kSteps = 300;
constexpr std::uint32_t kSeeds = 1;
#elif defined(RIGOR_ADDRESS_SANITIZER)
constexpr int kSteps = 300;
constexpr std::uint32_t kSeeds = 3;
#else
constexpr int kSteps = 1500;
constexpr std::uint32_t kSeeds = 6;
#endif

TEST_P(GraphModel, IsReproducedByRandomTransactions) {
  Play run(GetParam());
  for (int i = 0; i < kSteps && !testing::Test::HasFatalFailure() && !testing::Test::HasNonfatalFailure();
       ++i) {
    SCOPED_TRACE("step " + std::to_string(i));
    run.step();
  }
  EXPECT_GT(run.told, kSteps / 5u);
}

INSTANTIATE_TEST_SUITE_P(Seeds, GraphModel, testing::Range(1u, kSeeds + 1));

TEST(GraphModelOrder, DependsOnTheHistoryOfTransactionsAlone) {
  Play a(77), b(77);
  for (int i = 0; i < 300; ++i) {
    a.step();
    b.step();
    ASSERT_EQ(a.db->snapshot().nodes(TypeId{0}), b.db->snapshot().nodes(TypeId{0}));
  }
}

}  // namespace
}  // namespace rigor::world
