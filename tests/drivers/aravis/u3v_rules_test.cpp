// What the emulated USB3 Vision camera keeps to: which registers are locked and when, what becomes of frames
// on their way, and what a new host finds.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>

#include "tests/drivers/aravis/u3v_bench.h"

namespace rigor::u3v {
namespace {

using testing::Bench;
using ::testing::IsEmpty;
using testing::kNow;
using testing::options;
using ::testing::SizeIs;
using testing::U3vHost;

/// A frame that was exposed and has not been sent yet.
std::optional<Frame> expose(Bench& b, bool filled = true) {
  FrameJob job;
  const DeviceTime at = b.device.camera().next_exposure();
  if (!b.device.camera().begin_frame(at, job)) return std::nullopt;
  b.device.set_now(at);
  return b.device.camera().finish_frame(std::move(job), filled);
}

TEST(U3vRules, ARefusedReadHasNoData) {
  Bench b;
  const auto acks = b.host.command(encode_read(1, 0x0500, 4));
  ASSERT_THAT(acks, SizeIs(1));
  EXPECT_EQ(acks[0].status, Status::invalid_address);
  EXPECT_THAT(acks[0].data, IsEmpty());
}

TEST(U3vRules, ACommandThatWantsNoAcknowledgeIsCarriedOutWithoutOne) {
  Bench b;
  auto write = encode_write(1, reg::kWidth, std::vector<std::uint8_t>{32, 0, 0, 0});
  write[5] = 0;  // flags
  const auto out =
      b.bus.transfer(kControlOut, static_cast<std::uint32_t>(write.size()), testing::text_of(write));
  ASSERT_TRUE(out);
  EXPECT_EQ(out->status, 0);
  const auto acks = b.host.command(encode_read(2, reg::kWidth, 4));
  ASSERT_THAT(acks, SizeIs(1));
  EXPECT_EQ(acks[0].request_id, 2) << "an answer to the write";
  EXPECT_EQ(acks[0].data, (std::vector<std::uint8_t>{32, 0, 0, 0}));
}

TEST(U3vRules, ACommandBeyondTheTransferLimitIsRefused) {
  Bench b;
  EXPECT_EQ(b.host.status_of(encode_write(1, reg::kUserName, std::vector<std::uint8_t>(reg::kMaxTransfer))),
            Status::invalid_parameter);
}

TEST(U3vRules, AnAnswerWithinTheResponseTimeIsNotAnnounced) {
  CameraOptions o = options();
  o.response_ms = 20;
  o.start_delay = milliseconds(20);
  Bench b(o);
  const auto start = encode_write(7, reg::kAcquisitionStart, std::vector<std::uint8_t>{1, 0, 0, 0});
  ASSERT_TRUE(b.bus.transfer(kControlOut, static_cast<std::uint32_t>(start.size()), testing::text_of(start)));
  EXPECT_FALSE(b.bus.transfer(kControlIn, 64));
  b.device.advance(kNow + milliseconds(20));
  EXPECT_EQ(b.device.next_due(), DeviceTime::never());
}

TEST(U3vRules, RegistersAreReadFromAnyByteAndNotBeyondTheirBlock) {
  Bench b;
  EXPECT_EQ(testing::text_of(b.host.read_bytes(reg::kUserName + 1, 3)), "eft");
  const std::string& xml = b.device.camera().genicam_xml();
  EXPECT_EQ(b.host.status_of(encode_read(1, reg::kXml + xml.size() - 4, 4)), Status::success);
  EXPECT_EQ(b.host.status_of(encode_read(2, reg::kXml + xml.size() - 4, 8)), Status::invalid_address);
  EXPECT_EQ(b.host.read(reg::kManifest + 8), 0x01000000U) << "version of the file";
  EXPECT_EQ(b.host.read(reg::kManifest + 12), 0x01010000U) << "of its schema";
  EXPECT_EQ(b.host.write(reg::kDeviceConfiguration, std::uint64_t{0x0102030405060708}), Status::success);
  EXPECT_EQ(b.host.read<std::uint64_t>(reg::kDeviceConfiguration), 0x0102030405060708U);
}

TEST(U3vRules, ATextKeepsRoomForItsEnd) {
  Bench b;
  EXPECT_EQ(b.host.status_of(encode_write(1, reg::kUserName, std::vector<std::uint8_t>(64, 'x'))),
            Status::invalid_parameter);
  EXPECT_EQ(testing::text_of(b.host.read_bytes(reg::kUserName, 5)), std::string("left\0", 5));
  auto longest = std::vector<std::uint8_t>(64, 'x');
  longest.back() = 0;
  EXPECT_EQ(b.host.status_of(encode_write(2, reg::kUserName, longest)), Status::success);
  EXPECT_EQ(b.host.read_bytes(reg::kUserName, 64), longest);
}

TEST(U3vRules, WhatShapesTheStreamIsLockedDuringAnAcquisitionAndByTlParamsLocked) {
  for (const bool by_register : {false, true}) {
    Bench b;
    ASSERT_EQ(b.host.write(by_register ? reg::kTlParamsLocked : reg::kAcquisitionStart, 1), Status::success);
    for (const reg::Address address : {reg::kWidth, reg::kHeight, reg::kOffsetX, reg::kOffsetY,
                                       reg::kPixelFormat, reg::kAcquisitionMode, reg::kAcquisitionFrameCount})
      EXPECT_EQ(b.host.write(address, b.host.read(address)), Status::access_denied) << address;
    ASSERT_EQ(b.host.write(by_register ? reg::kTlParamsLocked : reg::kAcquisitionStop, by_register ? 0U : 1U),
              Status::success);
    EXPECT_EQ(b.host.write(reg::kWidth, 32), Status::success);
  }
}

TEST(U3vRules, ValuesBeyondTheirLimitsAreRefused) {
  Bench b;
  EXPECT_EQ(b.host.write(reg::kAcquisitionFrameCount, 0), Status::invalid_parameter);
  EXPECT_EQ(b.host.write(reg::kAcquisitionFrameCount, 65536), Status::invalid_parameter);
  EXPECT_EQ(b.host.write(reg::kAcquisitionMode, 3), Status::invalid_parameter);
  EXPECT_EQ(b.host.write(reg::kTriggerSource, 2), Status::invalid_parameter);
  EXPECT_EQ(b.host.write(reg::kTriggerDelay, 1e6), Status::success);
  EXPECT_EQ(b.host.write(reg::kTriggerDelay, 1e6 + 1), Status::invalid_parameter);
  EXPECT_EQ(b.host.write(reg::kHeight, 32), Status::success);
  EXPECT_EQ(b.host.write(reg::kOffsetY, 16), Status::success);
  EXPECT_EQ(b.host.write(reg::kOffsetY, 18), Status::invalid_parameter) << "below the sensor's edge";
}

TEST(U3vRules, AWriteThatReachesAReadOnlyRegisterDoesNothing) {
  Bench b;
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  const std::vector<std::uint8_t> stop_and_status{1, 0, 0, 0, 0, 0, 0, 0};
  EXPECT_EQ(b.host.status_of(encode_write(9, reg::kAcquisitionStop, stop_and_status)), Status::write_protect);
  EXPECT_EQ(b.host.read(reg::kAcquisitionStatus), 1U);
}

TEST(U3vRules, CommandsOfZeroDoNothingAndASecondStartChangesNothing) {
  Bench b;
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 0), Status::success);
  EXPECT_EQ(b.host.read(reg::kAcquisitionStatus), 0U);
  ASSERT_EQ(b.host.open_stream(), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  ASSERT_EQ(expose(b)->block_id, 0U);
  const DeviceTime next = b.device.camera().next_exposure();
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  EXPECT_EQ(b.device.camera().next_exposure(), next);
  EXPECT_EQ(expose(b)->block_id, 1U);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStop, 0), Status::success);
  EXPECT_EQ(b.host.read(reg::kAcquisitionStatus), 1U);
  ASSERT_EQ(b.host.write(reg::kEventControl, 1), Status::success);
  ASSERT_EQ(b.host.write(reg::kEventTest, 0), Status::success);
  EXPECT_FALSE(b.bus.transfer(kEventIn, 64));
}

