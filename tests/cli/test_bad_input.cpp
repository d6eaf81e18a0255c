// What a user gets for input that is wrong: a message with its place, exit status 2, and nothing touched.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;
using ::testing::MatchesRegex;

constexpr const char* kChannel =
    "channels:\n  c: { kind: registers, backend: modbus, rate_hz: 100, address: 127.0.0.1, port: 5999, "
    "registers: [ { name: p, table: input_registers, address: 0, type: u16 } ] }\n";

class BadInput : public ::testing::Test {
 protected:
  Said run(const std::string& rig, std::vector<std::string> more = {}) {
    write_file(dir / "rig.yaml", rig);
    std::vector<std::string> words{"run", "rig.yaml", "--duration", "0.2"};
    words.insert(words.end(), more.begin(), more.end());
    return rigor(words, dir.path());
  }
  void expect_refused(const Said& said, const std::string& message) {
    EXPECT_EQ(said.status, 2) << said.err;
    EXPECT_THAT(said.err, HasSubstr(message));
    EXPECT_FALSE(std::filesystem::exists(dir / "out.mcap"));
    EXPECT_FALSE(std::filesystem::exists(dir / "report"));
  }
  TempDir dir;
};

TEST_F(BadInput, MissingFile) { expect_refused(rigor({"run", "nowhere.yaml"}, dir.path()), "nowhere.yaml"); }

TEST_F(BadInput, BrokenYamlSaysLineAndColumn) {
  const Said said = run("channels: {\n  c: [\n");
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, ::testing::ContainsRegex("rig.yaml:[0-9]+:[0-9]+:"));
}

TEST_F(BadInput, WrongType) {
  expect_refused(run("loop: { rate_hz: fast }\n"), "rig.yaml:1:18: loop.rate_hz: expected a number");
}

TEST_F(BadInput, UnknownKeyNamesTheNearest) {
  expect_refused(run("lop: { rate_hz: 1000 }\n"), "did you mean loop?");
}

TEST_F(BadInput, UnknownKeyOfABackendIsFoundToo) {
  std::string rig = kChannel;
  rig.replace(rig.find("port: 5999"), 10, "prot: 5999");
  const Said said = run(rig);
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, HasSubstr("prot"));
  EXPECT_THAT(said.err, HasSubstr("port"));
}

TEST_F(BadInput, NegativeRate) {
  expect_refused(run("channels:\n  c: { kind: image, backend: simulated, rate_hz: -25 }\n"),
                 "rate_hz: expected");
}

TEST_F(BadInput, RateAboveTheLoops) {
  expect_refused(run("channels:\n  c: { kind: image, backend: simulated, rate_hz: 3000 }\n"),
                 "at most the loop's 1000 Hz, got 3000");
}

TEST_F(BadInput, TwoChannelsWithOneName) {
  expect_refused(run(std::string(kChannel) + "  c: { kind: registers, backend: modbus, rate_hz: 100 }\n"),
                 "rig.yaml:3:");
}

TEST_F(BadInput, UnknownBackendListsTheOnesThereAre) {
  const Said said = run("channels:\n  c: { kind: image, backend: aravsi, rate_hz: 25 }\n");
  expect_refused(said, "did you mean aravis?");
}

TEST_F(BadInput, CameraThatIsNotThere) {
  const Said said =
      run("channels:\n  c: { kind: image, backend: aravis, rate_hz: 25, device: No-Such-Camera, interface: "
          "127.0.0.1 }\n");
  EXPECT_EQ(said.status, 2) << said.err;
  EXPECT_THAT(said.err, HasSubstr("No-Such-Camera"));
}

TEST_F(BadInput, ModbusDeviceThatIsNotThere) {
  const Said said = run(kChannel);
  EXPECT_EQ(said.status, 2) << said.err;
  EXPECT_THAT(said.err, HasSubstr("127.0.0.1"));
}

TEST_F(BadInput, RecordingThatCannotBeWritten) {
  write_file(dir / "file", "");
  expect_refused(run("loop: {}\n", {"--record", "file/out.mcap"}), "file/out.mcap");
}

TEST_F(BadInput, ReportThatCannotBeWritten) {
  write_file(dir / "file", "");
  expect_refused(run("loop: {}\n", {"--report", "file/report"}), "file/report");
}

TEST_F(BadInput, VirtualTimeWithoutAnEnd) {
  write_file(dir / "rig.yaml", "clock: virtual\n");
  expect_refused(rigor({"run", "rig.yaml"}, dir.path()), "duration");
}

