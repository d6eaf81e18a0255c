// The sample plugin of examples/world-plugin, built as a user builds it: against an installed Rigor, by
// CMake.
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>

#include "sim/world/plugin/plugin.h"
#include "sim/world/store/world_file.h"
#include "tests/paths.h"

namespace rigor::world {
namespace {

namespace fs = std::filesystem;

class InstalledPlugin : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("rigor_installed_" + std::to_string(::getpid()));
    fs::create_directories(folder_);
    const auto prefix = (folder_ / "prefix").string(), build = (folder_ / "build").string();
    for (const char* component : {"libraries", "sdk"})
      run("cmake --install '" + rigor::test::build_dir() + "' --component " + std::string(component) +
          " --prefix '" + prefix + "'");
    run("cmake -S '" + rigor::test::source_dir() + "/examples/world-plugin' -B '" + build +
        "' -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_COMPILER='" RIGOR_CXX_COMPILER "' -DCMAKE_PREFIX_PATH='" +
        prefix + "'");
    run("cmake --build '" + build + "'");
  }
  void TearDown() override {
    std::error_code ec;
    fs::remove_all(folder_, ec);
  }
  void run(const std::string& command) {
    const auto log = folder_ / "log";
    const int status = std::system((command + " > '" + log.string() + "' 2>&1").c_str());
    std::ifstream in(log);
    const std::string text((std::istreambuf_iterator<char>(in)), {});
    ASSERT_EQ(status, 0) << command << "\n" << text;
    EXPECT_EQ(text.find("arning"), std::string::npos) << text;
  }
  void stands_alone();
  void imports_and_keeps_its_rules();
  void is_refused_when_a_header_has_changed();
  fs::path folder_;
};

void InstalledPlugin::stands_alone() {
  const auto include = folder_ / "prefix/include/rigor";
  EXPECT_TRUE(fs::exists(include / "sim/world/plugin/plugin.h"));
  EXPECT_TRUE(fs::exists(include / "sim/world/semantic_types.h"));
  EXPECT_TRUE(fs::exists(include / "sim/world/store/world_file.h"));
  EXPECT_FALSE(fs::exists(include / "sim/world/graph/database_state.h")) << "the kernel's own";
}

void InstalledPlugin::imports_and_keeps_its_rules() {
  auto db = Database::create();
  Plugins plugins(*db);
  const auto loaded = plugins.load(folder_ / "build/beehives.so");
  ASSERT_TRUE(loaded) << loaded.error().text();
  ASSERT_EQ(plugins.list().size(), 1U);
  EXPECT_EQ(plugins.list().front().name, "beehives");
  const auto imported =
      plugins.import_file(rigor::test::source_dir() + "/examples/world-plugin/beehives.csv");
  ASSERT_TRUE(imported) << imported.error().text();
  const auto& s = db->schema();
  const auto type = s.require_type("Beehive");
  const auto hives = db->snapshot().nodes(type);
  ASSERT_EQ(hives.size(), 2U);
  const auto mass_kg = s.require<double>("Beehive", "mass_kg");
  const auto honey_kg = s.require<double>("Beehive", "honey_kg");
  const auto frames = s.require<std::int64_t>("Beehive", "frames");
  EXPECT_EQ(*db->snapshot().get(hives[0], s.require<std::string>("Beehive", "label")), "by the oak");
  EXPECT_DOUBLE_EQ(*db->snapshot().get(hives[0], mass_kg), 18 + 0.3 * 10 + 14.25);
  EXPECT_EQ(db->snapshot().in_radius(type, Vector3(14, -3.5, 0), 0.1), std::vector<NodeId>{hives[1]});
  {
    auto tx = db->begin();
    ASSERT_TRUE(tx.set(hives[0], honey_kg, 2.0));
    ASSERT_TRUE(tx.commit());
    EXPECT_DOUBLE_EQ(*db->snapshot().get(hives[0], mass_kg), 18 + 0.3 * 10 + 2);
  }
  {
    auto tx = db->begin();
    ASSERT_TRUE(tx.set(hives[0], frames, std::int64_t{0}));
    const auto vetoed = tx.commit();
    ASSERT_FALSE(vetoed);
    EXPECT_NE(vetoed.error().text().find("beehives.no_honey_without_frames"), std::string::npos);
    EXPECT_EQ(*db->snapshot().get(hives[0], frames), 10);
  }
  std::ofstream(folder_ / "bad.csv") << "label,x_m,y_m,frames,honey_kg\na,1,2,3,4\nb,1,two,3,4\n";
  const auto bad = plugins.import_file(folder_ / "bad.csv");
  ASSERT_FALSE(bad);
  EXPECT_NE(bad.error().text().find("bad.csv:3: y_m: expected a number, got 'two'"), std::string::npos)
      << bad.error().text();
  EXPECT_EQ(db->snapshot().node_count(), 2U);
  // What a plugin brought is kept and found again, with the plugin and without.
  {
    auto file = WorldFile::create(folder_ / "w", *db);
    ASSERT_TRUE(file) << file.error().text();
    ASSERT_TRUE((*file)->persist());
  }
  for (const bool with : {true, false}) {
    auto other = Database::create();
    Plugins more(*other);
    if (with) {
      ASSERT_TRUE(more.load(folder_ / "build/beehives.so"));
    }
    const auto file = WorldFile::open(folder_ / "w", *other);
    ASSERT_TRUE(file) << file.error().text();
    EXPECT_EQ(world_yaml(other->snapshot()), world_yaml(db->snapshot()));
    if (!with) {
      const auto late = more.load(folder_ / "build/beehives.so");
      EXPECT_TRUE(late) << late.error().text();
    }
  }
}

void InstalledPlugin::is_refused_when_a_header_has_changed() {
  const auto header = folder_ / "prefix/include/rigor/rigor/world_abi.h";
  std::ifstream in(header);
  std::string text((std::istreambuf_iterator<char>(in)), {});
  in.close();
  const auto at = text.find("DIGEST \"");
  ASSERT_NE(at, std::string::npos);
  text.replace(at + 8, 4, "beef");
  std::ofstream(header) << text;
  run("cmake --build '" + (folder_ / "build").string() + "'");
  auto db = Database::create();
  Plugins plugins(*db);
  const auto s = plugins.load(folder_ / "build/beehives.so");
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("got headers beef"), std::string::npos) << s.error().text();
  EXPECT_EQ(db->schema().type_count(), 1U);
}

// One test, since building takes its time.
TEST_F(InstalledPlugin, IsBuiltLoadedAndRefusedWhenAHeaderHasChanged) {
  stands_alone();
  imports_and_keeps_its_rules();
  is_refused_when_a_header_has_changed();
}

}  // namespace
}  // namespace rigor::world