TEST(U3vRules, EachTransferOfTheStreamMustBeAlignedAndLeaderAndTrailerHaveRoom) {
  for (const reg::Address size : {reg::kTransferSize, reg::kFinalTransfer1, reg::kFinalTransfer2}) {
    Bench b;
    ASSERT_EQ(b.host.open_stream(1024), Status::success);
    ASSERT_EQ(b.host.write(reg::kStreamControl, 0), Status::success);
    ASSERT_EQ(b.host.write(size, 1000), Status::success);
    EXPECT_EQ(b.host.write(reg::kStreamControl, 1), Status::stream_not_aligned) << size;
  }
  for (const auto& [room, least] : {std::pair{reg::kMaxLeader, 52U}, std::pair{reg::kMaxTrailer, 32U}}) {
    Bench b;
    ASSERT_EQ(b.host.open_stream(1024), Status::success);
    ASSERT_EQ(b.host.write(reg::kStreamControl, 0), Status::success);
    ASSERT_EQ(b.host.write(room, least - 1), Status::success);
    EXPECT_EQ(b.host.write(reg::kStreamControl, 1), Status::stream_inconsistent) << room;
    ASSERT_EQ(b.host.write(room, least), Status::success);
    EXPECT_EQ(b.host.write(reg::kStreamControl, 0xFFFFFFFF), Status::success);
    EXPECT_EQ(b.host.read(reg::kStreamControl), 1U) << "reserved bits read as 0";
  }
}

