// Serial lines: settings, speeds, exclusive use, pseudo-terminals, links that are cut and that vanish.
#include "drivers/serial/serial_line.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <thread>

#include "drivers/serial/byte_link.h"
#include "drivers/serial/device_end.h"
#include "drivers/serial/serial_ports.h"

namespace rigor::serial {
namespace {

using testing::HasSubstr;
namespace fs = std::filesystem;

ConfigNode node(const std::string& yaml) { return ConfigDocument::parse(yaml, "line.yaml").value(); }
std::string refusal(const std::string& yaml) {
  const auto read = catch_config([&] { return SerialSettings::parse(node(yaml), {}); });
  return read ? "taken" : read.error().text();
}

TEST(SerialLine, SettingsHaveTheDefaultsOfTheirProtocol) {
  const auto modbus = SerialSettings::parse(node("{}"), {19200, 'E', true, 8});
  EXPECT_EQ(modbus.text(), " (19200 8E1)");
  EXPECT_EQ(modbus.bits_per_character(), 11U);
  EXPECT_EQ(SerialSettings::parse(node("{parity: none}"), {19200, 'E', true, 8}).text(), " (19200 8N2)");
  const auto own = SerialSettings::parse(node("{baud: 4000000, parity: odd, data_bits: 7, stop_bits: 2, "
                                              "rs485: {rts_on_send: low, after_send_ms: 3}}"),
                                         {.least_data_bits = 7});
  EXPECT_EQ(own.text(), " (4000000 7O2, RS-485)");
  EXPECT_FALSE(own.rs485->rts_high_on_send);
  EXPECT_EQ(own.rs485->after_send, milliseconds(3));
  EXPECT_THAT(refusal("{baud: 12345}"), HasSubstr("line.yaml:1:8: baud: expected one of 1200, 1800"));
  EXPECT_THAT(refusal("{parity: mark}"), HasSubstr("expected one of none, even, odd"));
  EXPECT_THAT(refusal("{baud: auto}"), HasSubstr("baud"));
  EXPECT_THAT(refusal("{rs485: {rts: high}}"), HasSubstr("rts"));
}

TEST(SerialLine, EverySpeedIsSetAndReadBack) {
  auto pty = PseudoTerminal::open("", PseudoTerminal::FarEnd::released);
  ASSERT_TRUE(pty) << pty.error().text();
  EXPECT_FALSE(pty->has_client());
  for (const unsigned baud : {1200U, 9600U, 38400U, 115200U, 921600U, 1500000U, 4000000U}) {
    SerialSettings s;
    s.device = pty->path();
    s.baud = baud;
    const auto port = open_serial(s);
    ASSERT_TRUE(port) << port.error().text();
    EXPECT_EQ(baud_of(port->get()), baud);
    EXPECT_EQ(baud_of(pty->line()), baud) << "as the near end sees it";
    EXPECT_TRUE(pty->has_client());
    EXPECT_TRUE(set_baud(port->get(), 57600));
    EXPECT_EQ(baud_of(pty->line()), 57600U);
    EXPECT_FALSE(set_baud(port->get(), 57601));
  }
  EXPECT_EQ(baud_of(-1), 0U);
}

TEST(SerialLine, AnExclusivePortIsForOneProgramAndErrorsSayWhatToDo) {
  auto pty = PseudoTerminal::open("");
  ASSERT_TRUE(pty);
  SerialSettings s;
  s.device = pty->path();
  {
    const auto first = open_serial(s, Sharing::exclusive);
    ASSERT_TRUE(first);
    const auto second = open_serial(s, Sharing::exclusive);
    ASSERT_FALSE(second);
    EXPECT_EQ(second.error().code, ErrorCode::unavailable);
    EXPECT_THAT(second.error().text(), HasSubstr("another program has the port"));
  }
  EXPECT_TRUE(make_serial_link(s)->open());
  s.device = "/dev/no-such-port";
  const auto none = open_serial(s);
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::not_found);
  EXPECT_THAT(none.error().text(), HasSubstr("rigor devices"));
  s.device = "/dev/null";
  EXPECT_THAT(open_serial(s).error().text(), HasSubstr("check that `device` is a serial port"));
  s.device = pty->path();
  s.rs485.emplace();
  EXPECT_THAT(open_serial(s).error().text(), HasSubstr("cannot switch the port to RS-485"));
}

TEST(SerialLine, AFileOfSomebodysIsNoLinkToReplace) {
  const std::string file = testing::TempDir() + "rigor-serial-file";
  std::ofstream(file) << "mine";
  EXPECT_THAT(PseudoTerminal::open(file).error().text(), HasSubstr("expected no file or a symbolic link"));
  fs::remove(file);
  {
    const auto pty = PseudoTerminal::open(file);
    ASSERT_TRUE(pty);
    EXPECT_TRUE(is_pseudo_terminal(file));
  }
  EXPECT_FALSE(fs::is_symlink(file));
  EXPECT_FALSE(is_pseudo_terminal("/dev/null"));
}

TEST(ByteLink, WaitsEndWithBytesTimeCutsAndVanishedDevices) {
  auto end = make_pty_end("");
  ASSERT_TRUE(end->open());
  SerialSettings s;
  s.device = end->endpoint();
  const auto link = make_serial_link(s);
  ASSERT_TRUE(link->open());
  ASSERT_GE(end->fd(), 0);
  std::array<char, 16> buffer{};
  const MonotonicTime before = monotonic_now();
  EXPECT_EQ(link->receive(buffer, before + milliseconds(20)).state, ByteLink::State::timeout);
  EXPECT_GE(monotonic_now() - before, milliseconds(20));
  ASSERT_EQ(put_bytes(end->fd(), "abc", 3), 3);
  const auto r = link->receive(buffer, monotonic_now() + seconds(10));
  EXPECT_EQ(r.state, ByteLink::State::data);
  EXPECT_EQ(std::string(buffer.data(), r.bytes), "abc");
  ASSERT_TRUE(link->send("hello"));
  EXPECT_EQ(::read(end->fd(), buffer.data(), buffer.size()), 5);
  end.reset();
  EXPECT_EQ(link->receive(buffer, monotonic_now() + seconds(10)).state, ByteLink::State::gone);
  link->close();
  EXPECT_FALSE(link->set_baud(9600));
  std::thread cutter([&] { link->cut(); });
  EXPECT_FALSE(link->wait(MonotonicTime::never() - seconds(1)));
  cutter.join();
}

TEST(SerialPorts, AreListedByTheNameThatSurvivesReplugging) {
  const fs::path root = fs::path(testing::TempDir()) / "rigor-serial-ports";
  fs::remove_all(root);
  for (const char* name : {"ttyUSB0", "ttyS0", "ttyS1", "tty1"}) {
    fs::create_directories(root / "sys" / name);
    fs::create_directories(root / "dev");
    std::ofstream(root / "dev" / name) << "";
  }
  fs::create_directories(root / "drivers" / "ftdi_sio");
  for (const char* name : {"ttyUSB0", "ttyS0", "ttyS1"}) {
    fs::create_directories(root / "sys" / name / "device");
    fs::create_directory_symlink(root / "drivers" / "ftdi_sio", root / "sys" / name / "device" / "driver");
  }
  std::ofstream(root / "sys" / "ttyS0" / "type") << "4\n";
  std::ofstream(root / "sys" / "ttyS1" / "type") << "0\n";  // nothing is behind it
  fs::create_directories(root / "dev" / "serial" / "by-id");
  fs::create_symlink(root / "dev" / "ttyUSB0", root / "dev" / "serial" / "by-id" / "usb-u-blox_GNSS-if00");
  const auto ports = list_serial_ports(root / "sys", root / "dev");
  ASSERT_EQ(ports.size(), 2U);
  EXPECT_EQ(ports[0].path, (root / "dev" / "ttyS0").string());
  EXPECT_EQ(ports[1].stable_path, (root / "dev" / "serial" / "by-id" / "usb-u-blox_GNSS-if00").string());
  EXPECT_EQ(ports[1].driver, "ftdi_sio");
  EXPECT_TRUE(ports[1].holder.empty());
  {
    std::ifstream open(root / "dev" / "ttyUSB0");
    EXPECT_THAT(list_serial_ports(root / "sys", root / "dev")[1].holder,
                HasSubstr(std::to_string(::getpid())));
  }
  fs::remove_all(root);
}

TEST(SerialPorts, DoctorSaysWhatIsMissing) {
  const auto findings =
      serial_findings({{"/dev/ttyUSB0", "", "ftdi_sio", false, ""},
                       {"/dev/ttyACM0", "/dev/serial/by-id/x", "cdc_acm", true, "gpsd (process 7)"}});
  std::string all;
  for (const auto& f : findings) all += f.what + " | " + f.cure + "\n";
  EXPECT_THAT(all, HasSubstr("/dev/ttyUSB0 is not for this user | sudo usermod -aG dialout"));
  EXPECT_THAT(all, HasSubstr("/dev/ttyACM0 is in use by gpsd (process 7)"));
  EXPECT_THAT(all, HasSubstr("/dev/serial/by-id/x"));
  EXPECT_EQ(findings[0].level, DoctorFinding::Level::missing);
  EXPECT_EQ(serial_findings({}).size(), 1U);
}

}  // namespace
}  // namespace rigor::serial
