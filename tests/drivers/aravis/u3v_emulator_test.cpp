// The emulated USB3 Vision camera on a socket of this machine: a host imports it, streams, loses it and gets
// it back. What a kernel and Aravis make of it: kernel_u3v_test.cpp.
#include <gtest/gtest.h>
#include <unistd.h>

#include "drivers/aravis/u3v_emulator.h"
#include "tests/drivers/aravis/stamped_picture.h"
#include "tests/drivers/aravis/u3v_host.h"

namespace rigor::u3v {
namespace {

using testing::U3vHost;
using usbip::testing::Host;

EmulatorOptions emulator_options() {
  EmulatorOptions o;
  o.port = 0;
  o.camera.camera.sensor_width_px = 320, o.camera.camera.sensor_height_px = 200;
  o.camera.camera.frame_rate_hz = 100;
  o.camera.camera.exposure_us = 500;
  o.camera.camera.readout = microseconds(100);
  return o;
}

std::unique_ptr<Emulator> start_emulator(const EmulatorOptions& o = emulator_options()) {
  auto e = Emulator::start(o, gige::testing::fill_stamped);
  if (!e) throw std::runtime_error(e.error().text());
  return std::move(*e);
}

template <class F>
bool within(Duration limit, F&& is) {
  const MonotonicTime end = monotonic_now() + limit;
  while (!is()) {
    if (monotonic_now() > end) return false;
    usleep(1000);
  }
  return true;
}

gige::testing::Verdict judge(const std::string& picture) {
  return gige::testing::judge_stamped(
      {reinterpret_cast<const std::uint8_t*>(picture.data()), picture.size()});
}

TEST(U3vEmulator, AHostImportsItAndGetsItsPictures) {
  const auto e = start_emulator();
  Host bus(e->port());
  const auto all = bus.list();
  ASSERT_EQ(all.size(), 1U);
  EXPECT_EQ(all[0].bus_id, "1-1");
  EXPECT_EQ(all[0].speed, usbip::Speed::super);
  ASSERT_EQ(all[0].interfaces.size(), 3U);
  ASSERT_EQ(bus.import("1-1"), usbip::kOk);
  U3vHost host(bus);
  ASSERT_EQ(host.write(reg::kWidth, 160), Status::success);
  ASSERT_EQ(host.write(reg::kExposureTime, 1000.0), Status::success);
  ASSERT_EQ(host.open_stream(8192), Status::success);
  ASSERT_EQ(host.write(reg::kAcquisitionStart, 1), Status::success);
  for (int i = 0; i < 20; ++i) {
    const auto f = host.take_frame();
    ASSERT_TRUE(f);
    ASSERT_EQ(f->payload.size(), 160U * 200U);
    const auto v = judge(f->payload);
    EXPECT_EQ(v.wrong + v.zero, 0U);
    EXPECT_EQ(v.exposure_start_ns, f->leader.timestamp_ns);
    EXPECT_LE(f->leader.timestamp_ns + 1'100'000, static_cast<std::uint64_t>(monotonic_now().ns()))
        << "before its exposure and readout had ended";
  }
  EXPECT_TRUE(e->health().imported);
  EXPECT_TRUE(e->health().acquiring);
  EXPECT_GE(e->health().frames_sent, 20U);
}

TEST(U3vEmulator, APulledCableEndsTheConnectionUntilItIsPluggedInAgain) {
  const auto e = start_emulator();
  Host bus(e->port());
  ASSERT_EQ(bus.import("1-1"), usbip::kOk);
  U3vHost host(bus);
  ASSERT_EQ(host.open_stream(), Status::success);
  ASSERT_EQ(host.write(reg::kAcquisitionStart, 1), Status::success);
  ASSERT_TRUE(host.take_frame());
  e->unplug();
  while (bus.open()) (void)bus.take(bus.submit(kStreamIn, 1 << 20), milliseconds(200));
  EXPECT_TRUE(within(seconds(5), [&] { return !e->health().imported; }));
  EXPECT_FALSE(e->health().acquiring);
  Host early(e->port());
  EXPECT_EQ(early.list().size(), 0U);
  EXPECT_EQ(early.import("1-1"), usbip::kNoDevice);
  e->plug();
  Host late(e->port());
  ASSERT_EQ(late.import("1-1"), usbip::kOk);
  U3vHost again(late);
  ASSERT_EQ(again.open_stream(), Status::success);
  ASSERT_EQ(again.write(reg::kAcquisitionStart, 1), Status::success);
  const auto f = again.take_frame();
  ASSERT_TRUE(f);
  EXPECT_EQ(f->leader.block_id, 0U);
  EXPECT_EQ(e->health().attached, 2U);
}

TEST(U3vEmulator, AHostThatGoesAwayLeavesTheCameraToTheNext) {
  const auto e = start_emulator();
  {
    Host bus(e->port());
    ASSERT_EQ(bus.import("1-1"), usbip::kOk);
    Host other(e->port());
    EXPECT_EQ(other.import("1-1"), usbip::kUnavailable);
  }
  EXPECT_TRUE(within(seconds(5), [&] { return !e->health().imported; }));
  Host next(e->port());
  EXPECT_EQ(next.import("1-1"), usbip::kOk);
}

TEST(U3vEmulator, EveryFrameIsTakenDroppedOrCut) {
  const auto e = start_emulator();
  Host bus(e->port());
  ASSERT_EQ(bus.import("1-1"), usbip::kOk);
  U3vHost host(bus);
  ASSERT_EQ(host.open_stream(), Status::success);
  ASSERT_EQ(host.write(reg::kAcquisitionMode, reg::kModeMultiFrame), Status::success);
  ASSERT_EQ(host.write(reg::kAcquisitionFrameCount, 40), Status::success);
  ASSERT_EQ(host.write(reg::kAcquisitionStart, 1), Status::success);
  std::uint64_t taken = 0, missing = 0, next = 0;
  const auto take = [&] {
    const auto f = host.take_frame(milliseconds(500));
    if (!f) return false;
    missing += f->leader.block_id - next;
    next = f->leader.block_id + 1;
    ++taken;
    return true;
  };
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(take());
  // The host pauses: four frames wait, the others are dropped.
  ASSERT_TRUE(within(seconds(10), [&] { return e->health().frames_dropped >= 5; }));
  while (take()) {
  }
  missing += 40 - next;
  ASSERT_TRUE(within(seconds(10), [&] { return !e->health().acquiring; }));
  const EmulatorHealth h = e->health();
  EXPECT_EQ(taken, h.frames_sent);
  EXPECT_EQ(missing, h.frames_dropped) << "a frame that was dropped is missing in the numbers";
  EXPECT_EQ(h.frames_sent + h.frames_dropped + h.frames_cut, 40U);
  EXPECT_GE(taken, 7U);
}

TEST(U3vEmulator, ASlowLinkTakesItsTimeAndDropsWhatItCannotCarry) {
  auto o = emulator_options();
  o.link_bits_per_s = 8e6;  // 64 ms for a picture of 64,000 bytes, and one is exposed every 10 ms
  const auto e = start_emulator(o);
  Host bus(e->port());
  ASSERT_EQ(bus.import("1-1"), usbip::kOk);
  U3vHost host(bus);
  ASSERT_EQ(host.open_stream(), Status::success);
  ASSERT_EQ(host.write(reg::kAcquisitionStart, 1), Status::success);
  std::uint64_t missing = 0, next = 0;
  for (int i = 0; i < 8; ++i) {
    const auto f = host.take_frame();
    ASSERT_TRUE(f);
    EXPECT_GE(static_cast<std::uint64_t>(monotonic_now().ns()), f->leader.timestamp_ns + 64'000'000);
    missing += f->leader.block_id - next;
    next = f->leader.block_id + 1;
  }
  EXPECT_GE(missing, 8U) << "no more than four wait for the link";
  EXPECT_GE(e->health().frames_dropped, missing);
}

TEST(U3vEmulator, PicturesThatCameTooLateAreCounted) {
  auto o = emulator_options();
  o.camera.camera.readout = microseconds(0);
  const auto late = [](const gige::FrameRequest& r, gige::MutableBytes picture) {
    const bool filled = gige::testing::fill_stamped(r, picture);
    while (monotonic_now().ns() < (r.t_exposure_start + r.exposure + milliseconds(1)).ns()) {
    }
    return filled;
  };
  auto started = Emulator::start(o, late);
  ASSERT_TRUE(started);
  Host bus((*started)->port());
  ASSERT_EQ(bus.import("1-1"), usbip::kOk);
  U3vHost host(bus);
  ASSERT_EQ(host.open_stream(), Status::success);
  ASSERT_EQ(host.write(reg::kAcquisitionMode, reg::kModeSingleFrame), Status::success);
  ASSERT_EQ(host.write(reg::kAcquisitionStart, 1), Status::success);
  ASSERT_TRUE(host.take_frame());
  EXPECT_EQ((*started)->health().pictures_late, 1U);
}

TEST(U3vEmulator, WhatIsNoUsbIpIsCountedAndDropped) {
  const auto e = start_emulator();
  Host http(e->port());
  http.write("GET / HTTP/1.1\r\n\r\n");
  EXPECT_FALSE(http.take(1, seconds(2)));
  EXPECT_FALSE(http.open());
  EXPECT_TRUE(within(seconds(5), [&] { return e->health().bus_errors == 1; }));
}

TEST(U3vEmulator, SaysWhyItCannotStart) {
  const auto fill = gige::testing::fill_stamped;
  auto o = emulator_options();
  const auto first = start_emulator(o);
  o.port = first->port();
  EXPECT_EQ(Emulator::start(o, fill).error().code, ErrorCode::unavailable);
  o = emulator_options();
  o.address = "camera";
  EXPECT_EQ(Emulator::start(o, fill).error().code, ErrorCode::bad_input);
  o = emulator_options();
  o.bus_id = std::string(40, '1');
  EXPECT_EQ(Emulator::start(o, fill).error().code, ErrorCode::bad_input);
  EXPECT_EQ(Emulator::start(emulator_options(), nullptr).error().code, ErrorCode::bad_input);
}

}  // namespace
}  // namespace rigor::u3v