TEST(U3vRules, AFrameOnItsWayIsGivenUpWhereAcquisitionOrStreamEnds) {
  const auto sent_after = [](auto&& change) {
    Bench b;
    EXPECT_EQ(b.host.open_stream(), Status::success);
    EXPECT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
    const auto frame = expose(b);
    EXPECT_TRUE(frame);
    change(b);
    return frame && b.device.send_frame(*frame);
  };
  EXPECT_TRUE(sent_after([](Bench&) {}));
  EXPECT_FALSE(
      sent_after([](Bench& b) { EXPECT_EQ(b.host.write(reg::kAcquisitionStop, 1), Status::success); }));
  EXPECT_FALSE(sent_after([](Bench& b) {
    EXPECT_EQ(b.host.write(reg::kStreamControl, 0), Status::success);
    EXPECT_EQ(b.host.write(reg::kStreamControl, 1), Status::success);
  }));
  EXPECT_FALSE(sent_after([](Bench& b) {
    EXPECT_EQ(b.bus.control({0x02, 1, 0, kStreamIn, 0})->status, 0);
  })) << "the stream's endpoint was reset";
}

TEST(U3vRules, APictureThatIsMissingIsCountedAndHasNoNumber) {
  Bench b;
  ASSERT_EQ(b.host.open_stream(), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  EXPECT_EQ(expose(b)->block_id, 0U);
  EXPECT_FALSE(expose(b, false));
  EXPECT_EQ(b.device.camera().counters().pictures_missing, 1U);
  EXPECT_EQ(expose(b)->block_id, 1U);
}

TEST(U3vRules, AFrameHasItsGainAndLeavesAfterExposureAndReadout) {
  CameraOptions o = options();
  o.camera.readout = microseconds(300);
  Bench b(o);
  ASSERT_EQ(b.host.open_stream(), Status::success);
  ASSERT_EQ(b.host.write(reg::kGain, 6.0), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  FrameJob job;
  ASSERT_TRUE(b.device.camera().begin_frame(kNow, job));
  EXPECT_EQ(job.request.gain_db, 6.0);
  const auto f = b.device.camera().finish_frame(std::move(job), true);
  ASSERT_TRUE(f);
  EXPECT_EQ(f->t_send, kNow + milliseconds(1) + microseconds(300));
}

TEST(U3vRules, RateIsThatOfTheSlowestOfWishExposureAndSensor) {
  Bench b;
  EXPECT_DOUBLE_EQ(b.host.read<double>(reg::kResultingFrameRate), 100.0);
  ASSERT_EQ(b.host.write(reg::kFrameRateEnable, 0), Status::success);
  EXPECT_NEAR(b.host.read<double>(reg::kResultingFrameRate), options().camera.max_frame_rate_hz, 1e-3);
  ASSERT_EQ(b.host.write(reg::kExposureTime, 20'000.0), Status::success);
  EXPECT_DOUBLE_EQ(b.host.read<double>(reg::kResultingFrameRate), 50.0);
}

TEST(U3vRules, ChangesDuringAnAcquisitionHoldFromTheNextExposureOn) {
  Bench b;
  ASSERT_EQ(b.host.open_stream(), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  ASSERT_TRUE(expose(b));
  ASSERT_EQ(b.host.write(reg::kFrameRate, 50.0), Status::success);
  EXPECT_EQ(b.device.camera().next_exposure(), kNow + milliseconds(20));
  ASSERT_EQ(b.host.write(reg::kTriggerMode, 1), Status::success);
  EXPECT_EQ(b.device.camera().next_exposure(), DeviceTime::never()) << "until there is a trigger";
}

TEST(U3vRules, ACountOfFramesIsOfItsAcquisitionAlone) {
  Bench b;
  ASSERT_EQ(b.host.open_stream(), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionMode, reg::kModeMultiFrame), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionFrameCount, 2), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  ASSERT_TRUE(expose(b));
  ASSERT_EQ(b.host.write(reg::kAcquisitionStop, 1), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionMode, reg::kModeContinuous), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  for (int i = 0; i < 5; ++i) EXPECT_TRUE(expose(b)) << i;
  ASSERT_EQ(b.host.write(reg::kAcquisitionStop, 1), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionMode, reg::kModeSingleFrame), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  ASSERT_TRUE(expose(b));
  EXPECT_EQ(b.host.read(reg::kAcquisitionStatus), 0U);
}

TEST(U3vRules, EventsThatNobodyTakesAreBounded) {
  Camera camera = Camera::create(options()).value();
  std::vector<TimedAck> acks;
  const std::vector<std::uint8_t> one{1, 0, 0, 0};
  camera.handle(encode_write(1, reg::kEventControl, one), kNow, acks);
  for (int i = 0; i < 100; ++i) camera.handle(encode_write(2, reg::kEventTest, one), kNow, acks);
  const auto events = camera.take_events();
  EXPECT_THAT(events, SizeIs(64));
  const auto first = decode_event(events[0]), second = decode_event(events[1]);
  ASSERT_TRUE(first && second);
  EXPECT_EQ(second->request_id, first->request_id + 1);
  EXPECT_EQ(first->timestamp_ns, static_cast<std::uint64_t>(kNow.ns()));
  camera.handle(encode_write(3, reg::kEventTest, one), kNow, acks);
  camera.power_on();
  EXPECT_THAT(camera.take_events(), IsEmpty()) << "what was before is gone";
}

TEST(U3vRules, ANewHostFindsNoAnswersFramesOrHaltsOfTheOneBefore) {
  CameraOptions o = options();
  o.response_ms = 20;
  o.start_delay = milliseconds(100);
  Bench b(o);
  ASSERT_EQ(b.host.open_stream(), Status::success);
  const auto start = encode_write(7, reg::kAcquisitionStart, std::vector<std::uint8_t>{1, 0, 0, 0});
  ASSERT_TRUE(b.bus.transfer(kControlOut, static_cast<std::uint32_t>(start.size()), testing::text_of(start)));
  b.run_until(kNow + milliseconds(50));  // the answer waits
  b.session.end();
  EXPECT_EQ(b.device.next_due(), DeviceTime::never());
  usbip::Session again(b.device);
  usbip::testing::Host bus(again);
  ASSERT_EQ(bus.import("1-1"), usbip::kOk);
  b.device.advance(kNow + seconds(1));
  EXPECT_FALSE(bus.transfer(kControlIn, 64));
  EXPECT_FALSE(bus.transfer(kStreamIn, 1024));
}

TEST(U3vRules, AStreamThatIsSwitchedOnAgainBeginsWithALeaderAndHasAllItsRoom) {
  Bench b;
  ASSERT_EQ(b.host.open_stream(1024), Status::success);
  ASSERT_EQ(b.host.write(reg::kAcquisitionStart, 1), Status::success);
  b.run_until(kNow + milliseconds(30));  // four frames: no more have room
  ASSERT_TRUE(b.bus.transfer(kStreamIn, 1024));
  ASSERT_EQ(b.host.write(reg::kStreamControl, 0), Status::success);
  ASSERT_EQ(b.host.write(reg::kStreamControl, 1), Status::success);
  b.run_until(kNow + milliseconds(70));
  EXPECT_EQ(b.device.counters().frames_dropped, 0U);
  const auto f = b.host.take_frame();
  ASSERT_TRUE(f);
  EXPECT_EQ(f->leader.block_id, 4U);
}

TEST(U3vRules, AResetOfTheControlEndpointDropsTheAnswerThatWaits) {
  CameraOptions o = options();
  o.start_delay = seconds(1);
  o.response_ms = 2000;
  Bench b(o);
  const auto start = encode_write(7, reg::kAcquisitionStart, std::vector<std::uint8_t>{1, 0, 0, 0});
  ASSERT_TRUE(b.bus.transfer(kControlOut, static_cast<std::uint32_t>(start.size()), testing::text_of(start)));
  EXPECT_EQ(b.device.next_due(), kNow + seconds(1));
  ASSERT_EQ(b.bus.control({0x02, 1, 0, kControlIn, 0})->status, 0);
  EXPECT_EQ(b.device.next_due(), DeviceTime::never());
}

TEST(U3vRules, DescriptorsSayEndpointsPowerStatesAndNames) {
  Bench b;
  const std::string device = b.bus.control({0x80, 6, 0x0100, 0, 18})->data;
  EXPECT_EQ(load_le<std::uint16_t>(device, 2), 0x0300) << "USB 3.0";
  EXPECT_EQ(device[7], 9) << "packets of 2^9 on endpoint 0";
  const std::string c = b.bus.control({0x80, 6, 0x0200, 0, 512})->data;
  std::vector<int> bursts;
  std::string info;
  for (std::size_t at = 0; at < c.size() && c[at] != 0; at += static_cast<std::uint8_t>(c[at])) {
    if (c[at + 1] == 5) {
      EXPECT_EQ(c[at + 3], 2) << "bulk";
      EXPECT_EQ(load_le<std::uint16_t>(c, at + 4), 1024) << "a SuperSpeed packet";
    }
    if (c[at + 1] == 0x30) bursts.push_back(c[at + 2]);
    if (c[at + 1] == 0x24) info = c.substr(at, 20);
  }
  EXPECT_THAT(bursts, ::testing::ElementsAre(0, 0, 0, 15)) << "the stream comes in bursts";
  ASSERT_EQ(info.size(), 20U);
  EXPECT_EQ(info.substr(3, 8), std::string("\x02\0\x01\0\x01\0\x01\0", 8)) << "GenCP 1.2, USB3 Vision 1.1";
  const auto text = [&](std::size_t at) {
    const auto index = static_cast<std::uint16_t>(0x0300 | static_cast<std::uint8_t>(info[at]));
    const std::string d = b.bus.control({0x80, 6, index, 0x0409, 255})->data;
    std::string plain;
    for (std::size_t i = 2; i < d.size(); i += 2) plain += d[i];
    return plain;
  };
  const CameraState& s = b.device.camera().state();
  EXPECT_EQ(text(11).substr(0, 4), "1209") << "the vendor's number";
  EXPECT_EQ(text(11).size(), 12U);
  EXPECT_EQ(text(12), s.vendor);
  EXPECT_EQ(text(13), s.model);
  EXPECT_EQ(text(14), s.family);
  EXPECT_EQ(text(15), s.version);
  EXPECT_EQ(text(16), s.info);
  EXPECT_EQ(text(17), s.serial);
  EXPECT_EQ(text(18), s.user_name);
  const std::string bos = b.bus.control({0x80, 6, 0x0F00, 0, 512})->data;
  ASSERT_EQ(bos.size(), load_le<std::uint16_t>(bos, 2));
  int capabilities = 0;
  for (std::size_t at = 5; at < bos.size() && bos[at] != 0; at += static_cast<std::uint8_t>(bos[at]))
    ++capabilities;
  EXPECT_EQ(capabilities, bos[4]);
}

}  // namespace
}  // namespace rigor::u3v
