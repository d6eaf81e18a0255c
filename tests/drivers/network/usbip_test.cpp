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

TEST(UsbIp, HeadersLieInTheirBytesAsTheKernelDocumentsThem) {
  const auto bytes = [](const Header& h) {
    std::string out;
    append_header(out, h);
    std::string text;
    for (const char c : out) text += "0123456789abcdef"[(c >> 4) & 15], text += "0123456789abcdef"[c & 15];
    return text;
  };
  const std::string from_host =
      "01020304"
      "00010002";
  Header h;
  h.sequence = 0x01020304, h.device_id = 0x00010002, h.in = true, h.endpoint = 3, h.length = 0x1000;
  h.setup = encode_setup({0x80, 6, 0x0302, 0x0409, 255});
  EXPECT_EQ(bytes(h), "00000001" + from_host +
                          "00000001"
                          "00000003"
                          "00000000"
                          "00001000"
                          "00000000"
                          "00000000"
                          "00000000"
                          "800602030904ff00");
  h.command = Command::submitted, h.status = -32;
  EXPECT_EQ(bytes(h), "00000003" + from_host +
                          "00000001"
                          "00000003"
                          "ffffffe0"
                          "00001000"
                          "00000000"
                          "00000000"
                          "00000000"
                          "0000000000000000");
  h.command = Command::unlink, h.unlink = 0x0A0B0C0D;
  EXPECT_EQ(bytes(h), "00000002" + from_host +
                          "00000001"
                          "00000003"
                          "0a0b0c0d" +
                          std::string(48, '0'));
  h.command = Command::unlinked, h.status = -104;
  EXPECT_EQ(bytes(h), "00000004" + from_host +
                          "00000001"
                          "00000003"
                          "ffffff98" +
                          std::string(48, '0'));
}

TEST(UsbIp, AHeaderIsReadFromTheSamePlaces) {
  std::vector<std::uint8_t> b(kHeaderBytes);
  store_be(b, 0, std::uint32_t{1});
  store_be(b, 4, std::uint32_t{0x01020304});
  store_be(b, 12, std::uint32_t{1});
  store_be(b, 16, std::uint32_t{3});
  store_be(b, 24, std::uint32_t{0x1000});
  store_be(b, 32, std::uint32_t{0xFFFFFFFF});  // what the kernel says of a transfer that is not isochronous
  b[40] = 0x80, b[47] = 1;
  auto h = decode_header(b);
  ASSERT_TRUE(h);
  EXPECT_EQ(h->sequence, 0x01020304U);
  EXPECT_TRUE(h->in);
  EXPECT_EQ(h->endpoint, 3U);
  EXPECT_EQ(h->length, 0x1000U);
  EXPECT_EQ(h->packets, 0U);
  EXPECT_EQ(h->setup[0], 0x80);
  EXPECT_EQ(decode_setup(h->setup).length, 0x0100);
  store_be(b, 0, std::uint32_t{3});
  store_be(b, 20, std::int32_t{-32});
  EXPECT_EQ(decode_header(b)->status, -32);
  store_be(b, 0, std::uint32_t{2});
  store_be(b, 20, std::uint32_t{77});
  EXPECT_EQ(decode_header(b)->unlink, 77U);
}

TEST(UsbIp, AnIsochronousTransferHasItsStartAndItsPackets) {
  std::string out;
  Header h;
  h.command = Command::submitted, h.start_frame = 0x01020304, h.packets = 2;
  append_header(out, h);
  EXPECT_EQ(out.substr(28, 8), std::string("\1\2\3\4\0\0\0\2", 8));
  append_isochronous_packet(out, {0x0C00, 0x0C00, 0x0A, -18});
  ASSERT_EQ(out.size(), kHeaderBytes + kIsochronousPacketBytes);
  EXPECT_EQ(out.substr(kHeaderBytes), std::string("\0\0\x0C\0\0\0\x0C\0\0\0\0\x0A\xFF\xFF\xFF\xEE", 16));
  const Bytes bytes(reinterpret_cast<const std::uint8_t*>(out.data()), out.size());
  EXPECT_EQ(decode_header(bytes)->start_frame, 0x01020304U);
  const IsochronousPacket p = decode_isochronous_packet(bytes.subspan(kHeaderBytes));
  EXPECT_EQ(p.length, 0x0C00U);
  EXPECT_EQ(p.actual_length, 10U);
  EXPECT_EQ(p.status, -18);
}

TEST(UsbIp, ADeviceLiesInItsBytesAsTheKernelDocumentsIt) {
  ExportedDevice d;
  d.path = "/sys/devices/3-2";
  d.bus_id = std::string(40, '7');  // more than its field
  d.bus = 3, d.number = 2, d.speed = Speed::super;
  d.vendor = 0x1209, d.product = 0x000A, d.release = 0x0100;
  d.device_class = {0xEF, 2, 1};
  d.interfaces = {{0xFF, 1, 2}};
  std::string out;
  append_device(out, d, true);
  ASSERT_EQ(out.size(), kDeviceBytes + 4);
  EXPECT_EQ(out.substr(0, 17), std::string("/sys/devices/3-2\0", 17));
  EXPECT_EQ(out.substr(256, 32), std::string(31, '7') + '\0');
  EXPECT_EQ(out.substr(288),
            std::string("\0\0\0\3\0\0\0\2\0\0\0\5\x12\x09\0\x0A\1\0\xEF\2\1\1\1\1\xFF\1\2\0", 28));
  const Bytes all(reinterpret_cast<const std::uint8_t*>(out.data()), out.size());
  const auto read = decode_device(all, true);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->bus, 3U);
  EXPECT_EQ(read->number, 2U);
  EXPECT_EQ(read->vendor, 0x1209);
  EXPECT_EQ(read->product, 0x000A);
  EXPECT_FALSE(decode_device(all.first(all.size() - 1), true)) << "its interface is not whole";
  EXPECT_FALSE(decode_device(all.first(kDeviceBytes - 1), false));
}

