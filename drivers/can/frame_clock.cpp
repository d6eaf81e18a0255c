#include "drivers/can/frame_clock.h"

#include <linux/errqueue.h>
#include <sys/socket.h>

#include <cstring>

namespace rigor::can {
namespace {

/// From the end of a frame to the kernel's stamp: an interrupt, or a transfer over USB.
constexpr Duration kInterruptSigma = microseconds(100);
/// What a reader on a busy machine adds: uniform within a millisecond.
constexpr Duration kReaderSigma = microseconds(289);
/// A stamp that is further from the reader's clock is of a CLOCK_REALTIME that was set meanwhile.
constexpr Duration kBelieved = seconds(2);
/// An interrupt that comes later than this is less likely than a clock that stepped.
constexpr Duration kInterruptLimit = milliseconds(50);
/// No frame ended after it was stamped or read, but for what two readings of clocks differ by.
constexpr Duration kAhead = milliseconds(1);

std::optional<std::int64_t> ns_of(const timespec& t) noexcept {
  if (t.tv_sec == 0 && t.tv_nsec == 0) return {};  // the kernel's way to say that there is none
  return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
}

ClockMapOptions options() noexcept {
  ClockMapOptions o;
  o.min_delay_sigma = kInterruptSigma;
  return o;
}

}  // namespace

const char* stamp_name(StampKind kind) noexcept {
  switch (kind) {
    case StampKind::hardware:
      return "hardware";
    case StampKind::kernel:
      return "kernel";
    case StampKind::arrival:
      return "arrival";
  }
  return "unknown";
}

FrameStamps stamps_of(const msghdr& message) noexcept {
  FrameStamps s;
  // CMSG_NXTHDR takes no constant message, and changes none.
  auto* m = const_cast<msghdr*>(&message);
  for (cmsghdr* c = CMSG_FIRSTHDR(m); c; c = CMSG_NXTHDR(m, c)) {
    if (c->cmsg_level != SOL_SOCKET) continue;
    if (c->cmsg_type == SCM_TIMESTAMPING && c->cmsg_len >= CMSG_LEN(sizeof(scm_timestamping))) {
      scm_timestamping t{};  // software, legacy, the interface's own
      std::memcpy(&t, CMSG_DATA(c), sizeof t);
      if (const auto ns = ns_of(t.ts[0])) s.kernel = RealtimeTime(*ns);
      if (const auto ns = ns_of(t.ts[2])) s.hardware = DeviceTime(*ns);
    } else if (c->cmsg_type == SCM_TIMESTAMPNS && c->cmsg_len >= CMSG_LEN(sizeof(timespec))) {
      timespec t{};
      std::memcpy(&t, CMSG_DATA(c), sizeof t);
      if (const auto ns = ns_of(t); ns && !s.kernel) s.kernel = RealtimeTime(*ns);
    }
  }
  return s;
}

FrameClock::FrameClock(StampKind wanted) noexcept : wanted_(wanted), hardware_(options()) {}

void FrameClock::want(StampKind kind) noexcept {
  wanted_ = kind;
  reset();
  for (auto& n : counts_) n.store(0, std::memory_order_relaxed);
}

FrameClock::Placed FrameClock::best_of(const FrameStamps& s, const EpochPair& epoch,
                                       BenchTime read) noexcept {
  std::optional<BenchTime> kernel;
  if (s.kernel) {
    const BenchTime t = epoch.to_bench(*s.kernel);
    if (t <= read + kAhead && read - t <= kBelieved) kernel = t;
  }
  if (wanted_ == StampKind::hardware && s.hardware) {
    if (kernel) (void)hardware_.add_arrival(*s.hardware, *kernel);
    const Mapped m = hardware_.map(*s.hardware);
    const BenchTime latest = kernel.value_or(read) + kAhead;
    if (m.known && m.t <= latest && latest - m.t <= (kernel ? kInterruptLimit : kBelieved))
      return {m.t, m.sigma, StampKind::hardware};
  }
  if (wanted_ != StampKind::arrival && kernel) return {*kernel, epoch.sigma, StampKind::kernel};
  return {read, kReaderSigma, StampKind::arrival};
}

FrameClock::Placed FrameClock::place(const FrameStamps& s, const EpochPair& epoch, BenchTime read) noexcept {
  const Placed p = best_of(s, epoch, read);
  counts_[static_cast<std::size_t>(p.kind)].fetch_add(1, std::memory_order_relaxed);
  return p;
}

}  // namespace rigor::can
