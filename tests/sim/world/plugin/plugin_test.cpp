// Plugins: what they bring, and that of those that cannot be had nothing stays.
#include "sim/world/plugin/plugin.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>

#include "sensor-hal/plugin/plugin_file.h"

namespace rigor::world {
namespace {

namespace fs = std::filesystem;

fs::path module(const std::string& name) { return fs::path(RIGOR_TEST_MODULES) / (name + ".so"); }

struct Counts {
  std::size_t types, attributes, edges, rules, importers;
  bool operator==(const Counts&) const = default;
};

class PluginTest : public ::testing::Test {
 protected:
  [[nodiscard]] Counts counts() const {
    return {db_->schema().type_count(), db_->schema().attribute_count(), db_->schema().edge_type_count(),
            plugins_.list().size(), plugins_.importers().size()};
  }
  void refused(const Status& s, ErrorCode code, std::initializer_list<std::string_view> words) {
    ASSERT_FALSE(s);
    EXPECT_EQ(s.error().code, code) << s.error().text();
    for (const auto w : words)
      EXPECT_NE(s.error().text().find(w), std::string::npos) << "'" << w << "' in: " << s.error().text();
    EXPECT_EQ(counts(), before_) << "nothing stays";
    EXPECT_FALSE(db_->schema().find_type("Left"));
    // And the same names are free for a good one.
    EXPECT_TRUE(db_->begin().commit());
  }
  std::unique_ptr<Database> db_ = Database::create();
  Plugins plugins_{*db_};
  Counts before_ = counts();
};

TEST_F(PluginTest, ABuiltInOneDefinesAndImports) {
  TypeId type;
  const auto s = plugins_.add(
      {"stones", "2.1", "Stones.", [&](PluginHost& host) -> Status {
         auto t = host.define(
             TypeSpec{.name = "Stone", .attributes = {{.name = "mass_kg", .default_value = 1.0}}});
         if (!t) return tl::unexpected(t.error());
         type = *t;
         const auto mass = host.schema().require<double>("Stone", "mass_kg");
         if (auto e = host.define(EdgeSpec{.name = "rests_on", .from = "Stone"}); !e)
           return tl::unexpected(e.error());
         if (auto a = host.add_attribute(*t, {.name = "wet", .default_value = false}); !a)
           return tl::unexpected(a.error());
         return host.add_importer({.name = "stones",
                                   .suffixes = {".stones", ".st"},
                                   .run = [t = *t, mass](const fs::path& file, Transaction& tx) -> Status {
                                     std::ifstream in(file);
                                     for (double x = 0; in >> x;) {
                                       auto n = tx.create(t);
                                       if (!n) return tl::unexpected(n.error());
                                       if (auto set = tx.set(*n, mass, x); !set) return set;
                                       if (x < 0)
                                         return fail(ErrorCode::bad_input, file.string(), "a stone flies");
                                     }
                                     return {};
                                   }});
       }});
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(type, db_->schema().require_type("Stone"));
  ASSERT_EQ(plugins_.list().size(), 1U);
  const auto& info = plugins_.list().front();
  EXPECT_EQ(info.name + " " + info.version, "stones 2.1");
  EXPECT_TRUE(info.file.empty());
  EXPECT_EQ(info.types, std::vector<std::string>{"Stone"});
  EXPECT_EQ(info.edges, std::vector<std::string>{"rests_on"});
  EXPECT_EQ(info.importers, std::vector<std::string>{"stones"});

  const auto file = fs::temp_directory_path() / ("rigor_plugin_test_" + std::to_string(::getpid()) + ".ST");
  std::ofstream(file) << "1 2.5 3";
  ASSERT_TRUE(plugins_.import_file(file));
  EXPECT_EQ(db_->snapshot().node_count(), 3U);
  EXPECT_EQ(db_->undo_labels().size(), 1U) << "one transaction";
  std::ofstream(file) << "1 2 -3";
  const auto bad = plugins_.import_file(file);
  ASSERT_FALSE(bad);
  EXPECT_EQ(db_->snapshot().node_count(), 3U) << "as it was";
  fs::remove(file);
  const auto none = plugins_.import_file(file);
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::not_found);
  const auto unknown = plugins_.import_file("/etc/hostname");
  ASSERT_FALSE(unknown);
  EXPECT_NE(unknown.error().text().find("stones"), std::string::npos) << unknown.error().text();
  EXPECT_FALSE(plugins_.import_file(file, "stnes"));
}

TEST_F(PluginTest, TakesTypesThatAreThereAlreadyWordForWord) {
  const TypeSpec stone{.name = "Stone", .attributes = {{.name = "mass_kg", .default_value = 1.0}}};
  const auto there = *db_->define(stone);
  const auto s = plugins_.add({"stones", "1", "", [&](PluginHost& host) -> Status {
                                 auto t = host.define(stone);
                                 EXPECT_EQ(*t, there);
                                 return {};
                               }});
  EXPECT_TRUE(s) << s.error().text();
  before_ = counts();
  auto other = stone;
  other.attributes[0].unit = "kg";
  refused(plugins_.add({"more", "1", "",
                        [&](PluginHost& host) -> Status {
                          (void)host.define(other);
                          return {};
                        }}),
          ErrorCode::bad_input, {"more", "Stone"});
}

TEST_F(PluginTest, OnesWithOneThingWrongLeaveNothing) {
  refused(plugins_.load(module("broken_throws")), ErrorCode::bad_input, {"broken_throws.so", "out of bees"});
  refused(plugins_.load(module("broken_throws_a_number")), ErrorCode::bad_input, {"exception"});
  refused(plugins_.load(module("broken_fails")), ErrorCode::unavailable, {"no licence for bees"});
  refused(plugins_.load(module("broken_hides_an_error")), ErrorCode::bad_input, {"UpperCamelCase"});
  refused(plugins_.load(module("broken_no_function")), ErrorCode::bad_input, {"a function"});
  // After all these a good one loads.
  const auto s = plugins_.load(module("good"));
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_TRUE(db_->schema().find_type("Left"));
  EXPECT_EQ(plugins_.list().front().rules, std::vector<std::string>{"left.throws_at_seven"});
  EXPECT_EQ(plugins_.list().front().file.filename(), "good.so");
}

TEST_F(PluginTest, NothingRunsOfOneBuiltAgainstSomethingElse) {
  ::unsetenv("RIGOR_TEST_PLUGIN_RAN");
  refused(plugins_.load(module("broken_abi")), ErrorCode::bad_input,
          {"headers 0000000000000000", "compiler 4.9", "build the plugin again"});
  refused(plugins_.load(module("broken_no_entry")), ErrorCode::bad_input,
          {"without the entry", "RIGOR_WORLD_PLUGIN"});
  refused(plugins_.load(module("broken_entry")), ErrorCode::bad_input, {"another form"});
  EXPECT_EQ(std::getenv("RIGOR_TEST_PLUGIN_RAN"), nullptr) << "not even its constructors";
  // Of a file that this process has not loaded yet they run, and leave their trace.
  const auto copy = fs::temp_directory_path() / ("rigor_plugin_copy_" + std::to_string(::getpid()) + ".so");
  fs::copy_file(module("good"), copy, fs::copy_options::overwrite_existing);
  const auto s = plugins_.load(copy);
  fs::remove(copy);
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_NE(std::getenv("RIGOR_TEST_PLUGIN_RAN"), nullptr);
}

TEST_F(PluginTest, RulesInARingAreRefused) {
  const auto s = plugins_.load(module("broken_rules"));
  refused(s, ErrorCode::bad_input, {"x_to_y", "y_to_x"});
}

TEST_F(PluginTest, ARuleThatThrowsIsAVeto) {
  ASSERT_TRUE(plugins_.load(module("good")));
  auto tx = db_->begin();
  const auto node = *tx.create("Left");
  ASSERT_TRUE(tx.set(node, "x", Value(7.0)));
  const auto s = tx.commit();
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("seven"), std::string::npos) << s.error().text();
  EXPECT_EQ(db_->snapshot().node_count(), 0U);
}

