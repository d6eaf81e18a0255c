// The emulated USB3 Vision camera on a bus in memory, at instants that the test chooses.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>
#include <cmath>
#include <regex>
#include <set>

#include "drivers/aravis/u3v_genicam_xml.h"
#include "tests/drivers/aravis/u3v_bench.h"

namespace rigor::u3v {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::SizeIs;
using testing::TakenFrame;
using testing::U3vHost;

using testing::Bench;
using testing::kNow;
using testing::options;

TEST(U3vCamera, BootstrapRegistersLeadToTheDescription) {
  Bench b;
  EXPECT_EQ(b.host.read(reg::kGenCpVersion), 0x00010002U);
  EXPECT_EQ(testing::text_of(b.host.read_bytes(0x0004, 5)), "Rigor");
  EXPECT_EQ(testing::text_of(b.host.read_bytes(0x0144, 6)), std::string("U0001\0", 6));
  const auto sbrm = b.host.read<std::uint64_t>(0x01D8);
  EXPECT_EQ(b.host.read(sbrm + 0x1C), 1U) << "stream channels";
  EXPECT_EQ(b.host.read(sbrm + 0x40), 8U) << "SuperSpeed";
  const auto sirm = b.host.read<std::uint64_t>(sbrm + 0x20);
  EXPECT_EQ(b.host.read<std::uint64_t>(sirm + 0x08), 64U * 48U);
  EXPECT_EQ(1U << (b.host.read(sirm) >> 24), reg::kAlignment);
  const auto manifest = b.host.read<std::uint64_t>(0x01D0);
  EXPECT_EQ(b.host.read<std::uint64_t>(manifest), 1U);
  EXPECT_EQ((b.host.read(manifest + 12) >> 10) & 0x3F, 0U) << "not compressed";
  const auto address = b.host.read<std::uint64_t>(manifest + 16);
  const auto size = b.host.read<std::uint64_t>(manifest + 24);
  std::string xml;
  while (xml.size() < size) {
    const auto n =
        static_cast<std::uint16_t>(std::min<std::uint64_t>(reg::kMaxTransfer - 12, size - xml.size()));
    const auto piece = b.host.read_bytes(address + xml.size(), n);
    ASSERT_EQ(piece.size(), n);
    xml += testing::text_of(piece);
  }
  EXPECT_EQ(xml, make_genicam_xml(options().camera));
}

/// A register that the description names and the camera does not have would fail at a client's first look.
TEST(U3vCamera, EveryRegisterOfTheDescriptionIsThereWithItsAccess) {
  Bench b;
  const std::string& xml = b.device.camera().genicam_xml();
  const std::regex node(
      R"(<Address>(0x[0-9A-F]+)</Address>\s*<Length>(\d+)</Length>\s*<AccessMode>(\w+)</AccessMode>)");
  std::size_t registers = 0;
  for (std::sregex_iterator i(xml.begin(), xml.end(), node), end; i != end; ++i, ++registers) {
    const auto address = std::stoull((*i)[1], nullptr, 16);
    const auto bytes = static_cast<std::uint16_t>(std::stoul((*i)[2]));
    const std::string access = (*i)[3];
    const auto value = b.host.read_bytes(address, bytes);
    ASSERT_EQ(value.size(), bytes) << (*i)[0];
    const Status s = b.host.status_of(encode_write(++b.host.id, address, value));
    EXPECT_EQ(s, access == "RO" ? Status::write_protect : Status::success) << (*i)[0];
  }
  EXPECT_GE(registers, 35U);
  // What a node refers to is there.
  std::set<std::string> names;
  const std::regex name(R"re( Name="(\w+)")re"),
      use(R"(<p(?:Feature|Value|Max|IsLocked|Port|Variable Name="\w+")>(\w+)<)");
  for (std::sregex_iterator i(xml.begin(), xml.end(), name), end; i != end; ++i) names.insert((*i)[1]);
  for (std::sregex_iterator i(xml.begin(), xml.end(), use), end; i != end; ++i)
    EXPECT_EQ(names.count((*i)[1]), 1U) << (*i)[1];
}

TEST(U3vCamera, DescriptorsAreThoseOfUsb3Vision) {
  Bench b;
  const auto device = b.bus.control({0x80, 6, 0x0100, 0, 18})->data;
  EXPECT_EQ(device.substr(4, 3), "\xEF\x02\x01");
  const std::string c = b.bus.control({0x80, 6, 0x0200, 0, 512})->data;
  ASSERT_EQ(c.size(), static_cast<std::size_t>(load_le<std::uint16_t>(c, 2)));
  std::vector<std::string> interfaces;
  std::vector<int> endpoints;
  int guid = 0;
  std::size_t at = 0;
  for (; at < c.size() && c[at] != 0; at += static_cast<std::uint8_t>(c[at])) {
    if (c[at + 1] == 4) interfaces.push_back(c.substr(at + 5, 3));
    if (c[at + 1] == 5) endpoints.push_back(static_cast<std::uint8_t>(c[at + 2]));
    if (c[at + 1] == 0x24) guid = c[at + 11];
  }
  EXPECT_EQ(at, c.size()) << "descriptors do not end where the configuration does";
  EXPECT_THAT(interfaces, ElementsAre(std::string("\xEF\x05\0", 3), "\xEF\x05\x01", "\xEF\x05\x02"));
  EXPECT_THAT(endpoints, ElementsAre(0x01, 0x81, 0x82, 0x83));
  EXPECT_THAT(c.substr(9, 4), std::string("\x08\x0B\x00\x03", 4)) << "interfaces 0 to 2 are one function";
  // The GUID is the vendor's number and eight characters.
  const std::string text =
      b.bus.control({0x80, 6, static_cast<std::uint16_t>(0x0300 | guid), 0x0409, 255})->data;
  EXPECT_EQ(text.size(), 2 + 2 * 12U);
  EXPECT_EQ(text.substr(2, 2), std::string("1\0", 2));
}

TEST(U3vCamera, RefusesCommandsThatDoNotFit) {
  Bench b;
  const auto status = [&](const std::vector<std::uint8_t>& c) { return b.host.status_of(c); };
  const std::vector<std::uint8_t> four(4), eight(8);
  EXPECT_EQ(status(encode_read(1, 0x0500, 4)), Status::invalid_address);
  EXPECT_EQ(status(encode_read(2, reg::kImplementationEndianness, 8)), Status::invalid_address)
      << "over the end";
  EXPECT_EQ(status(encode_read(3, ~std::uint64_t{0} - 1, 8)), Status::invalid_address);
  EXPECT_EQ(status(encode_read(4, 0, 0)), Status::invalid_parameter);
  EXPECT_EQ(status(encode_read(5, reg::kXml, reg::kMaxTransfer)), Status::invalid_parameter)
      << "no room in an answer";
  EXPECT_EQ(status(encode_write(6, reg::kManufacturerName, four)), Status::write_protect);
  EXPECT_EQ(status(encode_write(7, reg::kXml, four)), Status::write_protect);
  EXPECT_EQ(status(encode_write(8, reg::kWidth + 2, four)), Status::invalid_address)
      << "half of two registers";
  EXPECT_EQ(status(encode_write(9, reg::kExposureTime, four)), Status::invalid_parameter) << "half a number";
  EXPECT_EQ(status(encode_write(10, reg::kGain + 8, eight)), Status::invalid_address) << "a gap";
  auto bad = encode_read(11, 0, 4);
  bad[8] = 11;  // a length that is not the message's
  EXPECT_EQ(status(bad), Status::invalid_header);
  bad = encode_read(12, 0, 4);
  bad[6] = 0x06;  // no command of GenCP
  const auto acks = b.host.command(bad);
  ASSERT_THAT(acks, SizeIs(1));
  EXPECT_EQ(acks[0].status, Status::not_implemented);
  EXPECT_EQ(acks[0].request_id, 12);
  EXPECT_EQ(b.device.camera().counters().refused, 12U);
  // What is no command at all gets no answer.
  bad[0] = 'X';
  EXPECT_EQ(b.bus.transfer(kControlOut, 24, testing::text_of(bad))->status, 0);
  EXPECT_FALSE(b.bus.transfer(kControlIn, 64));
  EXPECT_EQ(b.device.camera().counters().malformed, 2U);
}

TEST(U3vCamera, SeveralRegistersAreWrittenByOneCommand) {
  Bench b;
  std::vector<std::uint8_t> both;
  append_le(both, std::uint32_t{32});
  append_le(both, std::uint32_t{24});
  const auto acks = b.host.command(encode_write(1, reg::kWidth, both));
  ASSERT_THAT(acks, SizeIs(1));
  EXPECT_EQ(acks[0].status, Status::success);
  EXPECT_THAT(acks[0].data, ElementsAre(0, 0, 8, 0)) << "reserved, and the bytes that were written";
  EXPECT_EQ(b.host.read(reg::kWidth), 32U);
  EXPECT_EQ(b.host.read(reg::kHeight), 24U);
  EXPECT_EQ(b.host.read(reg::kPayloadSize), 32U * 24U);
}

TEST(U3vCamera, KeepsItsRegionWithinTheSensor) {
  Bench b;
  EXPECT_EQ(b.host.write(reg::kWidth, 66), Status::invalid_parameter);
  EXPECT_EQ(b.host.write(reg::kWidth, 33), Status::invalid_parameter) << "not a step";
  EXPECT_EQ(b.host.write(reg::kWidth, 8), Status::invalid_parameter) << "below the least";
  EXPECT_EQ(b.host.write(reg::kOffsetX, 2), Status::invalid_parameter)
      << "the region is as wide as the sensor";
  EXPECT_EQ(b.host.write(reg::kWidth, 32), Status::success);
  EXPECT_EQ(b.host.write(reg::kOffsetX, 32), Status::success);
  EXPECT_EQ(b.host.write(reg::kOffsetX, 34), Status::invalid_parameter);
  EXPECT_EQ(b.host.write(reg::kPixelFormat, static_cast<std::uint32_t>(PixelFormat::mono16)),
            Status::success);
  EXPECT_EQ(b.host.write(reg::kPixelFormat, static_cast<std::uint32_t>(PixelFormat::rgb8)),
            Status::invalid_parameter);
  EXPECT_EQ(b.host.read<std::uint64_t>(reg::kRequiredPayload), 32U * 48U * 2U);
  EXPECT_EQ(b.host.write(reg::kExposureTime, 5.0), Status::invalid_parameter);
  EXPECT_EQ(b.host.write(reg::kGain, std::nan("")), Status::invalid_parameter);
  EXPECT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  EXPECT_EQ(b.host.write(reg::kWidth, 16), Status::access_denied) << "while it acquires";
  EXPECT_EQ(b.host.write(reg::kTransferSize, 4096), Status::access_denied);
  EXPECT_EQ(b.host.write(reg::kGain, 3.0), Status::success);
}

TEST(U3vCamera, SendsEachFrameAsLeaderTransfersAndTrailer) {
  Bench b;
  EXPECT_EQ(b.host.write(reg::kOffsetX, 0), Status::success);
  EXPECT_EQ(b.host.write(reg::kHeight, 40), Status::success);
  EXPECT_EQ(b.host.write(reg::kOffsetY, 6), Status::success);
  ASSERT_EQ(b.host.open_stream(1024), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  for (std::uint64_t k = 0; k < 5; ++k) {
    b.run_until(kNow + milliseconds(10) * static_cast<std::int64_t>(k));
    const auto f = b.host.take_frame();
    ASSERT_TRUE(f);
    EXPECT_EQ(f->leader.block_id, k);
    EXPECT_EQ(f->leader.timestamp_ns, static_cast<std::uint64_t>(b.starts[k].ns()));
    EXPECT_EQ(f->leader.format, PixelFormat::mono8);
    EXPECT_EQ(f->leader.region, (Region{0, 6, 64, 40}));
    EXPECT_EQ(f->payload, std::string(64 * 40, static_cast<char>(k)));
    EXPECT_EQ(f->trailer.block_id, k);
    EXPECT_EQ(f->trailer.valid_bytes, 64U * 40U);
    EXPECT_EQ(f->trailer.status, Status::success);
    EXPECT_EQ(f->trailer.height_px, 40U);
  }
  EXPECT_EQ(b.device.counters().frames_sent, 5U);
  EXPECT_EQ(b.device.counters().bytes_sent, 5U * (52 + 64 * 40 + 32));
  EXPECT_EQ(b.starts[4] - b.starts[0], milliseconds(40));
}

TEST(U3vCamera, TransfersThatAreTooSmallCutTheFrameAndSaySo) {
  Bench b;
  ASSERT_EQ(b.host.open_stream(1024), Status::success);
  ASSERT_EQ(b.host.write(reg::kStreamControl, 0), Status::success);
  ASSERT_EQ(b.host.write(reg::kTransferCount, 1), Status::success);
  ASSERT_EQ(b.host.write(reg::kFinalTransfer2, 1024), Status::success);
  ASSERT_EQ(b.host.write(reg::kStreamControl, 1), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow);
  const auto f = b.host.take_frame();
  ASSERT_TRUE(f);
  EXPECT_EQ(f->payload.size(), 2048U) << "of 3072";
  EXPECT_EQ(f->trailer.status, Status::data_discarded);
  EXPECT_EQ(f->trailer.valid_bytes, 2048U);
  EXPECT_EQ(b.device.camera().counters().truncated, 1U);
}

TEST(U3vCamera, AStreamThatIsSetUpWronglyIsNotSwitchedOn) {
  Bench b;
  EXPECT_EQ(b.host.write(reg::kStreamControl, 1), Status::stream_inconsistent) << "no room for a leader";
  EXPECT_EQ(b.host.write(reg::kMaxLeader, 1024), Status::success);
  EXPECT_EQ(b.host.write(reg::kMaxTrailer, 1024), Status::success);
  EXPECT_EQ(b.host.write(reg::kFinalTransfer1, 1000), Status::success);
  EXPECT_EQ(b.host.write(reg::kStreamControl, 1), Status::stream_not_aligned);
  EXPECT_EQ(b.host.read(reg::kStreamControl), 0U);
  // Without a stream it exposes, and sends nothing.
  EXPECT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow + milliseconds(50));
  EXPECT_EQ(b.starts.size(), 6U);
  EXPECT_EQ(b.produced, 0U);
}

TEST(U3vCamera, AHostThatDoesNotReadLosesFramesWhoseNumbersAreMissing) {
  Bench b;
  ASSERT_EQ(b.host.open_stream(), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow + milliseconds(90));  // ten frames, room for four
  std::vector<std::uint64_t> ids;
  for (int i = 0; i < 4; ++i) ids.push_back(b.host.take_frame()->leader.block_id);
  EXPECT_THAT(ids, ElementsAre(0U, 1U, 2U, 3U));
  b.run_until(kNow + milliseconds(100));
  EXPECT_EQ(b.host.take_frame()->leader.block_id, 10U);
  b.run_until(kNow + milliseconds(120));
  EXPECT_EQ(b.host.write(reg::kStreamControl, 0), Status::success);
  const UsbDeviceCounters& c = b.device.counters();
  EXPECT_EQ(c.frames_sent, 5U);
  EXPECT_EQ(c.frames_dropped, 6U);
  EXPECT_EQ(c.frames_cut, 2U) << "waited when the stream was switched off";
  EXPECT_EQ(b.produced, c.frames_sent + c.frames_dropped + c.frames_cut);
}

TEST(U3vCamera, ResettingTheStreamsEndpointDropsWhatWaits) {
  Bench b;
  ASSERT_EQ(b.host.open_stream(), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow + milliseconds(10));
  const auto leader = b.bus.transfer(kStreamIn, 1024);  // and stops in the middle of the frame
  ASSERT_TRUE(leader);
  EXPECT_EQ(b.bus.control({0x02, 3, 0, kStreamIn, 0})->status, 0);
  EXPECT_EQ(b.bus.transfer(kStreamIn, 1024)->status, -EPIPE);
  EXPECT_EQ(b.bus.control({0x02, 1, 0, kStreamIn, 0})->status, 0);
  EXPECT_EQ(b.device.counters().frames_cut, 2U);
  b.run_until(kNow + milliseconds(20));
  const auto f = b.host.take_frame();
  ASSERT_TRUE(f);
  EXPECT_EQ(f->leader.block_id, 2U);
}

TEST(U3vCamera, TriggersExposeOnePictureEach) {
  Bench b;
  ASSERT_EQ(b.host.open_stream(), Status::success);
  EXPECT_EQ(b.host.write(reg::kTriggerSoftware, 1), Status::access_denied);
  ASSERT_EQ(b.host.write(reg::kTriggerMode, 1), Status::success);
  ASSERT_EQ(b.host.write(reg::kTriggerDelay, 500.0), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow + seconds(1));
  EXPECT_THAT(b.starts, SizeIs(0));
  b.device.set_now(kNow + seconds(1));
  EXPECT_EQ(b.host.write(reg::kTriggerSoftware, 1), Status::success);
  EXPECT_EQ(b.host.write(reg::kTriggerSoftware, 1), Status::success);
  b.run_until(kNow + seconds(2));
  ASSERT_THAT(b.starts, SizeIs(2));
  EXPECT_EQ(b.starts[0], kNow + seconds(1) + microseconds(500));
  EXPECT_EQ(b.starts[1], b.starts[0] + milliseconds(1)) << "the second waits until the sensor is free";
  for (int i = 0; i < 16; ++i) EXPECT_EQ(b.host.write(reg::kTriggerSoftware, 1), Status::success);
  EXPECT_EQ(b.host.write(reg::kTriggerSoftware, 1), Status::busy);
}

TEST(U3vCamera, TheLineTriggersOnItsEdgesAndMissesThoseThatComeTooSoon) {
  CameraOptions o = options();
  o.camera.line_period = milliseconds(4);
  o.camera.line_phase = microseconds(300);
  o.camera.exposure_us = 5000;
  Bench b(o);
  ASSERT_EQ(b.host.write(reg::kTriggerMode, 1), Status::success);
  ASSERT_EQ(b.host.write(reg::kTriggerSource, reg::kTriggerSourceLine1), Status::success);
  ASSERT_EQ(b.host.write(reg::kTriggerActivation, reg::kFallingEdge), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow + milliseconds(20));
  ASSERT_THAT(b.starts, SizeIs(3));
  EXPECT_EQ(b.starts[0], kNow + microseconds(2300));
  EXPECT_EQ(b.starts[1] - b.starts[0], milliseconds(8))
      << "every other edge comes while the sensor is exposed";
  EXPECT_EQ(b.device.camera().exposures().line_edges, 3U);
  EXPECT_EQ(b.device.camera().exposures().line_missed, 3U);
  b.device.set_now(kNow + microseconds(500));
  EXPECT_EQ(b.host.read(reg::kLineStatus), 1U);
  b.device.set_now(kNow + microseconds(2500));
  EXPECT_EQ(b.host.read(reg::kLineStatus), 0U);
}

TEST(U3vCamera, AnAcquisitionOfSomeFramesEndsByItself) {
  Bench b;
  ASSERT_EQ(b.host.open_stream(), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionMode, reg::kModeMultiFrame), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionFrameCount, 3), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow + seconds(1));
  EXPECT_EQ(b.produced, 3U);
  EXPECT_EQ(b.host.read(reg::kAcquisitionStatus), 0U);
  for (std::uint64_t k = 0; k < 3; ++k) EXPECT_EQ(b.host.take_frame()->leader.block_id, k);
  ASSERT_EQ(b.host.write(reg::kAcquisitionMode, reg::kModeSingleFrame), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow + seconds(2));
  EXPECT_EQ(b.host.take_frame()->leader.block_id, 0U) << "numbers begin anew with each acquisition";
}