TEST_F(BadInput, DeviceWithoutAnEmulatorInVirtualTime) {
  expect_refused(run(kChannel, {"--clock", "virtual"}), "expected an entry `c` in `emulators`");
}

TEST_F(BadInput, OptionsOfTheCommandLine) {
  EXPECT_EQ(rigor({"run"}).status, 2);
  EXPECT_EQ(rigor({"fly"}).status, 2);
  EXPECT_EQ(rigor({"run", config("demo.yaml"), "--set", "nonsense"}).status, 2);
  EXPECT_EQ(rigor({"sense", config("demo.yaml"), "--channel", "none", "-o", (dir / "x.png").string()}).status,
            2);
  EXPECT_EQ(
      rigor({"sense", config("demo.yaml"), "--channel", "right", "-o", (dir / "x.bmp").string()}).status, 2);
  EXPECT_EQ(rigor({"emulate", config("demo.yaml"), "--only", "nothing"}).status, 2);
  EXPECT_FALSE(std::filesystem::exists(dir / "x.png"));
}

TEST_F(BadInput, NumbersOfTheCommandLineHaveARange) {
  write_file(dir / "rig.yaml", "loop: {}\n");
  for (const char* seconds : {"nan", "inf", "1e300", "-1", "10s"}) {
    const Said said = rigor({"run", "rig.yaml", "--duration", seconds}, dir.path());
    expect_refused(said, "--duration: expected a number from 0 to 1e+07, got " + std::string(seconds));
    EXPECT_LT(said.err.size(), 300u) << said.err;
  }
  expect_refused(rigor({"run", "rig.yaml", "--duration", "0.1", "--pace", "nan"}, dir.path()),
                 "--pace: expected");
  expect_refused(
      rigor({"calibrate", "delay", "x", "--first", "a", "--second", "b", "--largest", "0"}, dir.path()),
      "--largest: expected a number above 0");
  expect_refused(rigor({"world", "render", "x.rigor", "-o", "x.png", "--eye", "nan,0,0"}, dir.path()),
                 "--eye: expected a number from -1e+08 to 1e+08, got nan");
}

TEST_F(BadInput, NumbersOfAWorldHaveARange) {
  write_file(dir / "world.yaml",
             "materials:\n  - { name: m, reflectance: { red: 1, green: 1, blue: 1, nir: 1 } }\n"
             "bodies:\n  - { name: b, material: m, size_m: [1, 1, 1], position_m: [1e300, 0, 0] }\n");
  expect_refused(rigor({"world", "info", "world.yaml"}, dir.path()),
                 "bodies.0.position_m.0: expected a number from -1e+08 to 1e+08, got 1e300");
}

TEST_F(BadInput, MoreSimulatedChannelsThanThePoolOfWorkersTakes) {
  // Before a world is read, and not after each of them was made.
  std::string rig = "simulation: { world: nowhere.yaml }\nchannels:\n";
  for (int i = 0; i < 300; ++i)
    rig +=
        "  c" + std::to_string(i) + ": { kind: image, backend: simulated, rate_hz: 10, sensor: none.yaml }\n";
  expect_refused(run(rig), "rig.yaml:131:9: channels.c128: expected at most 128 simulated channels in a rig");
}

TEST_F(BadInput, PicturesThatNoSensorHas) {
  expect_refused(
      run("channels:\n  c: { kind: image, backend: v4l2, rate_hz: 10, device: /dev/video0, width_px: "
          "60000, height_px: 60000 }\n"),
      "width_px: expected a picture of at most 268435456 pixels (16384 x 16384), got 60000 x 60000");
}

TEST_F(BadInput, MoreBoxesThanTheSmallRendererDraws) {
  std::string world =
      "materials:\n  - { name: m, reflectance: { red: 1, green: 1, blue: 1, nir: 1 } }\nbodies:\n";
  for (int i = 0; i < 20000; ++i)
    world += "  - { name: b" + std::to_string(i) + ", material: m, size_m: [1, 1, 1], position_m: [" +
             std::to_string(2 * i) + ", 0, 0] }\n";
  write_file(dir / "world.yaml", world);
  const Said said =
      run("simulation: { world: world.yaml }\nchannels:\n  c: { kind: image, backend: simulated, "
          "rate_hz: 10, T_world_sensor: {position_m: [0, 0, 1], look_at_m: [1, 0, 1]}, sensor: " +
              config("sensors/demo-camera.yaml") + " }\n",
          {"--clock", "virtual"});
  expect_refused(said, "bodies: expected at most ");
  EXPECT_THAT(said.err, HasSubstr("got 20000; give the channel `renderer: rays`"));
}