TEST(UsbIp, AnotherVersionEndsTheConnection) {
  EchoDevice device;
  Session session(device);
  std::string in, out;
  append_operation(in, {0x0106, kListRequest, 0});
  EXPECT_FALSE(session.receive(in, out));
  EXPECT_EQ(session.counters().malformed, 1U);
}

TEST(UsbIp, TransfersThatWereAnsweredOrGivenUpMakeRoomForOthers) {
  Plugged p;
  for (std::size_t i = 0; i <= kMaxTransfers; ++i) {
    ASSERT_EQ(p.host.unlink(p.host.submit(0x81, 64)), -ECONNRESET);
    p.device.say("x");
    ASSERT_TRUE(p.host.transfer(0x81, 64)) << i;
  }
  EXPECT_TRUE(p.host.open());
}

TEST(UsbIp, AControlTransferIsCutToItsBufferAndGoesInOneDirection) {
  Plugged p;
  auto r = p.host.take(p.host.submit(0, 5, {}, {0x80, 6, 0x0100, 0, 18}));  // a buffer of 5 bytes
  ASSERT_TRUE(r);
  EXPECT_EQ(r->data.size(), 5U);
  // An OUT transfer whose setup stage says IN.
  std::string in, out;
  Header h;
  h.sequence = 99;
  h.setup = encode_setup({0x80, 6, 0x0100, 0, 18});
  append_header(in, h);
  ASSERT_TRUE(p.session.receive(in, out));
  const auto reply = decode_header({reinterpret_cast<const std::uint8_t*>(out.data()), out.size()});
  ASSERT_TRUE(reply);
  EXPECT_EQ(reply->status, -EPIPE);
  EXPECT_EQ(p.session.counters().stalls, 1U);
}

TEST(UsbIp, RefusedRequestsAreCountedAsStalls) {
  Plugged p;
  EXPECT_EQ(p.host.control({0x02, 3, 0, 0x01, 0})->status, 0);
  EXPECT_EQ(p.host.transfer(0x01, 2, "no")->status, -EPIPE) << "a halted endpoint takes nothing";
  EXPECT_EQ(p.host.transfer(0x82, 64)->status, -EPIPE) << "there is no such endpoint";
  EXPECT_EQ(p.host.control({0x81, 10, 0, 1, 1})->status, -EPIPE) << "there is one interface";
  EXPECT_EQ(p.host.control({0x81, 10, 0, 0, 1})->status, 0);
  EXPECT_EQ(p.host.control({0xA0, 6, 0x0100, 0, 18})->status, -EPIPE) << "a request of a class";
  EXPECT_EQ(p.host.control({0x80, 6, 0x0201, 0, 9})->status, -EPIPE) << "there is one configuration";
  EXPECT_EQ(p.host.control({0x01, 11, 0, 0, 0})->status, 0);
  EXPECT_EQ(p.host.control({0x01, 11, 1, 0, 0})->status, -EPIPE) << "and one setting";
  EXPECT_EQ(p.session.counters().stalls, 6U);
}

TEST(UsbIp, StringsAreEnglishAndAsLongAsADescriptorCanBe) {
  Plugged p;
  EXPECT_EQ(p.host.control({0x80, 6, 0x0300, 0, 255})->data, "\x04\x03\x09\x04");
  const std::string longest = string_descriptor(std::string(500, 'x'));
  EXPECT_EQ(longest.size(), 254U);
  EXPECT_EQ(static_cast<std::uint8_t>(longest[0]), 254);
}

TEST(UsbIp, ANewHostFindsTheDeviceAsAfterPowerOn) {
  EchoDevice device;
  {
    Session session(device);
    Host host(session);
    ASSERT_EQ(host.import("3-2"), kOk);
    ASSERT_EQ(host.control({0x00, 9, 1, 0, 0})->status, 0);
    ASSERT_EQ(host.control({0x02, 3, 0, 0x01, 0})->status, 0);
    device.say("for the host before");
  }
  Session session(device);
  Host host(session);
  ASSERT_EQ(host.import("3-2"), kOk);
  EXPECT_EQ(host.control({0x80, 8, 0, 0, 1})->data, std::string(1, '\0')) << "not configured";
  EXPECT_EQ(host.control({0x82, 0, 0, 0x01, 2})->data, std::string(2, '\0')) << "not halted";
  EXPECT_FALSE(host.take(host.submit(0x81, 64)));
}

}  // namespace
}  // namespace rigor::usbip
