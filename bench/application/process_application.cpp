#include "bench/application/process_application.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <mutex>
#include <nlohmann/json.hpp>
#include <thread>

#include "bench/application/child_process.h"
#include "bench/application/setup_message.h"
#include "bench/application/turns.h"
#include "sensor-hal/config/json_text.h"
#include "sensor-hal/types/sample_memory.h"

namespace rigor {
namespace application {
namespace {

constexpr std::size_t kTurnBytes = std::size_t{192}
                                   << 10;  ///< of samples; a socket's buffer takes it at once
constexpr std::size_t kVirtualTurnBytes = std::size_t{8}
                                          << 20;  ///< in virtual time one waits for the process to read
constexpr int kWaitSlice_ms = 50;

/// Why a connection is of no use any more.
enum class Broken : std::uint8_t { no, closed, malformed, hangs, refused };

struct Settings {
  ChildProcess::Command command;
  double rate_hz = 0;  ///< 0: what the program asks for
  nlohmann::json params;
  bool restart = false, safe_when_late = false;
  Duration start_timeout, answer_timeout, deadline;  ///< deadline 0: until the next turn
};

class ProcessApplication final : public Application {
 public:
  explicit ProcessApplication(const RigConfig& rig)
      : rig_(rig), virtual_time_(rig.clock == ClockKind::virtual_time) {}
  ~ProcessApplication() override {
    hold_supervisor();
    child_.reset();
    end_supervisor();
  }

  Status configure(ConfigNode params, const ApplicationPorts& ports, Period loop_period) override;
  void step(std::uint64_t cycle, BenchTime t) noexcept override;
  Status finish() override;
  bool failed() const noexcept override { return failed_.load(std::memory_order_relaxed); }
  bool in_charge() const noexcept override { return !settings_.safe_when_late || charge_; }
  std::optional<ApplicationFacts> facts() const override {
    ApplicationFacts f = turns_ ? turns_->facts : ApplicationFacts{};
    f.restarts = restarts_.load();
    return f;
  }

 private:
  Settings read_settings(const ConfigNode& n);
  Result<ChildProcess> start_child();

  // Loop thread.
  bool give_turn(std::uint64_t cycle, BenchTime t) noexcept;
  Broken receive(BenchTime t, bool wait) noexcept;
  Broken take_answer(BenchTime t) noexcept;
  void disconnect(Broken why) noexcept;
  void step_virtual(std::uint64_t cycle, BenchTime t) noexcept;
  void step_wall(std::uint64_t cycle, BenchTime t) noexcept;

  // Whoever owns the process: in virtual time the loop's thread, else the supervisor.
  bool restart_process() noexcept;
  std::string why_broken();
  void set_failed(Error error) noexcept;
  void supervise();
  void hold_supervisor();
  void end_supervisor();

  const RigConfig& rig_;
  const bool virtual_time_;
  Settings settings_;
  StopToken stop_;
  std::string setup_;  ///< its JSON, for every process anew
  std::uint64_t every_ = 1;

  // Loop thread.
  std::optional<Turns> turns_;
  std::vector<std::byte> answer_;
  std::size_t got_ = 0;
  int fd_ = -1;        ///< of the process that is talked to; -1: none
  bool owed_ = false;  ///< an answer to turn `turn_cycle_`, which was given at `given_`
  bool late_ = false;  ///< that answer is
  bool charge_ = true;
  std::uint64_t turn_cycle_ = 0;
  MonotonicTime given_;
  bool loop_over_ = false;  ///< the loop is over: answers command nothing

  // Between the loop and the supervisor.
  std::atomic<int> offered_{-1};            ///< a connection for the loop to take up
  std::atomic<Broken> broken_{Broken::no};  ///< the loop has let go of it
  std::atomic<bool> died_{false};           ///< the process did; the loop has to let go
  std::atomic<bool> failed_{false};
  std::atomic<std::uint64_t> restarts_{0};

