// The camera without a network: registers, privileges, timing, and hostile datagrams.
#include "drivers/aravis/gige_device_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tests/drivers/aravis/gige_model_bench.h"

namespace rigor::gige {
namespace {

using testing::GigeModel;
using testing::kAlice;
using testing::kMallory;

TEST_F(GigeModel, BootstrapRegistersSayWhatItIs) {
  EXPECT_EQ(get(reg::kVersion), 0x00010002U);
  EXPECT_EQ(get(reg::kDeviceMode) >> 31, 1U);
  EXPECT_EQ(get(reg::kStreamChannelCount), 1U);
  EXPECT_EQ(get(reg::kTickFrequencyHigh), 0U);
  EXPECT_EQ(get(reg::kTickFrequencyLow), 1'000'000'000U);
  EXPECT_EQ(get(reg::kGvcpCapability) & 0x7, 0x7U);  // concatenation, WRITEMEM, resend
  EXPECT_EQ(get(reg::kPayloadSize), 640U * 480U);
  std::uint32_t v = 0;
  EXPECT_EQ(read(0x8000, v), GvStatus::invalid_address);
  EXPECT_EQ(read(reg::kFeatureEnd, v), GvStatus::invalid_address);
}

TEST_F(GigeModel, OneControllerAtATime) {
  EXPECT_EQ(write(reg::kWidth, 320), GvStatus::access_denied);  // nobody has control yet
  EXPECT_EQ(write(reg::kControlPrivilege, reg::kPrivilegeControl), GvStatus::success);
  EXPECT_EQ(write(reg::kControlPrivilege, reg::kPrivilegeControl, kMallory), GvStatus::access_denied);
  EXPECT_EQ(write(reg::kWidth, 320, kMallory), GvStatus::access_denied);
  EXPECT_EQ(write(reg::kControlPrivilege, 0, kMallory), GvStatus::access_denied);
  std::uint32_t v = 0;
  EXPECT_EQ(read(reg::kWidth, v, kMallory), GvStatus::success);
  EXPECT_EQ(write(reg::kControlPrivilege, reg::kPrivilegeExclusive), GvStatus::success);
  EXPECT_EQ(read(reg::kWidth, v, kMallory), GvStatus::access_denied);
  EXPECT_EQ(get(reg::kPrimaryPort), kAlice.port);
  EXPECT_EQ(write(reg::kControlPrivilege, 0), GvStatus::success);
  EXPECT_EQ(write(reg::kControlPrivilege, reg::kPrivilegeControl, kMallory), GvStatus::success);
}

TEST_F(GigeModel, ASilentControllerLosesControlAndItsAcquisition) {
  open();
  EXPECT_EQ(write(reg::kHeartbeatTimeout, 500), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  now = now + milliseconds(499);
  EXPECT_NE(get(reg::kControlPrivilege), 0U);  // reading it is the heartbeat
  now = now + milliseconds(500);
  EXPECT_FALSE(model.expire_heartbeat(now));
  now = now + milliseconds(1);
  EXPECT_EQ(write(reg::kControlPrivilege, reg::kPrivilegeControl, kMallory), GvStatus::success);
  EXPECT_FALSE(model.acquiring());
  EXPECT_EQ(get(reg::kStreamPort), 0U);
  EXPECT_EQ(model.counters().heartbeat_expired, 1U);
}

// Seen to catch: a region check whose sum overflowed 32 bits.
TEST_F(GigeModel, RefusesWhatTheRangesForbid) {
  open();
  EXPECT_EQ(write(reg::kWidthMax, 3), GvStatus::write_protect);
  EXPECT_EQ(write(reg::kManufacturerName, 3), GvStatus::write_protect);
  EXPECT_EQ(write(0x9000, 3), GvStatus::invalid_address);
  EXPECT_EQ(write(reg::kWidth, 321), GvStatus::invalid_parameter);
  EXPECT_EQ(write(reg::kWidth, 644), GvStatus::invalid_parameter);
  EXPECT_EQ(write(reg::kWidth, 0), GvStatus::invalid_parameter);
  EXPECT_EQ(write(reg::kOffsetX, 4), GvStatus::invalid_parameter);  // no room beside the full width
  EXPECT_EQ(write(reg::kOffsetX, 0xFFFFFFFE), GvStatus::invalid_parameter);
  EXPECT_EQ(write(reg::kPixelFormat, 0x12345678), GvStatus::invalid_parameter);
  EXPECT_EQ(write(reg::kAcquisitionMode, 3), GvStatus::invalid_parameter);
  EXPECT_EQ(write(reg::kExposureTime, 3), GvStatus::invalid_parameter);  // half a double
  EXPECT_EQ(write_double(reg::kExposureTime, 5), GvStatus::invalid_parameter);
  EXPECT_EQ(write_double(reg::kExposureTime, std::nan("")), GvStatus::invalid_parameter);
  EXPECT_EQ(write_double(reg::kGain, 24.5), GvStatus::invalid_parameter);
  EXPECT_EQ(write_double(reg::kFrameRate, 0), GvStatus::invalid_parameter);
  EXPECT_EQ(write_double(reg::kResultingFrameRate, 10), GvStatus::write_protect);
  EXPECT_EQ(get(reg::kWidth), 640U);
  EXPECT_EQ(write(reg::kWidth, 320), GvStatus::success);
  EXPECT_EQ(write(reg::kOffsetX, 320), GvStatus::success);
  EXPECT_EQ(write(reg::kPixelFormat, static_cast<std::uint32_t>(PixelFormat::rgb8)), GvStatus::success);
  EXPECT_EQ(get(reg::kPayloadSize), 320U * 480U * 3U);
}

TEST_F(GigeModel, LocksWhatShapesTheStreamWhileItRuns) {
  open();
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  EXPECT_EQ(get(reg::kTlParamsLocked), 1U);
  for (const auto a :
       {reg::kWidth, reg::kHeight, reg::kOffsetX, reg::kOffsetY, reg::kPixelFormat, reg::kAcquisitionMode,
        reg::kAcquisitionFrameCount, reg::kChunkModeActive, reg::kChunkEnable, reg::kStreamPacketSize,
        reg::kStreamDestination, reg::kStreamConfiguration}) {
    EXPECT_EQ(write(a, get(a)), GvStatus::access_denied) << std::hex << a;
  }
  EXPECT_EQ(write_double(reg::kExposureTime, 2000), GvStatus::success);
  EXPECT_EQ(write_double(reg::kGain, 6), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStop, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kWidth, 320), GvStatus::success);
}

TEST_F(GigeModel, ZeroWrittenToACommandDoesNothing) {
  open();
  EXPECT_EQ(write(reg::kAcquisitionStart, 0), GvStatus::success);
  EXPECT_FALSE(model.acquiring());
  EXPECT_EQ(write(reg::kTriggerMode, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kTriggerSoftware, 0), GvStatus::success);
  EXPECT_EQ(model.next_exposure(), DeviceTime::never());
  EXPECT_EQ(write(reg::kAcquisitionStop, 0), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionAbort, 0), GvStatus::success);
  EXPECT_TRUE(model.acquiring());
}

TEST_F(GigeModel, PacketSizeIsRoundedToWhatItCanDo) {
  open();
  EXPECT_EQ(write(reg::kStreamPacketSize, 1501), GvStatus::success);
  EXPECT_EQ(get(reg::kStreamPacketSize), 1500U);
  EXPECT_EQ(write(reg::kStreamPacketSize, 65535), GvStatus::success);
  EXPECT_EQ(get(reg::kStreamPacketSize), 9000U);
  EXPECT_EQ(write(reg::kStreamPacketSize, reg::kFireTestPacket | reg::kDoNotFragment | 1400),
            GvStatus::success);
  ASSERT_TRUE(last.test_packet);
  EXPECT_EQ(last.test_packet->packet_size, 1400U);
  EXPECT_TRUE(last.test_packet->do_not_fragment);
  EXPECT_EQ(get(reg::kStreamPacketSize), reg::kDoNotFragment | 1400);  // the trigger bit reads 0
}

TEST_F(GigeModel, FiresNoTestPacketWhereNobodyListens) {
  ASSERT_EQ(write(reg::kControlPrivilege, reg::kPrivilegeControl), GvStatus::success);
  EXPECT_EQ(write(reg::kStreamPacketSize, reg::kFireTestPacket | 1400), GvStatus::success);
  EXPECT_FALSE(last.test_packet);
}

TEST_F(GigeModel, FreeRunKeepsItsGridAndStampsExposureStart) {
  open();
  EXPECT_EQ(write_double(reg::kFrameRate, 50), GvStatus::success);
  EXPECT_EQ(write_double(reg::kExposureTime, 4000), GvStatus::success);
  EXPECT_EQ(write_double(reg::kGain, 3.5), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  const auto t0 = now;
  for (int k = 0; k < 5; ++k) {
    FrameRequest r;
    const auto out = expose(t0 + seconds(1), &r);
    ASSERT_TRUE(out);
    EXPECT_EQ(r.t_exposure_start, t0 + milliseconds(20) * k);
    EXPECT_EQ(r.exposure, milliseconds(4));
    EXPECT_EQ(r.gain_db, 3.5);
    EXPECT_EQ(out->block->block_id, static_cast<std::uint64_t>(k + 1));
    EXPECT_EQ(out->block->leader.timestamp_ticks, static_cast<std::uint64_t>(r.t_exposure_start.ns()));
    EXPECT_EQ(out->t_send, r.t_exposure_start + milliseconds(5));
  }
  // A renderer that overslept: what it missed is skipped, the grid stays.
  FrameJob job;
  ASSERT_TRUE(model.begin_frame(t0 + milliseconds(171), job));
  EXPECT_EQ(job.request.t_exposure_start, t0 + milliseconds(160));
  EXPECT_EQ(job.request.index, 8U);
  EXPECT_EQ(model.counters().exposures_skipped, 3U);
}

TEST_F(GigeModel, ExposureTimeLimitsTheRate) {
  open();
  EXPECT_EQ(write_double(reg::kFrameRate, 100), GvStatus::success);
  EXPECT_EQ(write_double(reg::kExposureTime, 25'000), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  FrameRequest a, b;
  ASSERT_TRUE(expose(DeviceTime::never(), &a));
  ASSERT_TRUE(expose(DeviceTime::never(), &b));
  EXPECT_EQ(b.t_exposure_start - a.t_exposure_start, milliseconds(25));
  // A shorter exposure while one is in progress does not start another on top of it.
  EXPECT_EQ(write_double(reg::kExposureTime, 100), GvStatus::success);
  EXPECT_GE(model.next_exposure(), b.t_exposure_start + milliseconds(25));
}

TEST_F(GigeModel, AlignedExposuresStartAtMultiplesOfThePeriod) {
  auto c = config();
  c.align_to_clock = true;
  model = GigeDeviceModel::create(c).value();
  now = DeviceTime(1'003'000'000);
  open();
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  EXPECT_EQ(model.next_exposure(), DeviceTime(1'040'000'000));
}

TEST_F(GigeModel, SingleAndMultiFrameEndByThemselves) {
  open();
  for (const std::uint32_t count : {1U, 7U}) {
    EXPECT_EQ(write(reg::kAcquisitionMode, count == 1 ? reg::kModeSingleFrame : reg::kModeMultiFrame),
              GvStatus::success);
    EXPECT_EQ(write(reg::kAcquisitionFrameCount, count), GvStatus::success);
    EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
    std::uint32_t frames = 0;
    while (expose(DeviceTime::never() - seconds(1))) ++frames;
    EXPECT_EQ(frames, count);
    EXPECT_EQ(get(reg::kAcquisitionActive), 0U);
  }
}

TEST_F(GigeModel, EachAcquisitionCountsItsExposuresFromZero) {
  open();
  for (int acquisition = 0; acquisition < 2; ++acquisition) {
    EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
    for (std::uint64_t i = 0; i < 3; ++i) {
      FrameRequest r;
      ASSERT_TRUE(expose(DeviceTime::never(), &r));
      EXPECT_EQ(r.index, i);
    }
    EXPECT_EQ(write(reg::kAcquisitionStop, 1), GvStatus::success);
  }
}

TEST_F(GigeModel, EachSoftwareTriggerIsOneFrame) {
  open();
  EXPECT_EQ(write(reg::kTriggerSoftware, 1), GvStatus::access_denied);
  EXPECT_EQ(write(reg::kTriggerMode, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  EXPECT_EQ(model.next_exposure(), DeviceTime::never());
  now = now + milliseconds(3);
  EXPECT_EQ(write(reg::kTriggerSoftware, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kTriggerSoftware, 1), GvStatus::success);  // waits for the sensor
  FrameRequest a, b;
  ASSERT_TRUE(expose(DeviceTime::never(), &a));
  ASSERT_TRUE(expose(DeviceTime::never(), &b));
  EXPECT_EQ(a.t_exposure_start, now);
  EXPECT_EQ(b.t_exposure_start, now + milliseconds(10));
  EXPECT_EQ(model.next_exposure(), DeviceTime::never());
  for (std::size_t i = 0; i < config().trigger_queue; ++i)
    EXPECT_EQ(write(reg::kTriggerSoftware, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kTriggerSoftware, 1), GvStatus::busy);
}

TEST_F(GigeModel, ARepeatedCommandIsAnsweredAgainButNotExecutedAgain) {
  open();
  EXPECT_EQ(write(reg::kTriggerMode, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  const RegisterWrite w{reg::kTriggerSoftware, 1};
  const auto command = encode_write_register_cmd(next_id(), std::span(&w, 1));
  EXPECT_EQ(ask(command, kAlice).status, GvStatus::success);
  EXPECT_EQ(ask(command, kAlice).status, GvStatus::success);  // our acknowledge was lost
  EXPECT_EQ(model.counters().triggers, 1U);
}

TEST_F(GigeModel, TimestampCounterLatchesAndResets) {
  open();
  EXPECT_EQ(write(reg::kTimestampControl, reg::kTimestampLatch), GvStatus::success);
  EXPECT_EQ(get(reg::kTimestampLow), static_cast<std::uint32_t>(now.ns()));
  EXPECT_EQ(write(reg::kTimestampControl, reg::kTimestampReset), GvStatus::success);
  now = now + seconds(2);
  EXPECT_EQ(write(reg::kTimestampControl, reg::kTimestampLatch), GvStatus::success);
  EXPECT_EQ(get(reg::kTimestampLow), 2'000'000'000U);
}

TEST_F(GigeModel, ResendsWhatItStillHasToTheStreamAlone) {
  open();
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(expose(DeviceTime::never()));
  const Endpoint stream{kAlice.ip, 5001};
  auto a = model.handle_gvcp(stream, encode_packet_resend_cmd(1, {0, 10, 2, 4, false}), now);
  ASSERT_TRUE(a.resend && a.resend->block);
  EXPECT_EQ(a.resend->to, stream);
  EXPECT_EQ(a.resend->block->block_id, 10U);
  a = model.handle_gvcp(stream, encode_packet_resend_cmd(1, {0, 10, 2, 0xFFFFFF, false}), now);
  EXPECT_EQ(a.resend->last, a.resend->block->packet_count() - 1);
  a = model.handle_gvcp(stream, encode_packet_resend_cmd(1, {0, 1, 2, 4, false}),
                        now);  // pushed out by 8 newer
  ASSERT_TRUE(a.resend);
  EXPECT_FALSE(a.resend->block);
  a = model.handle_gvcp(kMallory, encode_packet_resend_cmd(1, {0, 10, 2, 4, false}), now);
  EXPECT_FALSE(a.resend);
  EXPECT_EQ(model.counters().resend_unavailable, 1U);
}

TEST_F(GigeModel, RefusesResendsOfWhatIsNotOfItsStream) {
  open();
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  ASSERT_TRUE(expose(DeviceTime::never()));
  const Endpoint stream{kAlice.ip, 5001};
  // Whoever of the receiver's machine asks, the packets go to the stream.
  auto a = model.handle_gvcp(kAlice, encode_packet_resend_cmd(1, {0, 1, 0, 1, false}), now);
  ASSERT_TRUE(a.resend && a.resend->block);
  EXPECT_EQ(a.resend->to, stream);
  const std::uint32_t packets = a.resend->block->packet_count();
  EXPECT_FALSE(model.handle_gvcp(stream, encode_packet_resend_cmd(2, {1, 1, 0, 1, false}), now).resend)
      << "another stream channel";
  EXPECT_FALSE(model.handle_gvcp(stream, encode_packet_resend_cmd(3, {0, 1, 0, 1, true}), now).resend)
      << "ids of 64 bits in a stream of short ones";
  a = model.handle_gvcp(stream, encode_packet_resend_cmd(4, {0, 1, packets, packets, false}), now);
  ASSERT_TRUE(a.resend);
  EXPECT_FALSE(a.resend->block) << "behind the trailer";
  EXPECT_EQ(a.resend->last, packets) << "one status for the range";
  // A stream that is opened anew counts from 1, and has nothing of the one before.
  EXPECT_EQ(write(reg::kStreamPort, 0), GvStatus::success);
  EXPECT_EQ(write(reg::kStreamPort, 5001), GvStatus::success);
  a = model.handle_gvcp(stream, encode_packet_resend_cmd(5, {0, 1, 0, 1, false}), now);
  ASSERT_TRUE(a.resend);
  EXPECT_FALSE(a.resend->block);
}

TEST_F(GigeModel, AStreamGoesOnWhereItsPortIsWrittenAgain) {
  open();
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  ASSERT_TRUE(expose(DeviceTime::never()));
  EXPECT_EQ(write(reg::kStreamPort, 5001), GvStatus::success);
  EXPECT_EQ(expose(DeviceTime::never())->block->block_id, 2U);
  const Endpoint stream{kAlice.ip, 5001};
  EXPECT_TRUE(model.handle_gvcp(stream, encode_packet_resend_cmd(1, {0, 1, 0, 1, false}), now).resend->block);
}

TEST_F(GigeModel, KeepsAsManyBlocksAsItIsToldForResends) {
  open();
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  const std::uint64_t kept = config().retained_frames;
  for (std::uint64_t i = 0; i <= kept; ++i) ASSERT_TRUE(expose(DeviceTime::never()));
  const Endpoint stream{kAlice.ip, 5001};
  EXPECT_FALSE(
      model.handle_gvcp(stream, encode_packet_resend_cmd(1, {0, 1, 0, 1, false}), now).resend->block);
  EXPECT_TRUE(model.handle_gvcp(stream, encode_packet_resend_cmd(2, {0, 2, 0, 1, false}), now).resend->block);
}

TEST_F(GigeModel, TheSameBytesOfAnotherClientAreNotARepetition) {
  open();
  const RegisterWrite w{reg::kWidth, 320};
  const auto command = encode_write_register_cmd(next_id(), std::span(&w, 1));
  EXPECT_EQ(ask(command, kAlice).status, GvStatus::success);
  EXPECT_EQ(ask(command, kMallory).status, GvStatus::access_denied);
}

TEST_F(GigeModel, WhatItsControllerSetEndsWithControl) {
  now = DeviceTime(100'000'000'000);
  open();
  EXPECT_FALSE(model.expire_heartbeat(now)) << "taking control is a heartbeat";
  EXPECT_EQ(write(reg::kTlParamsLocked, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kWidth, 320), GvStatus::access_denied);
  EXPECT_EQ(write(reg::kControlPrivilege, 0), GvStatus::success);
  EXPECT_EQ(get(reg::kPrimaryPort), 0U) << "nobody has control";
  EXPECT_EQ(get(reg::kPrimaryIp), 0U);
  EXPECT_EQ(get(reg::kStreamPort), 0U);
  open();
  EXPECT_EQ(write(reg::kWidth, 320), GvStatus::success) << "not locked any more";
}

TEST_F(GigeModel, ARefusedWriteOfMemoryHasWrittenNothingAndOneWithoutAnswerHasWritten) {
  open();
  std::array<std::uint8_t, 8> nan{};
  store_be(nan, 0, std::nan(""));
  const auto a = ask(encode_write_memory_cmd(next_id(), reg::kExposureTime, nan), kAlice);
  EXPECT_EQ(a.status, GvStatus::invalid_parameter);
  ASSERT_TRUE(std::holds_alternative<WriteMemoryAck>(a.body));
  EXPECT_EQ(std::get<WriteMemoryAck>(a.body).index, 0);
  EXPECT_EQ(
      ask(encode_write_memory_cmd(next_id(), 0xFFFFFFF8, std::array<std::uint8_t, 16>{}), kAlice).status,
      GvStatus::invalid_address)
      << "over the end of the address space";
  const RegisterWrite w{reg::kWidth, 320};
  auto silent = encode_write_register_cmd(next_id(), std::span(&w, 1));
  silent[1] = 0;  // flags
  EXPECT_TRUE(model.handle_gvcp(kAlice, silent, now).ack.empty());
  EXPECT_EQ(get(reg::kWidth), 320U);
}

TEST_F(GigeModel, CamerasHaveMacAddressesOfTheirAddresses) {
  auto c = config();
  c.ip = 0x7F000042;
  GigeDeviceModel other = GigeDeviceModel::create(c).value();
  const std::uint32_t address = reg::kMacLow;
  GvcpAck a;
  ASSERT_EQ(decode_gvcp_ack(
                other.handle_gvcp(kAlice, encode_read_register_cmd(1, std::span(&address, 1)), now).ack, a),
            DecodeStatus::ok);
  EXPECT_EQ(std::get<ReadRegisterAck>(a.body).values.items[0], 0x7F000042U);
}

TEST_F(GigeModel, ATriggerThatWaitsIsOfItsSourceAlone) {
  open();
  EXPECT_EQ(write(reg::kTriggerMode, 1), GvStatus::success);
  EXPECT_EQ(write_double(reg::kTriggerDelay, 500'000), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kTriggerSoftware, 1), GvStatus::success);
  EXPECT_EQ(model.next_exposure(), now + milliseconds(500));
  EXPECT_EQ(write(reg::kTriggerSource, reg::kTriggerSourceLine1), GvStatus::success);
  EXPECT_EQ(model.next_exposure(), DeviceTime::never());
}

TEST_F(GigeModel, APulseTriggersAtTheEdgeThatIsChosen) {
  open();
  EXPECT_EQ(write(reg::kTriggerMode, 1), GvStatus::success);
  EXPECT_EQ(write(reg::kTriggerSource, reg::kTriggerSourceLine1), GvStatus::success);
  for (const auto& [edge, after] :
       {std::pair{reg::kRisingEdge, milliseconds(1)}, std::pair{reg::kFallingEdge, milliseconds(3)}}) {
    EXPECT_EQ(write(reg::kTriggerActivation, edge), GvStatus::success);
    EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
    model.pulse_line(now + milliseconds(1), now + milliseconds(3));
    EXPECT_EQ(model.next_exposure(), now + after);
    EXPECT_EQ(write(reg::kAcquisitionStop, 1), GvStatus::success);
  }
}

TEST_F(GigeModel, OthersDoNotKeepASilentControllerInControl) {
  open();
  EXPECT_EQ(write(reg::kHeartbeatTimeout, 500), GvStatus::success);
  now = now + milliseconds(400);
  std::uint32_t v = 0;
  EXPECT_EQ(read(reg::kWidth, v, kMallory), GvStatus::success);
  now = now + milliseconds(200);
  EXPECT_TRUE(model.expire_heartbeat(now));
}

TEST_F(GigeModel, APictureThatIsMissingIsCountedAndHasNoNumber) {
  open();
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  ASSERT_EQ(expose(DeviceTime::never())->block->block_id, 1U);
  FrameJob job;
  ASSERT_TRUE(model.begin_frame(model.next_exposure(), job));
  EXPECT_FALSE(model.finish_frame(std::move(job), false));
  EXPECT_EQ(model.counters().pictures_missing, 1U);
  EXPECT_EQ(expose(DeviceTime::never())->block->block_id, 2U);
}

TEST_F(GigeModel, ABlockLeavesAfterExposureAndReadoutWithTheDelayThatWasAskedFor) {
  open();
  EXPECT_EQ(write(reg::kStreamPacketDelay, 1234), GvStatus::success);
  EXPECT_EQ(write_double(reg::kExposureTime, 2000), GvStatus::success);
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  FrameRequest r;
  const auto out = expose(DeviceTime::never(), &r);
  ASSERT_TRUE(out);
  EXPECT_EQ(out->t_send, r.t_exposure_start + milliseconds(2) + config().readout);
  EXPECT_EQ(out->packet_delay, nanoseconds(1234));
}

TEST_F(GigeModel, BlockIdsSkipZeroAndGoOnOverAcquisitions) {
  open();
  EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
  std::uint64_t before = 0;
  for (int i = 0; i < 65536; ++i) {
    const auto out = expose(DeviceTime::never() - seconds(1));
    ASSERT_TRUE(out);
    EXPECT_EQ(out->block->block_id, before == 65535 ? 1 : before + 1);
    before = out->block->block_id;
    if (i == 100) {
      EXPECT_EQ(write(reg::kAcquisitionStop, 1), GvStatus::success);
      EXPECT_EQ(write(reg::kAcquisitionStart, 1), GvStatus::success);
    }
    now = model.next_exposure();
    if (i % 50 == 0) (void)get(reg::kControlPrivilege);
  }
  EXPECT_EQ(write(reg::kStreamPort, 0), GvStatus::success);
  EXPECT_EQ(write(reg::kStreamPort, 5001), GvStatus::success);
  const auto out = expose(DeviceTime::never() - seconds(1));
  ASSERT_TRUE(out);
  EXPECT_EQ(out->block->block_id, 1U);
}

TEST_F(GigeModel, ACameraOfPicturesSendsNoMultiPartFrames) {
  open();
  EXPECT_EQ(get(reg::kStreamCapability) & reg::kMultipart, 0U);
  EXPECT_EQ(write(reg::kStreamConfiguration, reg::kMultipart), GvStatus::invalid_parameter);
  EXPECT_EQ(get(reg::kStreamConfiguration), 0U);
}

TEST_F(GigeModel, BadConfigurationsAreRefusedWithAReason) {
  const auto refused = [](auto change) {
    auto c = config();
    change(c);
    auto m = GigeDeviceModel::create(c);
    EXPECT_FALSE(m);
    return m ? std::string() : m.error().message;
  };
  EXPECT_NE(refused([](auto& c) { c.formats.clear(); }).find("formats"), std::string::npos);
  EXPECT_NE(refused([](auto& c) { c.sensor_width_px = 641; }).find("region"), std::string::npos);
  EXPECT_NE(refused([](auto& c) { c.exposure_us = 1; }).find("exposure_us"), std::string::npos);
  EXPECT_NE(refused([](auto& c) { c.frame_rate_hz = std::nan(""); }).find("frame_rate_hz"),
            std::string::npos);
  EXPECT_NE(refused([](auto& c) { c.packet_size = 100; }).find("packet_size"), std::string::npos);
  EXPECT_NE(refused([](auto& c) { c.serial = "0123456789ABCDEF"; }).find("serial"), std::string::npos);
}

// Seen to catch, with the address sanitizer: a decoder that trusted the count of READMEM.
TEST_F(GigeModel, SurvivesAHundredThousandHostileDatagrams) {
  std::mt19937 rng(20240607);
  const auto any = [&rng](std::uint32_t n) { return static_cast<std::uint32_t>(rng() % n); };
  const std::array<std::uint16_t, 10> commands{0x02, 0x04, 0x40, 0x80, 0x82, 0x84, 0x86, 0x89, 0x100, 0xFFFF};
  const std::array<std::uint32_t, 8> places{reg::kControlPrivilege, reg::kStreamPort,   reg::kWidth,
                                            reg::kAcquisitionStart, reg::kExposureTime, reg::kXml,
                                            reg::kTriggerSoftware,  reg::kFirstUrl};
  open();
  for (int i = 0; i < 100'000; ++i) {
    std::vector<std::uint8_t> d(any(4) == 0 ? any(2048) : 8 + 4 * any(10));
    for (auto& b : d) b = static_cast<std::uint8_t>(any(8) == 0 ? rng() : 0);
    if (d.size() >= 8 && any(16) != 0) {
      d[0] = 0x42;
      store_be(MutableBytes(d), 2, commands[any(commands.size())]);
      store_be(MutableBytes(d), 4, static_cast<std::uint16_t>(d.size() - 8));
      store_be(MutableBytes(d), 6, static_cast<std::uint16_t>(rng()));
    }
    if (d.size() >= 12 && any(2) == 0) store_be(MutableBytes(d), 8, places[any(places.size())] + 4 * any(8));
    now = now + microseconds(any(200));
    const auto a = model.handle_gvcp(any(3) == 0 ? kMallory : kAlice, d, now);
    EXPECT_LE(a.ack.size(), kGvcpHeaderSize + kGvcpMaxPayload);
    if (a.resend && a.resend->block) {
      EXPECT_LT(a.resend->last, a.resend->block->packet_count());
    }
    for (int k = 0; k < 3 && model.next_exposure() <= now; ++k) (void)expose(now);
  }
  EXPECT_GT(model.counters().malformed, 1000U);
  EXPECT_GT(model.counters().gvcp_requests, 50'000U);
  // And it still works.
  (void)model.handle_gvcp(kAlice, {}, now + seconds(4000));
  now = now + seconds(4001);
  open();
}

}  // namespace
}  // namespace rigor::gige