TEST_F(BadInput, AWordThatIsNoCommand) {
  expect_refused(rigor({"rnu", "rig.yaml"}, dir.path()), "got \"rnu\"; did you mean run?");
  expect_refused(rigor({"world", "improt"}, dir.path()), "got \"improt\"; did you mean import?");
  const Said far = rigor({"fly"}, dir.path());
  expect_refused(far, "expected one of the commands run, emulate, replay");
  EXPECT_EQ(far.err.find("did you mean"), std::string::npos) << far.err;
}

TEST_F(BadInput, NothingIsSuggestedWhereNothingIsNear) {
  const Said said = rigor({"emulate", config("demo.yaml"), "--only", "zzzz"}, dir.path());
  EXPECT_EQ(said.status, 2);
  EXPECT_EQ(said.err.find("did you mean"), std::string::npos) << said.err;
}

TEST_F(BadInput, InspectOfWhatIsNoRecording) {
  write_file(dir / "x.mcap", "this is no recording");
  EXPECT_EQ(rigor({"inspect", "x.mcap"}, dir.path()).status, 2);
  EXPECT_EQ(rigor({"inspect", "y.mcap"}, dir.path()).status, 2);
  EXPECT_EQ(rigor({"replay", "x.mcap"}, dir.path()).status, 2);
}

TEST_F(BadInput, InspectOfADamagedRecordingIsNoSuccess) {
  const Said made =
      rigor({"run", config("rigs/inertial.yaml"), "--duration", "0.3", "--record", "whole.mcap"}, dir.path());
  ASSERT_EQ(made.status, 0) << made.err;
  ASSERT_EQ(rigor({"inspect", "whole.mcap"}, dir.path()).status, 0);
  const std::string whole = read_file(dir / "whole.mcap");
  constexpr std::size_t kPlaces = 25;
  for (std::size_t i = 1; i <= kPlaces; ++i) {
    const std::size_t at = whole.size() * i / (kPlaces + 1);
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ 0x20);
    write_file(dir / "damaged.mcap", damaged);
    const Said flipped = rigor({"inspect", "damaged.mcap"}, dir.path());
    EXPECT_EQ(flipped.status, 1) << "byte " << at << ": " << flipped.out << flipped.err;
    EXPECT_THAT(flipped.err, HasSubstr("damaged.mcap: ")) << "byte " << at;
    write_file(dir / "damaged.mcap", whole.substr(0, at));
    const Said cut = rigor({"inspect", "damaged.mcap", "--json"}, dir.path());
    EXPECT_EQ(cut.status, 1) << "cut at " << at << ": " << cut.err;
  }
}

// A topic whose name is no UTF-8, in an MCAP file of one message by hand.
TEST_F(BadInput, InspectGivesJsonWhateverTheNamesInARecording) {
  const auto number = [](std::uint64_t v, int bytes) {
    std::string out;
    for (int i = 0; i < bytes; ++i) out += static_cast<char>(v >> 8 * i);
    return out;
  };
  const auto text = [&](const std::string& t) { return number(t.size(), 4) + t; };
  const auto record = [&](int op, const std::string& body) {
    return number(static_cast<std::uint64_t>(op), 1) + number(body.size(), 8) + body;
  };
  const std::string magic = "\x89MCAP0\r\n";
  write_file(dir / "names.mcap",
             magic + record(1, text("") + text("x")) +
                 record(4, number(1, 2) + number(0, 2) + text("/d\xFF") + text("json") + number(0, 4)) +
                 record(5, number(1, 2) + number(0, 4) + number(5, 8) + number(5, 8) + "{}") +
                 record(15, number(0, 4)) + record(2, std::string(20, '\0')) + magic);
  const Said said = rigor({"inspect", "names.mcap", "--json"}, dir.path());
  EXPECT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.out, HasSubstr("\"topic\": \"/d\xEF\xBF\xBD\""));
}

TEST_F(BadInput, JsonCarriesTheErrorToo) {
  const Said said = run("lop: {}\n", {"--json"});
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.out, HasSubstr("\"exit_status\":2"));
}

}  // namespace
}  // namespace rigor::test
