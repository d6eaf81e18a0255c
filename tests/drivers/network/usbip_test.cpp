// The server's side of USB/IP, in memory: what a host may ask, and what it may not.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>

#include "drivers/network/usbip_session.h"
#include "tests/drivers/network/usbip_host.h"

namespace rigor::usbip {
namespace {

using ::testing::ElementsAre;
using testing::Host;

/// A device with bulk endpoints 0x01 and 0x81, which says again what it is told.
class EchoDevice final : public Device {
 public:
  EchoDevice() : Device(describe()) {}
  void say(const std::string& text, std::uint64_t tag = 0) {
    const auto m = std::make_shared<const std::vector<std::uint8_t>>(text.begin(), text.end());
    send(0x81, m, 0, m->size(), tag);
  }
  using Device::set_plugged;
  int attached = 0, detached = 0, resets = 0;
  std::vector<std::uint64_t> sent;

 private:
  static Descriptors describe() {
    Descriptors d;
    d.device = {18, 1, 0, 2, 0xFF, 0, 0, 64, 0x09, 0x12, 0x01, 0x00, 0, 1, 1, 2, 0, 1};
    d.configuration = {9, 2, 32, 0, 1, 1, 0, 0x80, 50, 9, 4, 0,    0, 2, 0xFF, 0,
                       0, 0, 7,  5, 1, 2, 0, 2,    0,  7, 5, 0x81, 2, 0, 2,    0};
    d.strings = {"Rigor", "Echo"};
    d.exported.bus_id = "3-2";
    d.exported.path = "/sys/devices/3-2";
    d.exported.vendor = 0x1209, d.exported.product = 0x0001;
    d.exported.speed = Speed::high;
    d.exported.device_class = {0xFF, 0, 0};
    d.exported.interfaces = {{0xFF, 1, 2}};
    return d;
  }
  void on_attach() override { ++attached; }
  void on_detach() override { ++detached; }
  bool on_write(std::uint8_t, Bytes data) override {
    if (data.empty()) return false;
    say({data.begin(), data.end()});
    return true;
  }
  void on_sent(std::uint8_t, std::uint64_t tag) override { sent.push_back(tag); }
  void on_reset(std::uint8_t) override { ++resets; }
};

struct Plugged {
  EchoDevice device;
  Session session{device};
  Host host{session};
  Plugged() { EXPECT_EQ(host.import("3-2"), kOk); }
};

TEST(UsbIp, ListsTheDeviceWithItsInterfaces) {
  EchoDevice device;
  Session session(device);
  Host host(session);
  const auto all = host.list();
  ASSERT_EQ(all.size(), 1U);
  EXPECT_EQ(all[0].bus_id, "3-2");
  EXPECT_EQ(all[0].path, "/sys/devices/3-2");
  EXPECT_EQ(all[0].vendor, 0x1209);
  EXPECT_EQ(all[0].speed, Speed::high);
  ASSERT_EQ(all[0].interfaces.size(), 1U);
  EXPECT_EQ(all[0].interfaces[0].subclass, 1);
  device.set_plugged(false);
  EXPECT_EQ(host.list().size(), 0U);
}

TEST(UsbIp, OneHostHasTheDeviceAtATime) {
  EchoDevice device;
  Session first(device), second(device);
  Host host(first), other(second);
  EXPECT_EQ(host.import("3-2"), kOk);
  ASSERT_TRUE(host.imported);
  EXPECT_EQ(host.imported->product, 1);
  EXPECT_EQ(other.import("3-2"), kUnavailable);
  EXPECT_FALSE(other.open());
  first.end();
  EXPECT_EQ(device.attached, 1);
  EXPECT_EQ(device.detached, 1);
  Session third(device);
  Host next(third);
  EXPECT_EQ(next.import("3-2"), kOk);
}

TEST(UsbIp, ADeviceThatIsNotThereIsNotImported) {
  EchoDevice device;
  Session session(device), another(device);
  Host host(session), later(another);
  EXPECT_EQ(host.import("3-3"), kNoDevice);
  EXPECT_FALSE(host.open());
  device.set_plugged(false);
  EXPECT_EQ(later.import("3-2"), kNoDevice);
  EXPECT_EQ(device.attached, 0);
}

TEST(UsbIp, AnswersWhatEveryDeviceIsAsked) {
  Plugged p;
  auto r = p.host.control({0x80, 6, 0x0100, 0, 64});
  ASSERT_TRUE(r);
  EXPECT_EQ(r->status, 0);
  EXPECT_EQ(r->data.size(), 18U);
  r = p.host.control({0x80, 6, 0x0200, 0, 9});  // cut to what was asked for
  ASSERT_TRUE(r);
  EXPECT_EQ(r->data.size(), 9U);
  EXPECT_EQ(r->length, 9U);
  r = p.host.control({0x80, 6, 0x0302, 0x0409, 255});
  ASSERT_TRUE(r);
  EXPECT_EQ(r->data, std::string("\x0a\x03"
                                 "E\0c\0h\0o\0",
                                 10));
  for (const SetupPacket& unknown : {SetupPacket{0x80, 6, 0x0303, 0, 255}, SetupPacket{0x80, 6, 0x0F00, 0, 5},
                                     SetupPacket{0xC0, 1, 0, 0, 4}, SetupPacket{0x00, 9, 2, 0, 0},
                                     SetupPacket{0x01, 11, 1, 0, 0}, SetupPacket{0x02, 3, 0, 0x85, 0}}) {
    r = p.host.control(unknown);
    ASSERT_TRUE(r);
    EXPECT_EQ(r->status, -EPIPE) << static_cast<int>(unknown.request);
  }
  EXPECT_EQ(p.host.control({0x00, 9, 1, 0, 0})->status, 0);
  EXPECT_EQ(p.host.control({0x80, 8, 0, 0, 1})->data, "\x01");
}

TEST(UsbIp, ATransferWaitsUntilThereIsAMessageAndTakesOne) {
  Plugged p;
  const auto first = p.host.submit(0x81, 64), second = p.host.submit(0x81, 3);
  EXPECT_FALSE(p.host.take(first));
  p.device.say("abc", 1);
  p.device.say("defgh", 2);
  const auto a = p.host.take(first);
  ASSERT_TRUE(a);
  EXPECT_EQ(a->data, "abc");
  const auto b = p.host.take(second);
  ASSERT_TRUE(b);
  EXPECT_EQ(b->data, "def");
  EXPECT_THAT(p.device.sent, ElementsAre(1U)) << "the rest of the second message has not left";
  const auto c = p.host.transfer(0x81, 64);
  ASSERT_TRUE(c);
  EXPECT_EQ(c->data, "gh");
  EXPECT_THAT(p.device.sent, ElementsAre(1U, 2U));
}

TEST(UsbIp, AnOutTransferReachesTheDevice) {
  Plugged p;
  const auto out = p.host.transfer(0x01, 5, "hello");
  ASSERT_TRUE(out);
  EXPECT_EQ(out->status, 0);
  EXPECT_EQ(out->length, 5U);
  EXPECT_EQ(p.host.transfer(0x81, 64)->data, "hello");
  EXPECT_EQ(p.host.transfer(0x01, 0)->status, -EPIPE) << "the device refused it";
  EXPECT_EQ(p.host.transfer(0x02, 1, "x")->status, -EPIPE) << "there is no such endpoint";
}

TEST(UsbIp, UnlinkGivesUpAWaitingTransferAndNoOther) {
  Plugged p;
  const auto first = p.host.submit(0x81, 64), second = p.host.submit(0x81, 64);
  EXPECT_EQ(p.host.unlink(first), -ECONNRESET);
  p.device.say("for the second");
  const auto r = p.host.take(second);
  ASSERT_TRUE(r);
  EXPECT_EQ(r->data, "for the second");
  EXPECT_EQ(p.host.unlink(second), 0) << "it was answered before";
  EXPECT_EQ(p.session.counters().unlinks, 2U);
  EXPECT_EQ(p.session.counters().unlinked, 1U);
}

TEST(UsbIp, AHaltedEndpointStallsUntilItIsCleared) {
  Plugged p;
  const auto waiting = p.host.submit(0x81, 64);
  EXPECT_EQ(p.host.control({0x02, 3, 0, 0x81, 0})->status, 0);
  EXPECT_EQ(p.host.take(waiting)->status, -EPIPE);
  EXPECT_EQ(p.host.control({0x82, 0, 0, 0x81, 2})->data, std::string("\1\0", 2));
  EXPECT_EQ(p.host.transfer(0x81, 64)->status, -EPIPE);
  p.device.say("lost with the reset");
  EXPECT_EQ(p.host.control({0x02, 1, 0, 0x81, 0})->status, 0);
  EXPECT_EQ(p.device.resets, 2);
  p.device.say("new");
  EXPECT_EQ(p.host.transfer(0x81, 64)->data, "new");
}

TEST(UsbIp, WhatIsNoUsbIpEndsTheConnection) {
  const auto broken = [](const std::string& bytes, bool imported) {
    EchoDevice device;
    Session session(device);
    std::string in, out;
    if (imported) {
      append_operation(in, {kVersion, kImportRequest, 0});
      append_bus_id(in, "3-2");
      EXPECT_TRUE(session.receive(in, out));
    }
    in += bytes;
    const bool open = session.receive(in, out);
    return !open && session.counters().malformed == 1;
  };
  EXPECT_TRUE(broken("GET / HTTP/1.1\r\n\r\n", false));
  const auto message = [](Header h) {
    std::string out;
    append_header(out, h);
    return out;
  };
  Header h;
  h.endpoint = 1;
  h.length = kMaxOutBytes + 1;
  EXPECT_TRUE(broken(message(h), true)) << "more than a device takes";
  h.length = 4;
  h.packets = 8;
  EXPECT_TRUE(broken(message(h), true)) << "isochronous";
  h.packets = 0;
  h.endpoint = 16;
  EXPECT_TRUE(broken(message(h), true));
  h.endpoint = 1;
  h.command = Command::submitted;
  EXPECT_TRUE(broken(message(h), true)) << "a return is the server's";
  EXPECT_TRUE(broken(std::string(48, '\0'), true));
  std::string many;
  h.command = Command::submit;
  h.in = true;
  for (std::size_t i = 0; i <= kMaxTransfers; ++i) many += message(h);
  EXPECT_TRUE(broken(many, true)) << "more transfers than are kept";
}

TEST(UsbIp, BytesMayComeInAnyPieces) {
  const auto run = [](std::size_t piece) {
    EchoDevice device;
    Session session(device);
    std::string all, in, out;
    append_operation(all, {kVersion, kImportRequest, 0});
    append_bus_id(all, "3-2");
    Header h;
    h.sequence = 1, h.endpoint = 1, h.length = 300;
    append_header(all, h);
    all += std::string(300, 'x');
    h.sequence = 2, h.in = true, h.length = 1000;
    append_header(all, h);
    for (std::size_t at = 0; at < all.size(); at += piece) {
      in += all.substr(at, piece);
      EXPECT_TRUE(session.receive(in, out));
    }
    EXPECT_TRUE(in.empty());
    return out;
  };
  const std::string whole = run(100'000);
  EXPECT_EQ(whole.size(), kOperationBytes + kDeviceBytes + 2 * kHeaderBytes + 300);
  for (const std::size_t piece : {std::size_t{1}, std::size_t{7}, std::size_t{48}})
    EXPECT_EQ(run(piece), whole);
}

}  // namespace
}  // namespace rigor::usbip
