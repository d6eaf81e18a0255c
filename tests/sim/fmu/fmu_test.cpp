// Archives, descriptions and units, with nothing running.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "sim/fmu/fmu_archive.h"
#include "sim/fmu/units.h"
#include "sim/fmu/unpacked_fmu.h"
#include "tests/sim/fmu/made_fmu.h"

namespace rigor::fmu {
namespace {

using test::Folder;
using testing::HasSubstr;

std::string description3(const std::string& inside) {
  return "<fmiModelDescription fmiVersion=\"3.0\" modelName=\"m\" instantiationToken=\"t\">\n"
         "<CoSimulation modelIdentifier=\"m\"/>\n" +
         inside + "</fmiModelDescription>\n";
}
std::string refusal_of(const std::string& xml) {
  const auto d = parse_model_description(xml, "m.fmu/modelDescription.xml");
  return d ? "accepted" : d.error().text();
}

TEST(FmuArchive, RefusesNamesThatLeadOutOfItsFolder) {
  for (const char* name : {"../x", "a/../../x", "/etc/x", "a\\..\\x", "c:x", "a/..", ".."}) {
    SCOPED_TRACE(name);
    const Folder folder;
    test::write_zip(folder / "a.fmu", {{"modelDescription.xml", "x"}, {name, "x"}});
    const auto archive = FmuArchive::open(folder / "a.fmu");
    ASSERT_FALSE(archive);
    EXPECT_EQ(archive.error().code, ErrorCode::bad_input);
    EXPECT_THAT(archive.error().message, HasSubstr(std::string("\"") + name + "\""));
  }
  EXPECT_EQ(refused_name("resources/a..b/.x"), "");
}

TEST(FmuArchive, RefusesSymbolicLinks) {
  const Folder folder;
  test::write_zip(folder / "a.fmu", {{"resources/x", "/etc/passwd"}}, {"resources/x"});
  const auto archive = FmuArchive::open(folder / "a.fmu");
  ASSERT_FALSE(archive);
  EXPECT_THAT(archive.error().message, HasSubstr("symbolic link"));
}

TEST(FmuArchive, RefusesMoreEntriesOrBytesThanItsLimits) {
  const Folder folder;
  test::write_zip(folder / "a.fmu", {{"a", std::string(5000, 'x')}, {"b", std::string(5000, 'x')}});
  const auto with = [&](FmuArchive::Limits limits) { return FmuArchive::open(folder / "a.fmu", limits); };
  EXPECT_TRUE(with({.entries = 2, .total_bytes = 10000}));
  EXPECT_FALSE(with({.entries = 1}));
  EXPECT_FALSE(with({.total_bytes = 9999}));
  EXPECT_FALSE(with({.name_bytes = 0}));
  const auto archive = FmuArchive::open(folder / "a.fmu");
  ASSERT_TRUE(archive);
  EXPECT_EQ(archive->read("a", 5000)->size(), 5000u);
  EXPECT_FALSE(archive->read("a", 4999));
  EXPECT_EQ(archive->read("c", 1).error().code, ErrorCode::not_found);
}

/// The sizes in an archive's directory are not believed.
TEST(FmuArchive, CountsWhatItUnpacks) {
  const Folder folder;
  test::write_zip(folder / "a.fmu", {{"resources/x", std::string(100'000, 'x')}});
  std::string bytes = test::text_of(folder / "a.fmu");
  const std::string size{"\xa0\x86\x01\x00", 4}, lie{"\x01\x00\x00\x00", 4};
  for (std::size_t at = bytes.find(size); at != std::string::npos; at = bytes.find(size))
    bytes.replace(at, 4, lie);
  test::write_text(folder / "lie.fmu", bytes);
  const auto archive = FmuArchive::open(folder / "lie.fmu", {.total_bytes = 1000});
  if (!archive) return;  // libzip has seen that the two directories do not fit
  std::filesystem::create_directory(folder / "out");
  const std::vector<std::string> all{"resources/"};
  EXPECT_FALSE(archive->extract(folder / "out", all));
  EXPECT_FALSE(archive->read("resources/x", 1000));
}

TEST(FmuArchive, SaysWhatIsNoZipFile) {
  const Folder folder;
  test::write_text(folder / "a.fmu", "this is no archive");
  EXPECT_THAT(FmuArchive::open(folder / "a.fmu").error().text(), HasSubstr("expected an FMU (a zip file)"));
  EXPECT_EQ(FmuArchive::open(folder / "none.fmu").error().code, ErrorCode::not_found);
}

TEST(FmuArchive, UnpacksWhatThisMachineNeedsAndRemovesIt) {
  const Folder folder;
  const std::string own = "binaries/" + test::platform(3) + "/m.so";
  test::write_zip(folder / "m.fmu", {{"modelDescription.xml", description3("")},
                                     {own, "elf"},
                                     {"binaries/x86_64-windows/m.dll", "dll"},
                                     {"sources/m.c", "int x;"},
                                     {"resources/deep/table.csv", "1,2"}});
  std::filesystem::path unpacked;
  {
    const auto fmu = UnpackedFmu::open(folder / "m.fmu");
    ASSERT_TRUE(fmu) << fmu.error().text();
    unpacked = (*fmu)->folder();
    EXPECT_EQ(test::text_of(unpacked / own), "elf");
    EXPECT_EQ(test::text_of(unpacked / "resources/deep/table.csv"), "1,2");
    EXPECT_FALSE(std::filesystem::exists(unpacked / "sources"));
    EXPECT_FALSE(std::filesystem::exists(unpacked / "binaries/x86_64-windows"));
  }
  EXPECT_FALSE(std::filesystem::exists(unpacked));
}

TEST(FmuArchive, SaysForWhichMachinesAnFmuHasBinaries) {
  const Folder folder;
  test::write_zip(folder / "m.fmu",
                  {{"modelDescription.xml", description3("")}, {"binaries/x86_64-windows/m.dll", "dll"}});
  const auto fmu = UnpackedFmu::open(folder / "m.fmu");
  ASSERT_FALSE(fmu);
  EXPECT_THAT(fmu.error().text(), HasSubstr("found those for x86_64-windows"));
  test::write_zip(folder / "me.fmu", {{"modelDescription.xml",
                                       "<fmiModelDescription fmiVersion=\"3.0\" modelName=\"m\" "
                                       "instantiationToken=\"t\"><ModelExchange modelIdentifier=\"m\"/>"
                                       "</fmiModelDescription>"}});
  EXPECT_THAT(UnpackedFmu::open(folder / "me.fmu").error().text(), HasSubstr("model exchange alone"));
}

TEST(ModelDescription, ReadsVariablesOfBothVersions) {
  for (const int version : {2, 3}) {
    const Folder folder;
    const auto file = read_fmu(test::make_faulty_fmu(folder, version));
    ASSERT_TRUE(file) << file.error().text();
    const ModelDescription& d = file->description;
    EXPECT_EQ(d.version, version == 2 ? FmiVersion::v2 : FmiVersion::v3);
    EXPECT_EQ(d.token, "faulty");
    EXPECT_EQ(file->platforms, std::vector{test::platform(version)});
    ASSERT_TRUE(d.co_simulation);
    EXPECT_EQ(d.co_simulation->event_mode, version == 3);
    EXPECT_EQ(d.step_s, 0.01);
    const auto u = d.find("u"), count = d.find("count"), gain = d.find("gain");
    ASSERT_TRUE(u && count && gain);
    EXPECT_EQ(d.variables[u->variable].unit, "m/s");
    EXPECT_EQ(d.variables[u->variable].causality, Causality::input);
    EXPECT_EQ(d.variables[u->variable].variability, Variability::continuous);
    EXPECT_EQ(d.variables[count->variable].type, VariableType::int32);
    EXPECT_EQ(d.variables[count->variable].variability, Variability::discrete);
    EXPECT_EQ(d.variables[gain->variable].variability, Variability::tunable);
    // Terminals, by member.
    const auto member = d.find("axis.place");
    ASSERT_TRUE(member);
    EXPECT_EQ(d.variables[member->variable].name, "y");
    EXPECT_FALSE(d.find("axis.force"));
    EXPECT_FALSE(d.find("nothing"));
  }
}

TEST(ModelDescription, TakesTheUnitOfTheDeclaredTypeAndOfAnAlias) {
  const auto d = parse_model_description(
      description3(
          "<TypeDefinitions><Float64Type name=\"Place\" unit=\"m\"/></TypeDefinitions><ModelVariables>"
          "<Float64 name=\"h\" valueReference=\"1\" causality=\"output\" declaredType=\"Place\">"
          "<Alias name=\"height\"/></Float64></ModelVariables>"),
      "x");
  ASSERT_TRUE(d) << d.error().text();
  ASSERT_EQ(d->variables.size(), 2u);
  EXPECT_EQ(d->variables[0].unit, "m");
  EXPECT_EQ(d->variables[1].name, "height");
  EXPECT_EQ(d->variables[1].unit, "m");
  EXPECT_EQ(d->variables[1].value_reference, 1u);
}

TEST(ModelDescription, SizesArraysByConstantsAndStructuralParameters) {
  auto d = parse_model_description(
      description3(
          "<ModelVariables><UInt64 name=\"n\" valueReference=\"1\" causality=\"structuralParameter\" "
          "start=\"2\"/>"
          "<Float64 name=\"A\" valueReference=\"2\" causality=\"output\"><Dimension valueReference=\"1\"/>"
          "<Dimension start=\"3\"/></Float64></ModelVariables>"),
      "x");
  ASSERT_TRUE(d) << d.error().text();
  EXPECT_EQ(d->variables[1].elements, 6u);
  ASSERT_TRUE(d->find("A[2,1]"));
  EXPECT_EQ(d->find("A[2,1]")->element, 3u);
  EXPECT_TRUE(d->find("A")->whole);
  for (const char* name : {"A[3,1]", "A[0,1]", "A[1]", "A[1,1,1]", "A[1,]", "A[]", "n[1]", "A[1,4]"})
    EXPECT_FALSE(d->find(name)) << name;
  ASSERT_TRUE(set_structural_parameter(*d, 1, 4, "x"));
  EXPECT_EQ(d->variables[1].elements, 12u);
  EXPECT_TRUE(d->find("A[4,3]"));
  EXPECT_FALSE(set_structural_parameter(*d, 1, kMaxElements, "x"));
}

TEST(ModelDescription, SaysTheLineOfWhatItRefuses) {
  EXPECT_EQ(refusal_of("<a/>"), "m.fmu/modelDescription.xml: expected <fmiModelDescription>, got <a>");
  EXPECT_THAT(refusal_of("<fmiModelDescription>\n<a>\n</b>"),
              HasSubstr("modelDescription.xml:3: expected XML"));
  EXPECT_THAT(refusal_of(description3("<ModelVariables>\n<Float64 name=\"x\"/>\n</ModelVariables>")),
              HasSubstr("modelDescription.xml:4: <Float64> has no attribute valueReference"));
  EXPECT_THAT(refusal_of(description3(
                  "<ModelVariables><Float64 name=\"x\" valueReference=\"-1\"/></ModelVariables>")),
              HasSubstr("expected a whole number for valueReference, got \"-1\""));
  EXPECT_THAT(refusal_of(description3("<ModelVariables><Float64 name=\"x\" valueReference=\"1\" "
                                      "causality=\"outptu\"/></ModelVariables>")),
              HasSubstr("unknown causality \"outptu\""));
  EXPECT_THAT(refusal_of("<fmiModelDescription fmiVersion=\"1.0\" modelName=\"m\" guid=\"g\"/>"),
              HasSubstr("expected fmiVersion 2.0 or 3.0, got \"1.0\""));
  EXPECT_THAT(refusal_of("<fmiModelDescription fmiVersion=\"3.0\" modelName=\"m\" instantiationToken=\"t\">"
                         "<CoSimulation modelIdentifier=\"../../lib/evil\"/></fmiModelDescription>"),
              HasSubstr("expected an identifier of C"));
  EXPECT_THAT(refusal_of(description3(
                  "<ModelVariables><Float64 name=\"x\" valueReference=\"1\">"
                  "<Dimension start=\"100000\"/><Dimension start=\"100000\"/></Float64></ModelVariables>")),
              HasSubstr("at most 65536 elements"));
  EXPECT_THAT(refusal_of(description3("<ModelVariables><Float64 name=\"x\" valueReference=\"1\">"
                                      "<Dimension valueReference=\"9\"/></Float64></ModelVariables>")),
              HasSubstr("value reference 9"));
  EXPECT_THAT(refusal_of(description3("<ModelVariables>\n<Float64 name=\"x\" valueReference=\"1\"/>\n"
                                      "<Int32 name=\"x\" valueReference=\"2\"/></ModelVariables>")),
              HasSubstr("modelDescription.xml:5: expected a name for each variable, got \"x\" twice"));
}

TEST(Units, AreConvertedByTheirBaseUnits) {
  const auto d = parse_model_description(
      description3("<UnitDefinitions><Unit name=\"inch\"><BaseUnit m=\"1\" factor=\"0.0254\"/></Unit>"
                   "<Unit name=\"degF\"><BaseUnit K=\"1\" factor=\"0.5555555555555556\" "
                   "offset=\"255.3722222222222\"/></Unit>"
                   "<Unit name=\"furlong\"/></UnitDefinitions>"),
      "x");
  ASSERT_TRUE(d);
  std::string why;
  EXPECT_NEAR(conversion(*d, "inch", "mm", why)->to_asked(2), 50.8, 1e-12);
  EXPECT_NEAR(conversion(*d, "degC", "degF", why)->to_asked(100), 212, 1e-9);
  EXPECT_NEAR(conversion(*d, "degC", "degF", why)->to_own(32), 0, 1e-9);
  EXPECT_NEAR(conversion(*d, "rpm", "deg/s", why)->to_asked(1), 6, 1e-12);
  EXPECT_EQ(conversion(*d, "furlong", "furlong", why)->factor, 1);
  EXPECT_FALSE(conversion(*d, "inch", "kg", why));
  EXPECT_EQ(why, "inch and kg measure different quantities");
  EXPECT_FALSE(conversion(*d, "furlong", "m", why));
  EXPECT_EQ(why, "no conversion is known from furlong to m");
}

TEST(StartValues, AreThoseOfVariablesThatCanBeSet) {
  const Folder folder;
  auto d = read_fmu(test::make_faulty_fmu(folder))->description;
  const auto refused = [&](const std::string& name, const std::string& value) {
    const auto s = apply_start_values(d, {{name, value}}, "plants.x");
    return s ? std::string() : s.error().message;
  };
  EXPECT_EQ(refused("gain", "2"), "");
  EXPECT_EQ(refused("u", "2"), "");
  EXPECT_THAT(refused("gian", "2"), HasSubstr("did you mean gain?"));
  EXPECT_THAT(refused("y", "2"), HasSubstr("causality output"));
}

}  // namespace
}  // namespace rigor::fmu