TEST(U3vCamera, ASlowStartIsAnnouncedByPendingAck) {
  CameraOptions o = options();
  o.response_ms = 20;
  o.start_delay = milliseconds(150);
  Bench b(o);
  const auto start = encode_write(7, reg::kAcquisitionStart, std::vector<std::uint8_t>{1, 0, 0, 0});
  ASSERT_EQ(
      b.bus.transfer(kControlOut, static_cast<std::uint32_t>(start.size()), testing::text_of(start))->status,
      0);
  auto r = b.bus.transfer(kControlIn, 64);
  ASSERT_TRUE(r);
  auto ack = decode_ack(testing::bytes_of(r->data));
  ASSERT_TRUE(ack);
  EXPECT_EQ(ack->command, static_cast<std::uint16_t>(Command::pending_ack));
  EXPECT_EQ(ack->request_id, 7);
  EXPECT_THAT(ack->data, ElementsAre(0, 0, 170, 0)) << "ms until the answer";
  EXPECT_FALSE(b.bus.transfer(kControlIn, 64)) << "too early";
  b.device.advance(kNow + milliseconds(149));
  EXPECT_EQ(b.device.next_due(), kNow + milliseconds(150));
  b.device.advance(kNow + milliseconds(150));
  r = b.bus.transfer(kControlIn, 64);  // the transfer that waited got it
  b.run_until(kNow + milliseconds(200));
  ASSERT_FALSE(b.starts.empty());
  EXPECT_EQ(b.starts[0], kNow + milliseconds(150));
  // An answer that is quick enough comes alone.
  Bench quick;
  EXPECT_THAT(quick.host.command(start), SizeIs(1));
}