TEST_F(PluginTest, EachOnce) {
  ASSERT_TRUE(plugins_.load(module("good")));
  before_ = counts();
  const auto s = plugins_.load(module("good"));
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("once"), std::string::npos) << s.error().text();
  EXPECT_EQ(counts(), before_);
  // For another database it is as new.
  auto other = Database::create();
  Plugins more(*other);
  EXPECT_TRUE(more.load(module("good")));
  EXPECT_TRUE(other->schema().find_type("Left"));
}

TEST_F(PluginTest, FilesThatAreNoPlugins) {
  const auto folder = fs::temp_directory_path() / ("rigor_plugin_files_" + std::to_string(::getpid()));
  fs::create_directory(folder);
  refused(plugins_.load(folder / "none.so"), ErrorCode::not_found, {"no such file"});
  refused(plugins_.load(folder), ErrorCode::bad_input, {"no file"});
  std::ofstream(folder / "text.so") << "#!/bin/sh\n";
  refused(plugins_.load(folder / "text.so"), ErrorCode::bad_input, {"shared object"});
  std::ofstream(folder / "empty.so");
  refused(plugins_.load(folder / "empty.so"), ErrorCode::bad_input, {"shared object"});
  refused(plugins_.load("/proc/self/exe"), ErrorCode::bad_input, {});
  std::ifstream in(module("good"), std::ios::binary);
  const std::string whole((std::istreambuf_iterator<char>(in)), {});
  for (std::size_t i = 0; i < 60; ++i) {
    const auto size = whole.size() * i / 60;
    std::ofstream(folder / "cut.so", std::ios::binary)
        .write(whole.data(), static_cast<std::streamsize>(size));
    refused(plugins_.load(folder / "cut.so"), ErrorCode::bad_input, {"shared object"});
  }
  // The reader of the file meets any bytes at all.
  std::uint64_t word = 12345;
  for (int i = 0; i < 200; ++i) {
    auto bytes = whole;
    for (int k = 0; k < 6; ++k) {
      word = word * 6364136223846793005ULL + 1442695040888963407ULL;
      const auto at = (word >> 20) % (k < 4 ? 900 : bytes.size());
      bytes[at] = static_cast<char>(word >> 50);
    }
    std::ofstream(folder / "any.so", std::ios::binary)
        .write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    (void)plugin_abi_of(folder / "any.so", {"rigor_world_plugin", "rigor world plugin", "M", "plugin", "T"});
  }
  fs::remove_all(folder);
}

TEST(PluginAbi, TellsWhatDiffers) {
  EXPECT_EQ(abi_difference("headers a; compiler 12", "headers a; compiler 12"), "");
  EXPECT_EQ(abi_difference("headers a; compiler 12", "headers b; compiler 12"),
            "expected headers a, got headers b");
  EXPECT_EQ(abi_difference("headers a; compiler 12", "headers a"), "expected compiler 12, got nothing");
}

}  // namespace
}  // namespace rigor::world
