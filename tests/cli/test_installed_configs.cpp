// Rigs and worlds that come along, by their names, in a folder that has none of them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

TEST(InstalledConfigs, RigsAreFoundByNameWhereTheFolderHasNone) {
  const TempDir dir;
  for (const char* name : {"inertial", "inertial.yaml", "rigs/inertial", "configs/rigs/inertial.yaml"}) {
    const Said said = rigor({"run", name, "--duration", "0.01"}, dir.path());
    EXPECT_EQ(said.status, 0) << name << ": " << said.err;
  }
  EXPECT_TRUE(std::filesystem::exists(dir / "inertial.mcap")) << "outputs lie where the user is";
}

TEST(InstalledConfigs, AFileThatIsThereComesFirst) {
  const TempDir dir;
  write_file(dir / "inertial.yaml", "lop: {}\n");
  const Said said = rigor({"run", "inertial.yaml"}, dir.path());
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, HasSubstr("inertial.yaml:1:1: lop: unknown key"));
}

TEST(InstalledConfigs, WhatCameAlongIsListed) {
  const Said said = rigor({"rigs", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  std::size_t found = 0;
  const json listed = json::parse(said.out);
  for (const json& rig : listed["rigs"]) {
    EXPECT_TRUE(std::filesystem::exists(rig["file"].get<std::string>())) << rig;
    EXPECT_GT(rig["about"].get<std::string>().size(), 10u) << rig;
    found += rig["name"] == "demo" || rig["name"] == "velodyne";
  }
  EXPECT_EQ(found, 2u);
}

TEST(InstalledConfigs, WorldsAndTheirSourcesAreFoundToo) {
  const TempDir dir;
  const Said said = rigor({"world", "info", "configs/worlds/testbed.yaml"}, dir.path());
  EXPECT_EQ(said.status, 0) << said.err;
  EXPECT_EQ(rigor({"world", "info", "../worlds/testbed.yaml"}, dir.path()).status, 2)
      << "a way up is meant as it is";
}

}  // namespace
}  // namespace rigor::test
