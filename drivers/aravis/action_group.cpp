#include "drivers/aravis/action_group.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <map>
#include <utility>

namespace rigor {
namespace {

constexpr Duration kSilence = seconds(4);           // of the member that feeds the clock
constexpr Duration kLatest = microseconds(500);     // before the exposure: later there is no use in a command
constexpr Duration kNearInstant = milliseconds(2);  // an exposure further from every command obeys none

constexpr Duration kGoodJitter = microseconds(100);

}  // namespace

bool ActionStatistics::good() const {
  // The newest commands may be on their way, as may the frames of the newest exposures.
  const bool exposing = in_time < 20 || exposed * 2 >= in_time;
  return late + refused + not_sent == 0 && sent - in_time <= 1 && exposing && jitter_max < kGoodJitter;
}

std::string ActionStatistics::text() const {
  const auto us = [](Duration d) { return static_cast<double>(d.ns()) * 1e-3; };
  return fmt::format(
      "{} action commands, {} in time, {} late, {} refused{}, {} not answered, {} not sent; answers after "
      "{:.0f} µs, "
      "{:.0f} at most; {} exposures within {:.1f} µs of their instants, {:.1f} at most",
      sent, in_time, late, refused, refusal.empty() ? "" : " (" + refusal + ")",
      sent - in_time - late - refused, not_sent, us(answer_mean), us(answer_max), exposed, us(jitter_mean),
      us(jitter_max));
}

std::shared_ptr<ActionGroup> ActionGroup::join(std::uint32_t device_key, std::uint32_t group_key) {
  static std::mutex mutex;
  static std::map<std::pair<std::uint32_t, std::uint32_t>, std::weak_ptr<ActionGroup>> groups;
  const std::scoped_lock lock(mutex);
  auto& place = groups[{device_key, group_key}];
  auto group = place.lock();
  if (!group) place = group = std::make_shared<ActionGroup>();
  return group;
}

void ActionGroup::add_latch(const void* member, DeviceTime x, BenchTime before, BenchTime after) {
  const std::scoped_lock lock(mutex_);
  if (source_ != member && source_ != nullptr && after - fed_ < kSilence) return;
  if (source_ != member && x <= newest_ && after - fed_ < kSilence * 2)
    return;  // another camera's, a little behind
  source_ = member;
  fed_ = after;
  newest_ = x;
  (void)clock_.add_latch(x, before, after);
}

Duration ActionGroup::distance(DeviceTime x, BenchTime before, BenchTime after) const {
  const Mapped m = clock_.map(x);
  if (!m.known) return {};
  const Duration slack = m.sigma * 5;
  return std::max({Duration{}, m.t - after - slack, before - m.t - slack});
}

std::optional<DeviceTime> ActionGroup::time_of(BenchTime t) {
  const std::scoped_lock lock(mutex_);
  for (const Told& told : told_)
    if (told.t == t && told.x != DeviceTime{}) return told.x;
  if (clock_.state().pairs == 0) return std::nullopt;
  const Told told{t, clock_.unmap(t)};
  told_[told_count_++ % told_.size()] = told;
  return told.x;
}

Status ActionSender::aim(const std::string& address) {
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(gige::kGvcpPort);
  socket_.reset(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (inet_pton(AF_INET, address.c_str(), &to.sin_addr) != 1 || !socket_ ||
      connect(socket_.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0)
    return fail(ErrorCode::io, address,
                std::string("cannot open a socket for action commands: ") + std::strerror(errno));
  const int on = 1;
  (void)setsockopt(socket_.get(), SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
  return {};
}

void ActionSender::send(const gige::ActionCmd& command, DeviceTime t) {
  const std::scoped_lock lock(mutex_);
  id_ = id_ == 0xFFFF ? std::uint16_t{1} : static_cast<std::uint16_t>(id_ + 1);
  const auto datagram = gige::encode_action_cmd(id_, command);
  sent_[id_ % sent_.size()] = {id_, realtime_now(), t, false, false};
  ++statistics_.sent;
  // What does not arrive is not answered.
  (void)!::send(socket_.get(), datagram.data(), datagram.size(), MSG_NOSIGNAL);
}

void ActionSender::restart() {
  const std::scoped_lock lock(mutex_);
  next_ = 0;
  sent_ = {};
  statistics_ = {};
  answer_sum_ = jitter_sum_ = {};
}

ActionSender::Due ActionSender::send_due(BenchTime now, const Schedule& s, ActionGroup& group) {
  receive();
  Due due;
  while (true) {
    const BenchTime t = s.t0 + s.period * next_;
    if (now < t - s.lead) {
      due.wait = t - s.lead - now;
      return due;
    }
    ++next_;
    if (const auto x = now + kLatest < t ? group.time_of(t) : std::nullopt) {
      gige::ActionCmd command = s.keys;
      command.time_ticks = s.ticks(*x);
      send(command, *x);
      due.asked = t;
    } else {
      const std::scoped_lock lock(mutex_);
      ++statistics_.not_sent;
    }
  }
}

void ActionSender::receive() {
  std::array<std::uint8_t, 1024> buffer;
  std::array<char, 256> control;
  while (true) {
    iovec data{buffer.data(), buffer.size()};
    msghdr m{};
    m.msg_iov = &data, m.msg_iovlen = 1;
    m.msg_control = control.data(), m.msg_controllen = control.size();
    const ssize_t n = recvmsg(socket_.get(), &m, 0);
    if (n < 0) return;
    // The kernel knows when an answer came; it may have waited here.
    RealtimeTime arrival = realtime_now();
    for (cmsghdr* c = CMSG_FIRSTHDR(&m); c != nullptr; c = CMSG_NXTHDR(&m, c)) {
      timespec t{};
      if (c->cmsg_level != SOL_SOCKET || c->cmsg_type != SCM_TIMESTAMPNS) continue;
      std::memcpy(&t, CMSG_DATA(c), sizeof t);
      arrival = RealtimeTime(t.tv_sec * 1'000'000'000 + t.tv_nsec);
    }
    gige::GvcpAck ack;
    if (gige::decode_gvcp_ack({buffer.data(), static_cast<std::size_t>(n)}, ack) != gige::DecodeStatus::ok ||
        ack.command != static_cast<std::uint16_t>(gige::GvcpCommand::action_ack))
      continue;
    const std::scoped_lock lock(mutex_);
    Sent& s = sent_[ack.ack_id % sent_.size()];
    if (s.id != ack.ack_id || std::exchange(s.answered, true)) continue;
    const Duration answer = arrival - s.at;
    answer_sum_ = answer_sum_ + answer;
    statistics_.answer_max = std::max(statistics_.answer_max, answer);
    if (ack.status == gige::GvStatus::success) {
      ++statistics_.in_time;
    } else if (ack.status == gige::GvStatus::action_late) {
      ++statistics_.late;
    } else {
      ++statistics_.refused;
      if (statistics_.refusal.empty()) statistics_.refusal = to_string(ack.status);
    }
  }
}

void ActionSender::exposed(DeviceTime t) {
  const std::scoped_lock lock(mutex_);
  Sent* nearest = nullptr;
  const auto off = [t](const Sent& s) { return s.t > t ? s.t - t : t - s.t; };
  for (Sent& s : sent_)
    if (!s.seen && (nearest == nullptr || off(s) < off(*nearest))) nearest = &s;
  if (nearest == nullptr || off(*nearest) > kNearInstant) return;
  nearest->seen = true;
  ++statistics_.exposed;
  jitter_sum_ = jitter_sum_ + off(*nearest);
  statistics_.jitter_max = std::max(statistics_.jitter_max, off(*nearest));
}

ActionStatistics ActionSender::statistics() const {
  const std::scoped_lock lock(mutex_);
  ActionStatistics s = statistics_;
  const auto answered = static_cast<std::int64_t>(s.in_time + s.late + s.refused);
  if (answered > 0) s.answer_mean = answer_sum_ / answered;
  if (s.exposed > 0) s.jitter_mean = jitter_sum_ / static_cast<std::int64_t>(s.exposed);
  return s;
}

}  // namespace rigor