TEST(U3vCamera, EventsComeOnTheirEndpointWhereTheHostWantsThem) {
  Bench b;
  ASSERT_EQ(b.host.write(reg::kEventNotification, 1), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow);
  EXPECT_FALSE(b.bus.transfer(kEventIn, 64)) << "the event interface is off";
  ASSERT_EQ(b.host.write(reg::kEventControl, 1), Status::success);
  b.run_until(kNow + milliseconds(10));
  ASSERT_EQ(b.host.write(reg::kEventTest, 1), Status::success);
  // The transfer above still waits, and gets the first of them.
  const auto second = b.bus.transfer(kEventIn, 64);
  ASSERT_TRUE(second);
  const auto event = decode_event(testing::bytes_of(second->data));
  ASSERT_TRUE(event);
  EXPECT_EQ(event->event_id, kTestEvent);
  EXPECT_EQ(event->request_id, 1);
  b.run_until(kNow + milliseconds(20));
  const auto third = b.bus.transfer(kEventIn, 64);
  ASSERT_TRUE(third);
  const auto exposure = decode_event(testing::bytes_of(third->data));
  ASSERT_TRUE(exposure);
  EXPECT_EQ(exposure->event_id, kExposureStartEvent);
  EXPECT_EQ(exposure->timestamp_ns, static_cast<std::uint64_t>(b.starts[2].ns()));
}

