#include "rt-core/deadline.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace rigor {

Status Deadline::open() {
  if (!timer_) timer_.reset(::timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK));
  if (!event_) event_.reset(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!timer_ || !event_)
    return fail(ErrorCode::io, "", std::string("cannot make a timer: ") + std::strerror(errno));
  reset();
  return {};
}

bool Deadline::wait_until(MonotonicTime t) noexcept {
  pollfd fds[2] = {{event_.get(), POLLIN, 0}, {timer_.get(), POLLIN, 0}};
  // All zero would disarm the timer instead of firing at once.
  const std::int64_t ns = t.ns() > 0 ? t.ns() : 1;
  const itimerspec when{{0, 0}, {ns / 1'000'000'000, ns % 1'000'000'000}};
  ::timerfd_settime(timer_.get(), TFD_TIMER_ABSTIME, &when, nullptr);
  while (::poll(fds, 2, -1) < 0 && errno == EINTR) {
  }
  return (fds[0].revents & POLLIN) == 0;
}

void Deadline::cut() noexcept {
  const std::uint64_t one = 1;
  [[maybe_unused]] const auto n = ::write(event_.get(), &one, sizeof one);
}

void Deadline::reset() noexcept {
  std::uint64_t count = 0;
  [[maybe_unused]] const auto n = ::read(event_.get(), &count, sizeof count);
}

}  // namespace rigor
