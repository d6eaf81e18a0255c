// Instants of CAN frames by the kernel's control messages, which are made here: no controller with a clock of
// its own is at hand.
#include "drivers/can/frame_clock.h"

#include <gtest/gtest.h>
#include <linux/errqueue.h>
#include <sys/socket.h>

#include <cmath>
#include <cstring>
#include <vector>

namespace rigor::can {
namespace {

/// A message as recvmsg leaves it.
class Control {
 public:
  Control& add(int level, int type, const void* data, std::size_t size) {
    const std::size_t at = bytes_.size();
    bytes_.resize(at + CMSG_SPACE(size));
    cmsghdr head{};
    head.cmsg_level = level;
    head.cmsg_type = type;
    head.cmsg_len = CMSG_LEN(size);
    std::memcpy(bytes_.data() + at, &head, sizeof head);
    std::memcpy(bytes_.data() + at + CMSG_LEN(0), data, size);
    return *this;
  }
  Control& timestamping(std::int64_t software_ns, std::int64_t hardware_ns) {
    scm_timestamping t{};
    t.ts[0] = {software_ns / 1'000'000'000, software_ns % 1'000'000'000};
    t.ts[1] = {77, 77};  // of the interface, made into system time: no kernel fills it any more
    t.ts[2] = {hardware_ns / 1'000'000'000, hardware_ns % 1'000'000'000};
    return add(SOL_SOCKET, SCM_TIMESTAMPING, &t, sizeof t);
  }
  [[nodiscard]] FrameStamps read() {
    msghdr m{};
    m.msg_control = bytes_.data();
    m.msg_controllen = bytes_.size();
    return stamps_of(m);
  }