  std::optional<ChildProcess> child_;
  std::optional<Error> error_;  ///< why the application failed; read when the loop is over
  std::thread supervisor_;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool ending_ = false, over_ = false;
};

Settings ProcessApplication::read_settings(const ConfigNode& n) {
  Settings s;
  for (const ConfigNode& word : n.list("command")) s.command.words.push_back(word.as_text());
  if (s.command.words.empty() || s.command.words[0].empty())
    throw n.error("command", "expected a list of a program and its arguments, got none");
  s.command.directory = n.base_dir();
  s.command.where = n.error("command", "").error().where;
  s.rate_hz = n.number_or("rate_hz", 0, {.min = 0.001, .max = rig_.loop.period.hz()});
  s.params = nlohmann::json::parse(n.map_or_absent("params").json());
  s.restart = n.choice_or("on_exit", {"fail", "restart"}, "fail") == "restart";
  s.safe_when_late = n.choice_or("on_late", {"hold", "safe"}, "hold") == "safe";
  s.start_timeout = seconds_from(n.number_or("start_timeout_s", 30, {.min = 0.1, .max = 3600}));
  s.answer_timeout = seconds_from(n.number_or("answer_timeout_s", 10, {.min = 0.01, .max = 3600}));
  if (n.has("deadline_ms"))
    s.deadline = seconds_from(n.number("deadline_ms", {.min = 0.001, .max = 3.6e6}) * 1e-3);
  n.finish();
  return s;
}

Status ProcessApplication::configure(ConfigNode params, const ApplicationPorts& ports, Period loop_period) {
  auto read = catch_config([&] { return read_settings(params); });
  if (!read) return tl::unexpected<Error>(read.error());
  settings_ = std::move(*read);
  stop_ = ports.stop;
  turns_.emplace(ports, virtual_time_ ? kVirtualTurnBytes : kTurnBytes, [](const Sample& sample) noexcept {
    return static_cast<std::uint64_t>(sample.shared_offset());
  });
  answer_.resize(sizeof(MessageHeader) + kMaxCommandsBytes);
  setup_ = setup_message(rig_, ports, loop_period, settings_.params)
               .dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);

