// A world as YAML: the same bytes for the same world, and the same world from the bytes.
#include <gtest/gtest.h>

#include <fstream>

#include "sim/world/semantic_types.h"
#include "sim/world/store/value_codec.h"
#include "sim/world/store/world_file.h"
#include "tests/sim/world/store/test_world.h"

namespace rigor::world {
namespace {

using test::make_database;
using test::TemporaryFolder;
namespace fs = std::filesystem;

std::string text_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

TEST(WorldExport, RoundTripsEveryWorldExactly) {
  TemporaryFolder folder;
  const auto file = folder / "w.yaml";
  auto db = make_database();
  for (std::uint64_t step = 0; step < 150; ++step) {
    test::change(*db, step);
    if (step % 10 != 9) continue;
    const auto s = export_world_yaml(db->snapshot(), file);
    ASSERT_TRUE(s) << s.error().text();
    const auto yaml = text_of(file);
    ASSERT_EQ(yaml, world_yaml(db->snapshot()));
    for (const bool bare : {false, true}) {
      auto other = bare ? Database::create() : make_database();
      const auto read = import_world_yaml(file, *other);
      ASSERT_TRUE(read) << read.error().text();
      ASSERT_EQ(world_yaml(other->snapshot()), yaml) << "step " << step;
      // Not only the text: every value, bit for bit.
      db->snapshot().for_each(TypeId{}, [&](NodeId n) {
        for (const auto a : db->schema().attributes(*db->snapshot().type_of(n))) {
          const auto& spec = db->schema().attribute(a).spec;
          if (spec.transient) continue;
          const auto found = other->snapshot().get(n, spec.name);
          ASSERT_TRUE(found) << spec.name;
          ASSERT_TRUE(same_value(*found, *db->snapshot().get(n, a)))
              << "node " << n.value << " " << spec.name;
        }
      });
    }
  }
}

TEST(WorldExport, IsTheSameThroughAFile) {
  TemporaryFolder folder;
  auto db = make_database();
  for (std::uint64_t step = 0; step < 60; ++step) test::change(*db, step);
  const auto before = world_yaml(db->snapshot());
  {
    auto f = WorldFile::create(folder / "w", *db);
    ASSERT_TRUE(f);
    ASSERT_TRUE((*f)->persist());
  }
  auto other = make_database();
  ASSERT_TRUE(WorldFile::open(folder / "w", *other));
  EXPECT_EQ(world_yaml(other->snapshot()), before);
}

TEST(WorldExport, OfAnEmptyWorld) {
  TemporaryFolder folder;
  auto db = Database::create();
  ASSERT_TRUE(export_world_yaml(db->snapshot(), folder / "w"));
  auto other = Database::create();
  const auto s = import_world_yaml(folder / "w", *other);
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(other->snapshot().node_count(), 0U);
}

TEST(WorldExport, ReadsAsAPersonWouldWriteIt) {
  auto db = Database::create();
  ASSERT_TRUE(define_semantic_types(*db));
  const types::Tree tree(db->schema());
  auto tx = db->begin();
  const auto n = *tx.create(tree.type);
  ASSERT_TRUE(tx.set(n, tree.position, Vector3(1, -2.5, std::nan(""))));
  ASSERT_TRUE(tx.set(n, tree.species, std::string("TSHE")));
  ASSERT_TRUE(tx.commit());
  const auto yaml = world_yaml(db->snapshot());
  EXPECT_NE(yaml.find("nodes:\n"
                      "  - id: 1\n"
                      "    type: \"Tree\"\n"
                      "    attributes:\n"
                      "      \"position\": [1, -2.5, .nan]\n"
                      "      \"species\": \"TSHE\"\n"),
            std::string::npos)
      << yaml;
  EXPECT_EQ(yaml.find("Building"), std::string::npos) << "types without nodes stay out";
}

class WorldImport : public ::testing::Test {
 protected:
  void refused(const std::string& yaml, std::initializer_list<std::string_view> words) {
    std::ofstream(folder_ / "w.yaml") << yaml;
    auto db = make_database();
    const auto s = import_world_yaml(folder_ / "w.yaml", *db);
    ASSERT_FALSE(s) << yaml;
    EXPECT_EQ(s.error().exit_status(), 2);
    for (const auto w : words)
      EXPECT_NE(s.error().text().find(w), std::string::npos) << "'" << w << "' in: " << s.error().text();
    EXPECT_EQ(db->snapshot().node_count(), 0U);
  }
  TemporaryFolder folder_;
};

TEST_F(WorldImport, AWorldWrittenByHand) {
  std::ofstream(folder_ / "w.yaml") << "rigor_world: 1\n"
                                       "nodes:\n"
                                       "- {id: 7, type: SmallThing, attributes: {size_m: 2, a_text: hello}}\n"
                                       "- {id: 3, type: Thing, edges: {in_box: [7], likes: [3, 7]}}\n";
  auto db = make_database();
  const auto s = import_world_yaml(folder_ / "w.yaml", *db);
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(std::get<double>(*db->snapshot().get(NodeId{7}, "size_m")), 2);
  EXPECT_EQ(db->snapshot().target(NodeId{3}, db->schema().require_edge("in_box")), NodeId{7});
  EXPECT_TRUE(db->undo()) << "an import is a step that can be taken back";
  EXPECT_EQ(db->snapshot().node_count(), 0U);
}

TEST_F(WorldImport, KeepsTheMeaningOfWhatAFileLeavesOut) {
  auto db = make_database();
  test::change(*db, 1);
  auto yaml = world_yaml(db->snapshot());
  auto other = Database::create();
  ASSERT_TRUE(
      other->define(TypeSpec{.name = "Thing", .attributes = {{.name = "a_number", .default_value = 99.0}}}));
  {
    auto tx = db->begin();
    ASSERT_TRUE(tx.create_as(NodeId{1000}, db->schema().require_type("Thing")));
    ASSERT_TRUE(tx.commit());
  }
  ASSERT_TRUE(export_world_yaml(db->snapshot(), folder_ / "w.yaml"));
  const auto s = import_world_yaml(folder_ / "w.yaml", *other);
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(std::get<double>(*other->snapshot().get(NodeId{1000}, "a_number")), 1.5) << "the file's default";
}

TEST_F(WorldImport, SaysWhereAFileIsWrong) {
  const std::string head = "rigor_world: 1\nnodes:\n";
  refused("nodes: []\n", {"w.yaml", "rigor_world"});
  refused("rigor_world: 2\nnodes: []\n", {"w.yaml:1:14", "expected 1"});
  refused("rigor_world: 1\nnodes: []\ncolour: red\n", {"w.yaml:3:1", "colour"});
  refused(head + "  - {id: 0, type: Thing}\n", {"w.yaml:3:10", "a node's id"});
  refused(head + "  - {id: -1, type: Thing}\n", {"a node's id"});
  refused(head + "  - {id: 1, type: Thnig}\n", {"w.yaml:3:19", "did you mean Thing", "Thnig"});
  refused(head + "  - {id: 1, type: Idea}\n", {"abstract"});
  refused(head + "  - {id: 1, type: Thing}\n  - {id: 1, type: Thing}\n", {"w.yaml:4:10"});
  refused(head + "  - {id: 1, type: Thing, attributes: {a_numbr: 1}}\n",
          {"w.yaml:3:", "did you mean a_number"});
  refused(head + "  - {id: 1, type: Thing, attributes: {a_number: one}}\n",
          {"w.yaml:3:", "expected a number"});
  refused(head + "  - {id: 1, type: Thing, attributes: {a_vector3: [1, 2]}}\n", {"3 numbers", "one of 2"});
  refused(head + "  - {id: 1, type: Thing, attributes: {a_blob: \"====\"}}\n", {"base64"});
  refused(head + "  - {id: 1, type: Thing, edges: {likes: [2]}}\n", {"w.yaml:3:", "2"});
  refused(head + "  - {id: 1, type: Thing, edges: {loves: [1]}}\n", {"w.yaml:3:", "loves"});
  refused(head + "  - {id: 1, type: Thing, edges: {in_box: [1]}}\n", {"w.yaml:3:"});
  refused(head + "  - {id: 1, type: Thing, size: 3}\n", {"w.yaml:3:", "size"});
  refused(head + "  - {id: 1, type: Thing\n", {"w.yaml:"});
  auto db = make_database();
  const auto none = import_world_yaml(folder_ / "none.yaml", *db);
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::not_found);
}

TEST(WorldExport, ThatFailsLeavesWhatWasThere) {
  TemporaryFolder folder;
  auto db = make_database();
  auto s = export_world_yaml(db->snapshot(), folder.path());
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_writable) << s.error().text();
  s = export_world_yaml(db->snapshot(), folder / "no/such/w.yaml");
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_writable) << s.error().text();
  if (fs::exists("/dev/full")) {
    fs::create_symlink("/dev/full", folder / "w.yaml.part");
    std::ofstream(folder / "w.yaml") << "before";
    s = export_world_yaml(db->snapshot(), folder / "w.yaml");
    ASSERT_FALSE(s);
    EXPECT_EQ(s.error().code, ErrorCode::disk_full) << s.error().text();
    EXPECT_EQ(text_of(folder / "w.yaml"), "before");
  }
}

TEST(Base64, RoundTripsAndRefusesTheRest) {
  const auto encode = [](std::string_view s) { return store::base64(std::as_bytes(std::span(s))); };
  EXPECT_EQ(encode(""), "");
  EXPECT_EQ(encode("f"), "Zg==");
  EXPECT_EQ(encode("fo"), "Zm8=");
  EXPECT_EQ(encode("foo"), "Zm9v");
  EXPECT_EQ(encode("foobar"), "Zm9vYmFy");
  EXPECT_EQ(encode("\xff\xfe\xfd"), "//79");
  for (const auto* bad :
       {"Z", "Zg", "Zg=", "Zg==Zg==", "Z===", "====", "Zh==", "Zm9=", "Zm 9", "Zm9v\n", "=g=="})
    EXPECT_FALSE(store::from_base64(bad)) << bad;
  test::Draws draws(3);
  for (std::size_t n = 0; n < 200; ++n) {
    std::vector<std::byte> v(n);
    for (auto& b : v) b = static_cast<std::byte>(draws.word());
    EXPECT_EQ(store::from_base64(store::base64(v)), v);
  }
}

}  // namespace
}  // namespace rigor::world