 private:
  std::vector<char> bytes_;
};

constexpr std::int64_t kUtc_ns = 1'700'000'000'123'456'789;
constexpr BenchTime kStart(5'000'000'000);
/// Bench time `kStart` is UTC `kUtc_ns`.
const EpochPair kEpoch{kStart, RealtimeTime(kUtc_ns), nanoseconds(40)};

TEST(FrameStamps, AreReadFromTheKernelsControlMessages) {
  const FrameStamps both = Control().timestamping(kUtc_ns, 42'000'000'007).read();
  EXPECT_EQ(both.kernel, RealtimeTime(kUtc_ns));
  EXPECT_EQ(both.hardware, DeviceTime(42'000'000'007));

  const FrameStamps software = Control().timestamping(kUtc_ns, 0).read();
  EXPECT_EQ(software.kernel, RealtimeTime(kUtc_ns));
  EXPECT_FALSE(software.hardware) << "zero is the kernel's way to say that there is none";
  const FrameStamps hardware = Control().timestamping(0, 1).read();
  EXPECT_FALSE(hardware.kernel);
  EXPECT_EQ(hardware.hardware, DeviceTime(1));

  const timespec t{kUtc_ns / 1'000'000'000, kUtc_ns % 1'000'000'000};
  const std::uint32_t dropped = 3;
  EXPECT_EQ(Control()
                .add(SOL_SOCKET, SO_RXQ_OVFL, &dropped, sizeof dropped)
                .add(SOL_SOCKET, SCM_TIMESTAMPNS, &t, sizeof t)
                .read()
                .kernel,
            RealtimeTime(kUtc_ns));
  const FrameStamps none = Control().add(SOL_SOCKET, SO_RXQ_OVFL, &dropped, sizeof dropped).read();
  EXPECT_FALSE(none.kernel || none.hardware);
  EXPECT_FALSE(Control().add(SOL_SOCKET, SCM_TIMESTAMPING, &t, sizeof t).read().kernel)
      << "a message that is too short for its kind";
  EXPECT_FALSE(FrameStamps(stamps_of(msghdr{})).kernel);
}

/// A bus whose frames end each millisecond; an interface's clock that began 30 s before the bench's and runs
/// fast by 30 ppm; a kernel that stamps 20 to 200 µs later, and a reader that is up to 20 ms behind.
struct Bus {
  struct Frame {
    BenchTime end, read;
    FrameStamps stamps;
  };
  Frame next() {
    Frame f;
    f.end = kStart + milliseconds(1) * ++k;
    f.stamps.hardware = DeviceTime(
        static_cast<std::int64_t>(std::llround((static_cast<double>(f.end.ns()) + 30e9) * (1 + 30e-6))));
    const Duration interrupt = microseconds(20) + microseconds(180) * ((k * 7919) % 101) / 100;
    f.stamps.kernel = kEpoch.to_utc(f.end + interrupt);
    f.read = f.end + interrupt + milliseconds(20) * ((k * 104729) % 97) / 97;
    return f;
  }
  std::int64_t k = 0;
};

TEST(FrameClock, HardwareStampsLeadToTheBenchClockThroughTheKernels) {
  Bus bus;
  FrameClock clock(StampKind::hardware);
  std::int64_t worst_ns = 0, worst_step_ns = 0;
  BenchTime last;
  for (int i = 0; i < 20000; ++i) {
    const Bus::Frame f = bus.next();
    const auto p = clock.place(f.stamps, kEpoch, f.read);
    ASSERT_EQ(p.kind, StampKind::hardware) << i;
    if (i >= 8000) {  // the drift is known
      worst_ns = std::max(worst_ns, std::abs((p.t - f.end).ns()));
      worst_step_ns = std::max(worst_step_ns, std::abs((p.t - last).ns() - 1'000'000));
    }
    EXPECT_LE(std::abs((p.t - f.end).ns()), 4 * p.sigma.ns()) << i;
    last = p.t;
  }
  // 20 µs of every interrupt cannot be seen; the 180 µs of scatter, and the reader's 20 ms, are not in it.
  EXPECT_LT(worst_ns, 25'000);
  EXPECT_LT(worst_step_ns, 3'000) << "the kernel's stamps scatter by 180 µs from frame to frame";
  EXPECT_EQ(clock.count(StampKind::hardware), 20000u);

  // What is known of the clock serves frames without the kernel's stamp, too.
  Bus::Frame f = bus.next();
  f.stamps.kernel.reset();
  const auto alone = clock.place(f.stamps, kEpoch, f.read);
  EXPECT_EQ(alone.kind, StampKind::hardware);
  EXPECT_NEAR(static_cast<double>((alone.t - f.end).ns()), 0, 25'000);
}

TEST(FrameClock, LearnsNothingOfTheInterfaceFromTheReader) {
  Bus bus;
  FrameClock clock(StampKind::hardware);
  for (int i = 0; i < 50; ++i) {
    Bus::Frame f = bus.next();
    f.stamps.kernel.reset();
    const auto p = clock.place(f.stamps, kEpoch, f.read);
    ASSERT_EQ(p.kind, StampKind::arrival) << "a clock that is tied to nothing";
    ASSERT_EQ(p.t, f.read);
  }
  EXPECT_EQ(clock.count(StampKind::arrival), 50u);
}

TEST(FrameClock, GivesTheKindThatIsWantedOrTheNextBest) {
  Bus bus;
  const Bus::Frame f = bus.next();
  FrameClock kernel(StampKind::kernel);
  auto p = kernel.place(f.stamps, kEpoch, f.read);
  EXPECT_EQ(p.kind, StampKind::kernel);
  EXPECT_EQ(kEpoch.to_utc(p.t), *f.stamps.kernel);
  EXPECT_EQ(p.sigma, kEpoch.sigma);
  p = kernel.place({{}, f.stamps.hardware}, kEpoch, f.read);
  EXPECT_EQ(p.kind, StampKind::arrival) << "not asked for hardware stamps";
  EXPECT_GT(p.sigma, microseconds(100));

  FrameClock arrival(StampKind::arrival);
  p = arrival.place(f.stamps, kEpoch, f.read);
  EXPECT_EQ(p.kind, StampKind::arrival);
  EXPECT_EQ(p.t, f.read);

  FrameClock hardware(StampKind::hardware);
  p = hardware.place({f.stamps.kernel, {}}, kEpoch, f.read);
  EXPECT_EQ(p.kind, StampKind::kernel) << "an interface without a clock";
}

TEST(FrameClock, DoesNotBelieveStampsOfAClockThatWasSet) {
  Bus bus;
  const Bus::Frame f = bus.next();
  FrameClock clock(StampKind::kernel);
  for (const Duration off : {seconds(3600), seconds(-3600), milliseconds(5), seconds(-3)}) {
    const RealtimeTime wrong = kEpoch.to_utc(f.read) + off;
    EXPECT_EQ(clock.place({wrong, {}}, kEpoch, f.read).kind, StampKind::arrival) << off.ns();
  }
  EXPECT_EQ(clock.place({kEpoch.to_utc(f.read) - seconds(1), {}}, kEpoch, f.read).kind, StampKind::kernel)
      << "a reader that was held up";
}

TEST(FrameClock, AStepOfTheInterfacesClockIsNoStepOfTheFrames) {
  Bus bus;
  FrameClock clock(StampKind::hardware);
  const auto place = [&](Duration step) {
    Bus::Frame f = bus.next();
    f.stamps.hardware = *f.stamps.hardware + step;
    const auto p = clock.place(f.stamps, kEpoch, f.read);
    EXPECT_LE(std::abs((p.t - f.end).ns()), 250'000) << bus.k;
    return p.kind;
  };
  for (int i = 0; i < 500; ++i) ASSERT_EQ(place({}), StampKind::hardware);
  // The controller was restarted and counts from an earlier value.
  int kernel = 0;
  for (int i = 0; i < 500; ++i) kernel += place(seconds(-20)) == StampKind::kernel;
  EXPECT_LE(kernel, 1);
  // It leaps ahead: the frames seem to come before they were sent.
  kernel = 0;
  for (int i = 0; i < 500; ++i) kernel += place(seconds(3)) == StampKind::kernel;
  EXPECT_GE(kernel, 1) << "one frame contradicts, the second one proves it";
  EXPECT_LE(kernel, 2);
  // It steps back a little, which could be frames that came late, for a second.
  kernel = 0;
  for (int i = 0; i < 2000; ++i) kernel += place(milliseconds(2500)) == StampKind::kernel;
  EXPECT_GE(kernel, 900);
  EXPECT_LE(kernel, 1100);
  clock.want(StampKind::kernel);
  EXPECT_EQ(clock.count(StampKind::hardware), 0u);
  EXPECT_EQ(place({}), StampKind::kernel);
}

}  // namespace
}  // namespace rigor::can