TEST(U3vCamera, BeginsAnewWhenItIsPluggedIn) {
  Bench b;
  ASSERT_EQ(b.host.write(reg::kWidth, 32), Status::success);
  ASSERT_EQ(b.host.write(reg::kGain, 6.0), Status::success);
  ASSERT_EQ(b.host.status_of(encode_write(1, reg::kUserName, testing::bytes_of("right"))), Status::success);
  ASSERT_EQ(b.host.open_stream(), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow);
  b.session.end();
  EXPECT_EQ(b.device.camera().next_exposure(), DeviceTime::never());
  EXPECT_EQ(b.device.counters().frames_cut, 1U);
  usbip::Session again(b.device);
  usbip::testing::Host bus(again);
  ASSERT_EQ(bus.import("1-1"), usbip::kOk);
  U3vHost host(bus);
  EXPECT_EQ(host.read(reg::kWidth), 64U);
  EXPECT_EQ(host.read<double>(reg::kGain), 0.0);
  EXPECT_EQ(host.read(reg::kStreamControl), 0U);
  EXPECT_EQ(testing::text_of(host.read_bytes(reg::kUserName, 5)), std::string("left\0", 5));
}

TEST(U3vCamera, AHostThatReadsNoAnswersIsStalled) {
  Bench b;
  const auto command = testing::text_of(encode_read(1, 0, 4));
  int taken = 0;
  while (taken < 1000 &&
         b.bus.transfer(kControlOut, static_cast<std::uint32_t>(command.size()), command)->status == 0)
    ++taken;
  EXPECT_EQ(taken, 64);
}