  auto child = start_child();
  if (!child) return tl::unexpected<Error>(child.error());
  child_ = std::move(*child);
  every_ = cycles_of_turn(settings_.rate_hz, loop_period);
  fd_ = child_->socket();
  if (!virtual_time_) supervisor_ = std::thread([this] { supervise(); });
  return {};
}

Result<ChildProcess> ProcessApplication::start_child() {
  auto child = ChildProcess::start(settings_.command, settings_.start_timeout, stop_);
  if (!child) return child;
  auto setup = nlohmann::json::parse(setup_);
  if (child->memory_fd() < 0)
    return fail(ErrorCode::io, settings_.command.where,
                "the application cannot be given the memory of the samples: no file descriptor is left");
  setup["memory"] = "/proc/self/fd/" + std::to_string(child->memory_fd());
  if (auto s = child->send(MessageType::setup, setup); !s) return tl::unexpected<Error>(s.error());
  auto ready = child->receive(MessageType::ready, settings_.start_timeout, stop_);
  if (!ready) return tl::unexpected<Error>(ready.error());
  auto rate_hz = rate_of_turns(settings_.rate_hz, *ready, rig_.loop.period, settings_.command.where);
  if (!rate_hz) return tl::unexpected<Error>(rate_hz.error());
  settings_.rate_hz = *rate_hz;
  return child;
}

// ------------------------------------------------------------------ loop

bool ProcessApplication::give_turn(std::uint64_t cycle, BenchTime t) noexcept {
  const std::span<const std::byte> bytes = turns_->make(cycle, t);
  given_ = monotonic_now();
  for (std::size_t sent = 0; sent < bytes.size();) {
    const ssize_t n = send(fd_, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL | MSG_DONTWAIT);
    sent += static_cast<std::size_t>(std::max<ssize_t>(n, 0));
    if (n > 0 || (n < 0 && errno == EINTR)) continue;
    // In wall-clock time the socket is empty here, for the previous turn was answered: a message that does
    // not fit shows that the process does not read.
    if (errno != EAGAIN || !virtual_time_ || monotonic_now() - given_ > settings_.answer_timeout)
      return false;
    pollfd ready{fd_, POLLOUT, 0};
    (void)poll(&ready, 1, kWaitSlice_ms);
  }
  turns_->given();
  owed_ = true;
  late_ = false;
  turn_cycle_ = cycle;
  return true;
}

/// no: the answer is there (then `owed_` is false), or is not here yet.
Broken ProcessApplication::receive(BenchTime t, bool wait) noexcept {
  while (owed_) {
    const ssize_t n = recv(fd_, answer_.data() + got_, answer_.size() - got_, MSG_DONTWAIT);
    if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) return Broken::closed;
    if (n > 0) {
      got_ += static_cast<std::size_t>(n);
      if (const Broken b = take_answer(t); b != Broken::no) return b;
      continue;
    }
    if (monotonic_now() - given_ > settings_.answer_timeout) return Broken::hangs;
    if (!wait || stop_.stop_requested()) return Broken::no;
    pollfd ready{fd_, POLLIN, 0};
    (void)poll(&ready, 1, kWaitSlice_ms);
  }
  return Broken::no;
}

/// Of what has come so far.
Broken ProcessApplication::take_answer(BenchTime t) noexcept {
  MessageHeader header;
  if (got_ < sizeof header) return Broken::no;
  std::memcpy(&header, answer_.data(), sizeof header);
  if (header.size_bytes > kMaxCommandsBytes) return Broken::malformed;
  const std::size_t size = sizeof header + header.size_bytes;
  if (got_ < size) return Broken::no;
  if (header.type == MessageType::failed && got_ == size) return Broken::refused;
  const auto body = std::span<const std::byte>(answer_).subspan(sizeof header, header.size_bytes);
  if (header.type != MessageType::commands || got_ != size || !turns_->is_answer(body, turn_cycle_))
    return Broken::malformed;
  got_ = 0;
  owed_ = false;
  ++turns_->facts.answered;
  turns_->facts.answer.record(monotonic_now() - given_);
  if (late_ && settings_.safe_when_late) return Broken::no;  // what it was computed from is over
  charge_ = true;
  if (!loop_over_) turns_->command(body, t);
  return Broken::no;
}

/// Lets go of the process.
void ProcessApplication::disconnect(Broken why) noexcept {
  fd_ = -1;
  owed_ = false;
  turns_->release_samples();
  broken_.store(why, std::memory_order_release);
}

void ProcessApplication::step(std::uint64_t cycle, BenchTime t) noexcept {
  if (failed()) return;
  turns_->collect();
  if (virtual_time_)
    step_virtual(cycle, t);
  else
    step_wall(cycle, t);
}

void ProcessApplication::step_virtual(std::uint64_t cycle, BenchTime t) noexcept {
  if (cycle % every_ != 0 || owed_) return;  // owed: the run was stopped while one waited
  for (;;) {
    Broken b = give_turn(cycle, t) ? receive(t, true) : Broken::closed;
    if (b == Broken::no) return;
    disconnect(b);
    // The turn is given anew, to a process that has not seen what came before.
    if (!restart_process()) return;
    fd_ = child_->socket();
    got_ = 0;
    turns_->restart();
  }
}

void ProcessApplication::step_wall(std::uint64_t cycle, BenchTime t) noexcept {
  const bool due = cycle % every_ == 0;
  if (fd_ >= 0 && died_.load(std::memory_order_acquire)) {
    died_.store(false, std::memory_order_relaxed);
    disconnect(Broken::closed);
  }
  if (fd_ < 0) {
    charge_ = false;
    if (broken_.load(std::memory_order_acquire) == Broken::no) fd_ = offered_.exchange(-1);
    if (fd_ < 0) {
      turns_->facts.skipped += due;
      return;
    }
    got_ = 0;
    turns_->restart();
  }
  if (owed_)
    if (const Broken b = receive(t, false); b != Broken::no) {
      turns_->facts.skipped += due;
      return disconnect(b);
    }
  if (owed_ && !late_ &&
      (settings_.deadline.ns() > 0 ? monotonic_now() - given_ > settings_.deadline : due)) {
    late_ = true;
    charge_ = false;
    ++turns_->facts.late;
  }
  if (!due) return;
  if (owed_) {
    ++turns_->facts.skipped;
    return;
  }
  if (give_turn(cycle, t)) return;
  ++turns_->facts.skipped;
  disconnect(Broken::closed);
}

// ------------------------------------------------------------------ who owns the process

std::string ProcessApplication::why_broken() {
  switch (broken_.load(std::memory_order_acquire)) {
    case Broken::refused: {
      MessageHeader header;
      std::memcpy(&header, answer_.data(), sizeof header);
      const char* text = reinterpret_cast<const char*>(answer_.data()) + sizeof header;
      return "says: " + sentence_of(parse_json({text, header.size_bytes}).value_or(nlohmann::json()));
    }
    case Broken::malformed:
      return "gave an answer that the protocol does not know (another cycle, an output that does not exist, "
             "or "
             "fewer or more values than it takes)";
    case Broken::hangs:
      return fmt::format("gave no answer within {:g} s; see `answer_timeout_s`",
                         settings_.answer_timeout.seconds());
    case Broken::closed:
    case Broken::no:
      break;
  }
  if (const auto how = child_->wait_for_death(seconds(1))) return "ended: " + *how;
  return "closed its connection";
}

void ProcessApplication::set_failed(Error error) noexcept {
  error_ = std::move(error);
  failed_.store(true, std::memory_order_release);
}

/// After `lose`. False: the run cannot go on.
bool ProcessApplication::restart_process() noexcept {
  const std::string why = "the application (process " + std::to_string(child_->pid()) + ") " + why_broken();
  child_->kill();
  if (!settings_.restart || stop_.stop_requested()) {
    set_failed({ErrorCode::unavailable, settings_.command.where, why});
    return false;
  }
  auto next = start_child();
  if (!next) {
    set_failed(
        {next.error().code, next.error().where, why + "; to start it again failed: " + next.error().message});
    return false;
  }
  child_ = std::move(*next);
  restarts_.fetch_add(1);
  std::fprintf(stderr, "rigor: warning: %s; it was started again as process %d\n", why.c_str(),
               static_cast<int>(child_->pid()));
  return true;
}

void ProcessApplication::supervise() {
  std::unique_lock lock(mutex_);
  bool told = false;  ///< the loop knows that this process died
  while (!wake_.wait_for(lock, std::chrono::milliseconds(10), [this] { return ending_; })) {
    if (failed_.load()) continue;
    if (broken_.load(std::memory_order_acquire) == Broken::no) {
      if (told || !child_->death()) continue;
      died_.store(told = true, std::memory_order_release);
      continue;
    }
    if (!restart_process()) continue;
    told = false;
    died_.store(false);
    offered_.store(child_->socket());
    broken_.store(Broken::no, std::memory_order_release);
  }
  // A process that this thread started again would die with it.
  wake_.wait(lock, [this] { return over_; });
}

/// From here on the process is the caller's.
void ProcessApplication::hold_supervisor() {
  const std::lock_guard lock(mutex_);
  ending_ = true;
  wake_.notify_all();
}

void ProcessApplication::end_supervisor() {
  {
    const std::lock_guard lock(mutex_);
    ending_ = over_ = true;
  }
  wake_.notify_all();
  if (supervisor_.joinable()) supervisor_.join();
}

Status ProcessApplication::finish() {
  hold_supervisor();
  if (turns_) turns_->end();
  if (error_) return tl::unexpected<Error>(*error_);
  if (!child_ || fd_ < 0) return {};
  // The answer to the last turn, which commands nothing any more.
  loop_over_ = true;
  const MonotonicTime until = monotonic_now() + std::min(settings_.answer_timeout, seconds(2));
  while (owed_ && monotonic_now() < until) {
    if (receive({}, false) != Broken::no) disconnect(Broken::closed);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  if (fd_ >= 0 && !owed_) {
    if (auto s = child_->send(MessageType::finish, nlohmann::json::object()); !s) return s;
    if (auto done = child_->receive(MessageType::done, settings_.start_timeout, {}); !done)
      return tl::unexpected<Error>(done.error());
    if (const auto how = child_->wait_for_death(seconds(2)); how && *how != "exit status 0")
      return fail(ErrorCode::unavailable, settings_.command.where,
                  "the application did its work, and then ended with " + *how);
  }
  child_.reset();
  return {};
}

}  // namespace
}  // namespace application

Result<std::unique_ptr<Application>> make_process_application(const RigConfig& rig) {
  if (auto s = sample_memory::share(); !s) return tl::unexpected<Error>(s.error());
  return std::make_unique<application::ProcessApplication>(rig);
}

}  // namespace rigor
