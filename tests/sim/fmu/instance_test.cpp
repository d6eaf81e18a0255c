// FMUs in this process: the Reference FMUs of the Modelica Association against their results, and FMUs that
// fail.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include "sim/fmu/fmu_instance.h"
#include "tests/sim/fmu/made_fmu.h"

namespace rigor::fmu {
namespace {

using test::Folder;
using testing::HasSubstr;

struct Table {
  std::vector<std::string> names;
  std::vector<std::vector<std::string>> rows;
};
Table read_csv(const std::filesystem::path& file) {
  Table t;
  std::istringstream in(test::text_of(file));
  for (std::string line; std::getline(in, line);) {
    std::vector<std::string> cells;
    std::istringstream row(line);
    for (std::string cell; std::getline(row, cell, ',');) cells.push_back(cell);
    if (t.names.empty())
      t.names = cells;
    else
      t.rows.push_back(cells);
  }
  return t;
}

struct Running {
  std::unique_ptr<UnpackedFmu> fmu;
  std::unique_ptr<FmuInstance> instance;
  std::vector<std::size_t> inputs, outputs;
  std::vector<double> values;
};
/// Empty `outputs`: none of its variables. The error is the test's failure.
Running start(const std::filesystem::path& file, const std::vector<std::string>& inputs,
              const std::vector<std::string>& outputs, const StartValues& start_values = {}) {
  Running r;
  auto fmu = UnpackedFmu::open(file);
  if (!fmu) throw std::runtime_error(fmu.error().text());
  r.fmu = std::move(*fmu);
  ModelDescription d = r.fmu->description();
  if (auto s = apply_start_values(d, start_values, "test"); !s) throw std::runtime_error(s.error().text());
  for (const auto& [names, list] : {std::pair{&inputs, &r.inputs}, std::pair{&outputs, &r.outputs}})
    for (const std::string& name : *names) {
      const auto found = d.find(name);
      if (!found) throw std::runtime_error("no variable " + name);
      list->push_back(found->variable);
    }
  r.values.resize(values_of(d, r.outputs));
  auto instance = load_instance(d, {"test", r.fmu->folder(), 0, start_values, r.inputs, r.outputs});
  if (!instance) throw std::runtime_error(instance.error().text());
  r.instance = std::move(*instance);
  if (auto s = r.instance->read(r.values); !s) throw std::runtime_error(s.error().text());
  return r;
}

class ReferenceFmu : public testing::TestWithParam<std::pair<const char*, int>> {};

/// The CSV files were written by the same sources on another machine: what differs is the last bits.
TEST_P(ReferenceFmu, GivesItsReferenceResults) {
  const auto& [model, version] = GetParam();
  if (!test::reference_fmus()) GTEST_SKIP() << "test data: no reference_fmus";
  const Folder folder;
  const auto file = test::make_reference_fmu(folder, model, version);
  ASSERT_TRUE(file);
  const Table csv = read_csv(*test::reference_fmus() / model / (std::string(model) + "_out.csv"));
  // Columns whose values are numbers; FMI 2 knows fewer types.
  const auto d = read_fmu(*file)->description;
  std::vector<std::string> names;
  std::vector<std::size_t> columns;
  for (std::size_t i = 1; i < csv.names.size(); ++i) {
    const auto found = d.find(csv.names[i]);
    if (!found || !is_number(d.variables[found->variable].type)) continue;
    names.push_back(csv.names[i]);
    columns.push_back(i);
  }
  ASSERT_FALSE(names.empty());
  Running r = start(*file, {}, names);
  double t_s = 0;
  std::size_t compared = 0;
  for (std::size_t row = 0; row < csv.rows.size(); ++row) {
    const double to_s = std::stod(csv.rows[row][0]);
    // An event is a second row of its instant: the state after it, which a communication point shows.
    if (row + 1 < csv.rows.size() && std::stod(csv.rows[row + 1][0]) == to_s) continue;
    if (to_s > t_s) {
      const auto s = r.instance->step(t_s, to_s - t_s, {}, false, r.values);
      ASSERT_TRUE(s) << s.error().text();
    }
    t_s = to_s;
    std::size_t at = 0;
    for (const std::size_t column : columns) {
      std::istringstream cell(csv.rows[row][column]);
      for (std::string word; cell >> word; ++at, ++compared) {
        const double want = word == "true" ? 1 : word == "false" ? 0 : std::stod(word);
        ASSERT_NEAR(r.values[at], want, 1e-9 * std::max(1.0, std::abs(want)))
            << csv.names[column] << " at t = " << to_s << " s";
      }
    }
    ASSERT_EQ(at, r.values.size());
  }
  EXPECT_GE(compared, csv.rows.size() / 2);
}

std::string name_of_model(const testing::TestParamInfo<std::pair<const char*, int>>& info) {
  return std::string(info.param.first) + std::to_string(info.param.second);
}
INSTANTIATE_TEST_SUITE_P(Models, ReferenceFmu,
                         testing::Values(std::pair{"BouncingBall", 2}, std::pair{"BouncingBall", 3},
                                         std::pair{"Dahlquist", 2}, std::pair{"Dahlquist", 3},
                                         std::pair{"Feedthrough", 2}, std::pair{"Feedthrough", 3},
                                         std::pair{"Resource", 2}, std::pair{"Resource", 3},
                                         std::pair{"Stair", 2}, std::pair{"Stair", 3},
                                         std::pair{"StateSpace", 3}, std::pair{"VanDerPol", 2},
                                         std::pair{"VanDerPol", 3}),
                         name_of_model);

/// Each type on its way in and out, with the limits of the integers that the reference input has.
TEST(FmuInstance, HandsValuesOfEveryTypeThrough) {
  if (!test::reference_fmus()) GTEST_SKIP() << "test data: no reference_fmus";
  const Folder folder;
  for (const int version : {2, 3}) {
    const auto file = test::make_reference_fmu(folder, "Feedthrough", version);
    const auto d = read_fmu(*file)->description;
    const std::vector<std::pair<std::string, std::vector<double>>> cases{
        {"Float32_continuous", {1.5, -0.25}},
        {"Float32_discrete", {3, -4}},
        {"Float64_continuous", {1e300, -0.1}},
        {"Float64_discrete", {0.1, 7}},
        {"Int8", {-128, 127}},
        {"UInt8", {0, 255}},
        {"Int16", {-32768, 32767}},
        {"UInt16", {0, 65535}},
        {"Int32", {-2147483648.0, 2147483647}},
        {"UInt32", {0, 4294967295.0}},
        {"Int64", {-9223372036854775808.0, 9007199254740992.0}},
        {"UInt64", {0, 18446744073709549568.0}},
        {"Boolean", {1, 0}},
        {"Enumeration", {2, 1}}};
    std::vector<std::string> ins, outs;
    for (const auto& [name, values] : cases)
      if (d.find(name + "_input")) ins.push_back(name + "_input"), outs.push_back(name + "_output");
    EXPECT_EQ(ins.size(), version == 2 ? 5u : 14u);
    Running r = start(*file, ins, outs);
    for (int i = 0; i < 2; ++i) {
      std::vector<double> in;
      for (const auto& [name, values] : cases)
        if (d.find(name + "_input")) in.push_back(values[static_cast<std::size_t>(i)]);
      const auto s = r.instance->step(0.1 * i, 0.1, in, true, r.values);
      ASSERT_TRUE(s) << s.error().text();
      for (std::size_t k = 0; k < in.size(); ++k)
        EXPECT_EQ(r.values[k], in[k]) << outs[k] << " of FMI " << version;
    }
  }
}

/// Arrays of other sizes than the FMU's own, set before it is initialised.
TEST(FmuInstance, TakesStructuralParameters) {
  const Folder folder;
  Running r = start(test::make_faulty_fmu(folder), {"v"}, {"w"}, {{"n", "3"}});
  ASSERT_EQ(r.values.size(), 3u);
  const std::vector<double> v{1, -2, 0.5};
  const auto s = r.instance->step(0, 0.01, v, true, r.values);
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_THAT(r.values, testing::ElementsAre(2, -4, 1));
}

/// x' = A x + B u
TEST(FmuInstance, TakesAndGivesArrays) {
  if (!test::reference_fmus()) GTEST_SKIP() << "test data: no reference_fmus";
  const Folder folder;
  const auto file = test::make_reference_fmu(folder, "StateSpace", 3);
  Running r = start(*file, {"u"}, {"y", "x"},
                    {{"A", "0 0 0 0 0 0 0 0 0"},
                     {"B", "1 10 0 0 1 0 0 0 1"},
                     {"C", "2 0 0 0 1 0 0 0 1"},
                     {"D", "0 0 0 0 0 0 0 0 0"}});
  ASSERT_EQ(r.values.size(), 6u);
  const std::vector<double> u{1, 0.5, 0};
  ASSERT_TRUE(r.instance->step(0, 1, u, true, r.values));
  EXPECT_NEAR(r.values[3], 6, 1e-9);  // (1 + 10 · 0.5) · 1 s
  EXPECT_NEAR(r.values[4], 0.5, 1e-9);
  EXPECT_NEAR(r.values[0], 12, 1e-9);
}

TEST(FmuInstance, TakesStartValuesByTheirTypes) {
  if (!test::reference_fmus()) GTEST_SKIP() << "test data: no reference_fmus";
  const Folder folder;
  for (const int version : {2, 3}) {
    const auto file = test::make_reference_fmu(folder, "BouncingBall", version);
    Running r = start(*file, {}, {"h", "v", "e"}, {{"h", "20"}, {"e", "0.9"}, {"g", "-1.62"}});
    EXPECT_EQ(r.values[0], 20);
    EXPECT_EQ(r.values[2], 0.9);
    ASSERT_TRUE(r.instance->step(0, 1, {}, false, r.values));
    EXPECT_NEAR(r.values[1], -1.62, 1e-9);
    EXPECT_THROW((void)start(*file, {}, {"h"}, {{"h", "much"}}), std::runtime_error);
    EXPECT_THROW((void)start(*file, {}, {"h"}, {{"h", "1 2"}}), std::runtime_error);
  }
}

TEST(FmuInstance, SaysWhichCallFailedWhenAndWhatTheFmuSaid) {
  const Folder folder;
  for (const int version : {2, 3}) {
    const std::string fmi = "fmi" + std::to_string(version);
    const auto file = test::make_faulty_fmu(folder, version);
    const auto message = [&](int mode) {
      Running r = start(file, {"u"}, {"y"}, {{"mode", std::to_string(mode)}, {"at", "0.03"}});
      const std::vector<double> u{2};
      for (int k = 0; k < 2; ++k)
        if (!r.instance->step(0.01 * k, 0.01, u, k == 0, r.values)) return std::string("too early");
      EXPECT_NEAR(r.values[0], 0.04, 1e-12);
      const auto s = r.instance->step(0.02, 0.01, u, false, r.values);
      return s ? std::string("no failure") : s.error().message;
    };
    EXPECT_EQ(message(4), fmi + "DoStep returned " + fmi + "Error at t = 0.02 s: the valve is stuck");
    EXPECT_EQ(message(5), fmi + "DoStep returned " + fmi + "Fatal at t = 0.02 s");
    EXPECT_EQ(message(9), fmi + "DoStep returned " + fmi + "Discard at t = 0.02 s");
    EXPECT_EQ(message(0), "no failure");
  }
  Running ends = start(test::make_faulty_fmu(folder), {}, {"y"}, {{"mode", "6"}});
  EXPECT_TRUE(ends.instance->step(0, 0.01, {}, false, ends.values));
  EXPECT_EQ(ends.instance->step(0.01, 0.01, {}, false, ends.values).error().message,
            "the FMU ended the simulation by itself at t = 0.01 s");
  Running early = start(test::make_faulty_fmu(folder), {}, {"y"}, {{"mode", "8"}});
  EXPECT_EQ(early.instance->step(0, 0.01, {}, false, early.values).error().message,
            "fmi3DoStep returned early 1000 times in one step");
}

/// FMI 3.0: an event in the middle of a step, handled in Event Mode; then the rest of the step.
TEST(FmuInstance, HandlesEventsWithinAStep) {
  const Folder folder;
  Running r = start(test::make_faulty_fmu(folder), {"u"}, {"y", "count"}, {{"mode", "11"}});
  const std::vector<double> u{2};
  for (int k = 0; k < 3; ++k) {
    const auto s = r.instance->step(0.01 * k, 0.01, u, k == 0, r.values);
    ASSERT_TRUE(s) << s.error().text();
    EXPECT_NEAR(r.values[0], 0.02 * (k + 1), 1e-12);
    EXPECT_EQ(r.values[1], 2 * (k + 1));
  }
}

TEST(FmuInstance, SaysWhatIsNoSharedObject) {
  const Folder folder;
  test::write_zip(folder / "m.fmu",
                  {{"modelDescription.xml",
                    "<fmiModelDescription fmiVersion=\"3.0\" modelName=\"m\" instantiationToken=\"t\">"
                    "<CoSimulation modelIdentifier=\"m\"/></fmiModelDescription>"},
                   {"binaries/" + test::platform(3) + "/m.so", "this is no shared object"}});
  const auto fmu = UnpackedFmu::open(folder / "m.fmu");
  ASSERT_TRUE(fmu);
  const auto instance = load_instance((*fmu)->description(), {"m", (*fmu)->folder(), 0, {}, {}, {}});
  ASSERT_FALSE(instance);
  EXPECT_EQ(instance.error().code, ErrorCode::unavailable);
  EXPECT_THAT(instance.error().message, HasSubstr("the FMU cannot be loaded"));
}

}  // namespace
}  // namespace rigor::fmu
