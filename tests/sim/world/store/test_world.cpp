#include "tests/sim/world/store/test_world.h"

#include <gtest/gtest.h>
#include <stdlib.h>

#include <bit>
#include <limits>

namespace rigor::world::test {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

double draw_number(Draws& d) {
  constexpr double kHard[] = {0.0,
                              -0.0,
                              kNaN,
                              kInf,
                              -kInf,
                              5e-324,
                              1.7976931348623157e308,
                              0.1,
                              1e-310,
                              -1.0,
                              1e22,
                              9007199254740993.0,
                              140737488355328.0,
                              1.0 / 3.0,
                              2.2250738585072014e-308,
                              -5e-324,
                              123456789.125,
                              1e300};
  if (d.below(2) == 0) return kHard[d.below(std::size(kHard))];
  return std::bit_cast<double>(d.word());
}

std::string draw_text(Draws& d) {
  const std::string hard[] = {"",
                              "plain",
                              "it's \"quoted\" \\ and: [flow, {map}] # no comment",
                              "two\nlines\n",
                              " leading and trailing ",
                              "tab\tcr\rbell\a del\x7f",
                              std::string("zero\0inside", 11),
                              "Grüße 木 \U0001F333",
                              "next line \u0085 separators \u2028\u2029 mark \uFEFF",
                              "true",
                              "null",
                              "~",
                              ".nan",
                              "0x10",
                              "- item",
                              "---",
                              "\xff\xfe no UTF-8 \xc3",
                              "%percent @at `tick",
                              "'; DROP TABLE nodes; --"};
  return hard[d.below(std::size(hard))];
}

Vector3 draw_vector(Draws& d) { return {draw_number(d), draw_number(d), draw_number(d)}; }
Pose draw_pose(Draws& d) {
  Pose T = Pose::Identity();
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 4; ++column) T.matrix()(row, column) = draw_number(d);
  return T;
}

AttributeSpec spec(std::string name, Value value, bool transient = false) {
  return {.name = std::move(name),
          .default_value = std::move(value),
          .transient = transient,
          .nan_is_unknown = true};
}

}  // namespace