TEST(U3vCamera, TimestampIsThatOfTheLastLatch) {
  Bench b;
  EXPECT_EQ(b.host.read<std::uint64_t>(reg::kTimestamp), 0U);
  b.device.set_now(kNow + nanoseconds(123));
  ASSERT_EQ(b.host.write(reg::kTimestampLatch, 1), Status::success);
  b.device.set_now(kNow + seconds(1));
  EXPECT_EQ(b.host.read<std::uint64_t>(reg::kTimestamp), 1'000'000'123U);
}

TEST(U3vCamera, SaysWhatItCannotBe) {
  CameraOptions o = options();
  o.camera.formats = {PixelFormat::coord3d_c16};
  o.camera.range.present = true;
  EXPECT_THAT(Camera::create(o).error().message, HasSubstr("3D camera"));
  o = options();
  o.camera.ptp.present = true;
  EXPECT_THAT(Camera::create(o).error().message, HasSubstr("ptp"));
  o = options();
  o.camera.exposure_us = 0;
  EXPECT_THAT(Camera::create(o).error().message, HasSubstr("exposure_us"));
  o = options();
  o.response_ms = 0;
  EXPECT_THAT(Camera::create(o).error().message, HasSubstr("response time"));
}

ExposureSchedule::Settings at_rate(std::int64_t hz) {
  ExposureSchedule::Settings s;
  s.period = Period::of_rate(hz);
  return s;
}

TEST(ExposureSchedule, ThirtyASecondDoNotDrift) {
  ExposureSchedule s(false, {});
  s.set(at_rate(30), kNow);
  s.start(kNow);
  DeviceTime last;
  for (int k = 0; k <= 3000; ++k) last = s.begin(s.next(), milliseconds(1))->start;
  EXPECT_EQ(last, kNow + seconds(100));
}

TEST(ExposureSchedule, SkipsWhatIsPastAndKeepsItsGrid) {
  ExposureSchedule s(true, {});
  s.set(at_rate(100), kNow);
  s.start(kNow + milliseconds(3));
  EXPECT_EQ(s.begin(kNow + milliseconds(10), milliseconds(1))->start, kNow + milliseconds(10))
      << "on the clock";
  EXPECT_FALSE(s.begin(kNow + milliseconds(19), milliseconds(1)));
  const auto e = s.begin(kNow + milliseconds(57), milliseconds(1));
  ASSERT_TRUE(e);
  EXPECT_EQ(e->start, kNow + milliseconds(50));
  EXPECT_EQ(e->index, 4U);
  EXPECT_EQ(s.counters().skipped, 3U);
}

TEST(ExposureSchedule, ANewRateHoldsFromTheLastExposureOn) {
  ExposureSchedule s(false, {});
  s.set(at_rate(10), kNow);
  s.start(kNow);
  EXPECT_TRUE(s.begin(kNow, milliseconds(1)));
  s.set(at_rate(100), kNow + milliseconds(2));
  EXPECT_EQ(s.next(), kNow + milliseconds(10));
  EXPECT_TRUE(s.begin(kNow + milliseconds(10), milliseconds(1)));
  s.set(at_rate(1), kNow + milliseconds(12));
  EXPECT_EQ(s.next(), kNow + milliseconds(1010));
}

}  // namespace
}  // namespace rigor::u3v
