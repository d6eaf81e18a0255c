#include "drivers/gnss/pulse_input.h"

#include <fcntl.h>
#include <linux/pps.h>
#include <sys/ioctl.h>

#include <cerrno>
#include <cstring>
#include <utility>

namespace rigor::gnss {

Status PulseInput::open(const std::string& device) {
  fd_.reset(::open(device.c_str(), O_RDWR | O_CLOEXEC));
  if (!fd_) {
    const int e = errno;
    return fail(
        e == ENOENT ? ErrorCode::not_found : ErrorCode::unavailable, device,
        std::string("expected a pulse input of the kernel, cannot open it: ") + std::strerror(e) +
            (e == EACCES ? "; sudo chgrp dialout " + device + " && sudo chmod g+rw " + device
                         : "; a pulse on a serial port's DCD line needs: sudo ldattach PPS /dev/ttyS0"));
  }
  int can = 0;
  if (::ioctl(fd_.get(), PPS_GETCAP, &can) != 0 || (can & PPS_CAPTUREASSERT) == 0) {
    close();
    return fail(ErrorCode::bad_input, device,
                "expected a pulse input that stamps rising edges, got something else");
  }
  any_ = false;
  return {};
}

std::optional<PulseInput::Edge> PulseInput::next(Duration at_most) {
  pps_fdata data{};
  data.timeout.sec = at_most.ns() / 1'000'000'000;
  data.timeout.nsec = static_cast<__s32>(at_most.ns() % 1'000'000'000);
  if (!fd_ || ::ioctl(fd_.get(), PPS_FETCH, &data) != 0) return {};
  const bool fresh = !any_ || data.info.assert_sequence != last_;
  last_ = data.info.assert_sequence;
  // The first one may be old.
  if (!std::exchange(any_, true) || !fresh) return {};
  const EpochPair epoch = read_epoch();
  const BenchTime t =
      epoch.to_bench(RealtimeTime(data.info.assert_tu.sec * 1'000'000'000 + data.info.assert_tu.nsec));
  const Duration half = epoch.sigma * 2 + microseconds(1);
  return Edge{t - half, t + half};
}

}  // namespace rigor::gnss