Value draw_value(Draws& d, ValueKind kind) {
  switch (kind) {
    case ValueKind::flag:
      return d.below(2) == 1;
    case ValueKind::integer: {
      constexpr std::int64_t kHard[] = {0,
                                        -1,
                                        1,
                                        std::numeric_limits<std::int64_t>::min(),
                                        std::numeric_limits<std::int64_t>::max(),
                                        (1LL << 53) + 1};
      return kHard[d.below(std::size(kHard))];
    }
    case ValueKind::number:
      return draw_number(d);
    case ValueKind::text:
      return draw_text(d);
    case ValueKind::vector3:
      return draw_vector(d);
    case ValueKind::pose:
      return draw_pose(d);
    case ValueKind::motion:
      return Motion{.t_ref = BenchTime(static_cast<std::int64_t>(d.word())),
                    .T_parent_node = draw_pose(d),
                    .velocity_m_per_s = draw_vector(d),
                    .angular_velocity_rad_per_s = draw_vector(d)};
    case ValueKind::numbers: {
      std::vector<double> v(d.below(6));
      for (auto& x : v) x = draw_number(d);
      return Numbers(std::move(v));
    }
    case ValueKind::blob: {
      std::vector<std::byte> v(d.below(4) == 0 ? 20'000 : d.below(7));
      for (auto& x : v) x = static_cast<std::byte>(d.word());
      return Blob(std::move(v));
    }
  }
  return false;
}

std::unique_ptr<Database> make_database() {
  auto db = Database::create();
  const Value defaults[] = {
      false,    std::int64_t{7}, 1.5,   std::string("none"), Vector3(1, 2, 3), Pose(Pose::Identity()),
      Motion{}, Numbers{1, 2},   Blob{}};
  TypeSpec thing{.name = "Thing", .meaning = "Has every kind."};
  for (const auto& v : defaults) {
    thing.attributes.push_back(spec("a_" + std::string(name_of(kind_of(v))), v));
    thing.attributes.push_back(spec("t_" + std::string(name_of(kind_of(v))), v, true));
  }
  EXPECT_TRUE(db->define(TypeSpec{.name = "Idea", .abstract = true, .attributes = {spec("depth", 0.25)}}));
  EXPECT_TRUE(db->define(thing));
  EXPECT_TRUE(
      db->define(TypeSpec{.name = "SmallThing", .base = "Thing", .attributes = {spec("size_m", kNaN)}}));
  EXPECT_TRUE(
      db->define(TypeSpec{.name = "Plan", .base = "Idea", .attributes = {spec("words", std::string())}}));
  // Names that SQL has uses for.
  EXPECT_TRUE(db->define(TypeSpec{.name = "Nodes", .attributes = {spec("group", 0.0), spec("id_of", 1.0)}}));
  EXPECT_TRUE(db->define(TypeSpec{.name = "Select", .attributes = {spec("where", std::string("from"))}}));
  EXPECT_TRUE(db->define(TypeSpec{.name = "THING", .attributes = {spec("order", std::int64_t{1})}}));
  EXPECT_TRUE(db->define(EdgeSpec{
      .name = "in_box", .targets_per_source = Cardinality::one, .acyclic = true, .removes_sources = true}));
  EXPECT_TRUE(db->define(EdgeSpec{.name = "likes"}));
  return db;
}

void change(Database& db, std::uint64_t step) {
  Draws d(step * 1'000'003 + 17);
  const auto& schema = db.schema();
  const auto in_box = schema.require_edge("in_box"), likes = schema.require_edge("likes");
  auto tx = db.begin("step " + std::to_string(step));
  for (std::uint64_t n = 1 + d.below(8); n > 0; --n) {
    auto nodes = tx.view().nodes(TypeId{});
    std::sort(nodes.begin(), nodes.end());
    const auto any = [&] { return nodes[d.below(nodes.size())]; };
    if (nodes.size() < 3 || d.below(4) == 0) {
      constexpr const char* kTypes[] = {"Thing", "SmallThing", "Plan", "Nodes", "Select", "THING", "Object"};
      const auto made = tx.create(schema.require_type(kTypes[d.below(std::size(kTypes))]));
      ASSERT_TRUE(made) << made.error().text();
      continue;
    }
    switch (d.below(8)) {
      case 0:
        if (nodes.size() > 12) {
          EXPECT_TRUE(tx.remove(any()));
        }
        break;
      case 1:
      case 2:  // refused where it closes a ring or is there already
        (void)tx.connect(any(), likes, any());
        (void)tx.connect(any(), in_box, any());
        break;
      case 3: {
        const auto source = any();
        const auto targets = tx.view().targets(source, likes);
        if (!targets.empty()) {
          EXPECT_TRUE(tx.disconnect(source, likes, NodeId(targets[d.below(targets.size())])));
        }
        break;
      }
      case 4:
        EXPECT_TRUE(tx.set_dynamic(any(), d.below(2) ? "nickname" : "note",
                                   draw_value(d, static_cast<ValueKind>(d.below(9)))));
        break;
      case 5:
        (void)tx.erase_dynamic(any(), "note");
        break;
      default: {
        const auto node = any();
        const auto& own = schema.attributes(*tx.view().type_of(node));
        if (own.empty()) break;
        const auto a = own[d.below(own.size())];
        const auto s = tx.set(node, a, draw_value(d, schema.attribute(a).kind()));
        (void)s;  // numbers that the schema refuses stay as they were
      }
    }
  }
  const auto s = tx.commit();
  ASSERT_TRUE(s) << s.error().text();
}

TemporaryFolder::TemporaryFolder() {
  std::string name = (std::filesystem::temp_directory_path() / "rigor_store_XXXXXX").string();
  path_ = ::mkdtemp(name.data());
}
TemporaryFolder::~TemporaryFolder() {
  std::error_code ec;
  std::filesystem::remove_all(path_, ec);
}

}  // namespace rigor::world::test
