// Plugins of the world by the command: --plugin, and the keys `plugins` and `plugin_files`. The shared
// objects are those of tests/sim/world/plugin: `good` defines the type Left, whose rule refuses x = 7.
#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

#include "tests/cli/sensing_fixture.h"

namespace rigor::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

std::string plugin_file(const std::string& name) { return RIGOR_TEST_MODULES "/" + name + ".so"; }

class WorldPlugins : public SensingBench {
 protected:
  void SetUp() override {
    SensingBench::SetUp();
    fs::create_directory(dir / "lib");
    fs::copy_file(plugin_file("good"), dir / "lib/good.so");
    write_file(dir / "left.yaml", left("2"));
    write_file(dir / "seven.yaml", left("7"));
    write_file(dir / "own.yaml", "plugins: [lib/good.so]\n" + left("2"));
  }
  static std::string left(const std::string& x) {
    return "rigor_world: 1\nnext_id: 2\nnodes:\n  - { id: 1, type: Left, attributes: { x: " + x + " } }\n";
  }
  void refused(const std::vector<std::string>& words, const std::vector<std::string>& parts) const {
    const Said said = in_dir(words);
    EXPECT_EQ(said.status, 2) << words.back() << ": " << said.err;
    for (const auto& part : parts) EXPECT_THAT(said.err, HasSubstr(part));
  }
};

TEST_F(WorldPlugins, BringTypesRulesAndImporters) {
  refused({"world", "info", "left.yaml"}, {"Left"});
  const Said said = in_dir({"world", "info", "left.yaml", "--plugin", "lib/good.so", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json info = json::parse(said.out);
  EXPECT_EQ(info["types"]["Left"], 1);
  EXPECT_EQ(info["plugins"][0]["rules"], json::array({"left.throws_at_seven"}));
  EXPECT_THAT(in_dir({"world", "info", "left.yaml", "--plugin", "lib/good.so"}).out,
              HasSubstr("plugin  broken 1"));
  // Its rule holds while the world is read.
  refused({"world", "info", "seven.yaml", "--plugin", "lib/good.so"}, {"seven.yaml", "left.throws_at_seven"});
  // Its importer reads files.
  write_file(dir / "a.left", "");
  const Said made =
      in_dir({"world", "import", "--plugin", "lib/good.so", "--plugin-file", "a.left", "-o", "w.rigor"});
  EXPECT_EQ(made.status, 0) << made.err;
  EXPECT_TRUE(fs::exists(dir / "w.rigor"));
  refused({"world", "import", "--plugin", "lib/good.so", "--plugin-file", "a.left=right", "-o", "v.rigor"},
          {"--plugin-file", "a.left", "no importer has the name 'right'", "left"});
  refused({"world", "import", "--plugin-file", "a.left", "-o", "v.rigor"},
          {"--plugin-file", "a.left", "load a plugin that has one"});
  EXPECT_FALSE(fs::exists(dir / "v.rigor"));
}

TEST_F(WorldPlugins, AreNamedByWorldsAndRigsAgainstTheirOwnFolders) {
  const Said own = rigor({"world", "info", file("own.yaml"), "--json"}, "/");
  ASSERT_EQ(own.status, 0) << own.err;
  EXPECT_EQ(json::parse(own.out)["types"]["Left"], 1);
  write_file(dir / "a.left", "");
  write_file(dir / "data.import.yaml", "plugins: [lib/good.so]\nplugin_files: [a.left]\n");
  const Said data = rigor({"world", "import", file("data.import.yaml"), "-o", file("d.rigor")}, "/");
  EXPECT_EQ(data.status, 0) << data.err;
  // A rig whose world needs the plugin: by the rig, by the command line, by both.
  scanner_rig(
      "    renderer: rays\n    T_world_sensor: { position_m: [0, 0, 0], roll_pitch_yaw_deg: [0, 0, 0] }\n");
  const std::vector<std::string> run{
      "run", file("rig.yaml"), "--duration", "0.1", "--json", "--set", "simulation.world=left.yaml"};
  refused(run, {"Left"});
  for (const std::vector<std::string>& more :
       {std::vector<std::string>{"--plugin", file("lib/good.so")},
        std::vector<std::string>{"--set", "simulation.plugins=[lib/good.so]"},
        std::vector<std::string>{"--set", "simulation.plugins=[lib/good.so]", "--plugin",
                                 file("lib/good.so")}}) {
    std::vector<std::string> words = run;
    words.insert(words.end(), more.begin(), more.end());
    const Said said = rigor(words, "/");
    EXPECT_EQ(said.status, 0) << more.back() << ": " << said.err;
  }
  const Said taken = in_dir({"sense", "rig.yaml", "--channel", "flat", "-o", "flat.pcd", "--set",
                             "simulation.world=left.yaml", "--plugin", "lib/good.so"});
  EXPECT_EQ(taken.status, 0) << taken.err;
  refused({"run", "rig.yaml", "--set", "simulation.world=left.yaml", "--set",
           "simulation.plugins=[lib/good.so]", "--record", "lib/good.so"},
          {"lib/good.so", "a plugin of the world"});
}

TEST_F(WorldPlugins, ThatCannotBeHadSayWhoNamesThemAndWhatToDo) {
  refused({"world", "info", "left.yaml", "--plugin", "none.so"}, {"--plugin: none.so", "no such file"});
  refused({"world", "info", "left.yaml", "--plugin", "left.yaml"},
          {"--plugin: left.yaml", "expected", "shared object"});
  refused({"world", "info", "left.yaml", "--plugin", plugin_file("broken_no_entry")},
          {"broken_no_entry.so", "RIGOR_WORLD_PLUGIN"});
  refused({"world", "info", "left.yaml", "--plugin", plugin_file("broken_abi")},
          {"broken_abi.so", "expected", "got", "build the plugin again"});
  refused({"world", "info", "left.yaml", "--plugin", plugin_file("broken_throws")}, {"out of bees"});
  // Another file with a plugin of the same name.
  fs::copy_file(plugin_file("good"), dir / "lib/again.so");
  refused({"world", "info", "left.yaml", "--plugin", "lib/good.so", "--plugin", "lib/again.so"},
          {"again.so", "expected each plugin once", "good.so"});
  write_file(dir / "wrong.yaml", "plugins: [lib/none.so]\n" + left("2"));
  refused({"world", "info", "wrong.yaml"}, {"wrong.yaml:1:", "lib/none.so", "no such file"});
  refused({"run", "rig.yaml", "--set", "simulation.plugins=[none.so]"}, {"none.so", "no such file"});
  write_file(dir / "bare.yaml",
             "name: bare\nduration_s: 1\nsimulation: { plugins: [lib/good.so] }\nchannels: {}\n");
  refused({"run", "bare.yaml"}, {"simulation.plugins", "expected a `world`"});
}

}  // namespace
}  // namespace rigor::test
