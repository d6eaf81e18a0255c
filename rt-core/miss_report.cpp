#include "rt-core/miss_report.h"

#include <fcntl.h>
#include <pthread.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace rigor {
namespace {

constexpr Duration kSampleEvery = milliseconds(10);
// What one minor page fault costs at the most that is usual (clearing a huge page costs more, but then there
// are few).
constexpr Duration kFaultCost = microseconds(10);

double share(Duration part, Duration whole) {
  return whole.ns() > 0 ? static_cast<double>(part.ns()) / static_cast<double>(whole.ns()) : 0;
}

/// Reads a small /proc file from its start; the number of bytes, 0 on failure.
std::size_t read_again(int fd, char* buffer, std::size_t size) noexcept {
  const ssize_t n = fd >= 0 ? pread(fd, buffer, size - 1, 0) : -1;
  buffer[n > 0 ? n : 0] = 0;
  return n > 0 ? static_cast<std::size_t>(n) : 0;
}

}  // namespace

MissCause attribute(const Miss& m, Duration period) noexcept {
  const bool steps_too_long = m.overran && (m.ran > period || m.ran > m.late);
  if (steps_too_long) {
    const Duration off_cpu = m.ran - m.cpu;
    if (m.major_faults > 0 || share(kFaultCost * m.minor_faults, m.ran) > 0.2) return MissCause::page_fault;
    if (share(off_cpu, m.ran) < 0.5) return MissCause::execution;
    // The steps did not have the CPU for most of the time.
    if (m.preempted > 0 && share(m.run_queue, off_cpu) > 0.3 && m.stolen <= m.run_queue)
      return MissCause::preemption;
    if (m.stolen.ns() > 0) return MissCause::host_steal;
    if (m.voluntary_switches > 1) return MissCause::execution;  // a step slept: its own doing
    return m.preempted > 0 ? MissCause::preemption : MissCause::unknown;
  }
  if (m.late.ns() <= 0) return MissCause::unknown;
  if (m.major_faults > 0) return MissCause::page_fault;
  if (share(m.stolen, m.late) > 0.3 && m.run_queue < m.stolen) return MissCause::host_steal;
  if (share(m.run_queue, m.late) > 0.5) return MissCause::preemption;
  return MissCause::late_wakeup;
}

std::string describe(const Miss& m, Duration period, const std::string& step_name) {
  const auto ms = [](Duration d) { return static_cast<double>(d.ns()) * 1e-6; };
  char text[512];
  int n = std::snprintf(
      text, sizeof text, "cycle %llu: %s: woken %.3f ms late, ran %.3f ms (%.3f ms on the CPU)",
      static_cast<unsigned long long>(m.cycle), to_string(m.cause), ms(m.late), ms(m.ran), ms(m.cpu));
  const auto add = [&](auto... arguments) {
    if (n > 0 && n < static_cast<int>(sizeof text))
      n += std::snprintf(text + n, sizeof text - static_cast<std::size_t>(n), arguments...);
  };
  if (m.ran > period || m.cause == MissCause::execution)
    add(", longest step `%s` %.3f ms", step_name.c_str(), ms(m.longest_step_ran));
  if (m.minor_faults || m.major_faults)
    add(", page faults %u minor %u major", m.minor_faults, m.major_faults);
  if (m.preempted) add(", preempted %u times", m.preempted);
  if (m.voluntary_switches > 1) add(", gave up the CPU %u times", m.voluntary_switches - 1);
  if (m.run_queue.ns() > 0) add(", waited for the CPU %.3f ms", ms(m.run_queue));
  if (m.stolen.ns() > 0) add(", host took about %.0f ms", ms(m.stolen));
  if (m.skipped) add("; %llu cycles skipped", static_cast<unsigned long long>(m.skipped));
  return text;
}

// "cpuN user nice system idle iowait irq softirq steal ...", in ticks, a line for each CPU.
std::optional<long long> stolen_ticks(const char* proc_stat, int cpu) noexcept {
  char name[16];
  std::snprintf(name, sizeof name, "\ncpu%d ", cpu);
  const char* line = std::strstr(proc_stat, name);
  long long v[8] = {};
  if (line == nullptr || std::sscanf(line + std::strlen(name), "%lld %lld %lld %lld %lld %lld %lld %lld",
                                     &v[0], &v[1], &v[2], &v[3], &v[4], &v[5], &v[6], &v[7]) != 8)
    return std::nullopt;
  return v[7];
}

MissObserver::MissObserver(Duration period, std::size_t capacity)
    : period_(period), capacity_(capacity), ring_(std::max<std::size_t>(capacity, 1)) {
  report_.misses.reserve(capacity);
  waiting_.reserve(capacity);
}

MissObserver::~MissObserver() {
  if (thread_.joinable()) (void)finish();
}

void MissObserver::start(int tid) {
  char path[64];
  std::snprintf(path, sizeof path, "/proc/self/task/%d/schedstat", tid);
  schedstat_fd_ = open(path, O_RDONLY | O_CLOEXEC);
  std::snprintf(path, sizeof path, "/proc/self/task/%d/stat", tid);
  schedule_fd_ = open(path, O_RDONLY | O_CLOEXEC);
  stat_fd_ = open("/proc/stat", O_RDONLY | O_CLOEXEC);
  text_.resize(
      std::max<std::size_t>(4096, room_for_proc_stat(static_cast<int>(sysconf(_SC_NPROCESSORS_CONF)))));
  samples_.clear();
  samples_.push_newest(sample());
  thread_ = std::thread([this] { watch(); });
  pthread_setname_np(thread_.native_handle(), "rigor-misses");
}

void MissObserver::report(const Miss& miss) noexcept {
  total_.store(total_.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
  if (!ring_.try_push(miss))
    ring_full_.store(ring_full_.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
}

MissObserver::Sample MissObserver::sample() noexcept {
  Sample s;
  char* const text = text_.data();
  const std::size_t size = text_.size();
  // schedstat: time on the CPU, time on the run queue (ns), slices.
  if (read_again(schedstat_fd_, text, size) > 0) {
    char* rest = nullptr;
    (void)std::strtoll(text, &rest, 10);
    s.run_queue_ns = std::strtoll(rest, nullptr, 10);
  }
  // stat, field 39: the CPU it ran on last; names may hold blanks and brackets, so count from the last ')'.
  int cpu = -1;
  if (read_again(schedule_fd_, text, size) > 0) {
    const char* at = std::strrchr(text, ')');
    for (int field = 2; at && field < 39; ++field) at = std::strchr(at + 1, ' ');
    if (at) cpu = std::atoi(at);
  }
  if (cpu >= 0 && read_again(stat_fd_, text, size) > 0)
    if (const auto ticks = stolen_ticks(text, cpu))
      s.stolen_ns = *ticks * (1'000'000'000 / sysconf(_SC_CLK_TCK));
  s.t_ns = monotonic_now().ns();
  return s;
}

// Completes the misses that lie between two samples.
void MissObserver::attribute_waiting(bool final_pass) {
  std::size_t kept = 0;
  for (Miss& m : waiting_) {
    if (!final_pass && samples_.back().t_ns < m.t_end.ns()) {
      waiting_[kept++] = m;
      continue;
    }
    const Sample* before = &samples_.front();
    const Sample* after = &samples_.back();
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      const Sample& s = samples_[i];
      if (s.t_ns <= m.t_cycle.ns()) before = &s;
      if (s.t_ns >= m.t_end.ns()) {
        after = &s;
        break;
      }
    }
    m.run_queue = Duration(std::max<std::int64_t>(0, after->run_queue_ns - before->run_queue_ns));
    m.stolen = Duration(std::max<std::int64_t>(0, after->stolen_ns - before->stolen_ns));
    m.cause = rigor::attribute(m, period_);
    ++report_.by_cause[static_cast<std::size_t>(m.cause)];
    if (report_.misses.size() < capacity_) report_.misses.push_back(m);
  }
  waiting_.resize(kept);
}

void MissObserver::watch() {
  while (!end_.load(std::memory_order_acquire)) {
    timespec pause{0, static_cast<long>(kSampleEvery.ns())};
    nanosleep(&pause, nullptr);
    // First the misses, then the sample: so it is younger than all of them.
    for (Miss m; ring_.try_pop(m);) waiting_.push_back(m);
    samples_.push_newest(sample());
    attribute_waiting(false);
  }
  for (Miss m; ring_.try_pop(m);) waiting_.push_back(m);
  samples_.push_newest(sample());
  attribute_waiting(true);
}

MissReport MissObserver::finish() {
  end_.store(true, std::memory_order_release);
  if (thread_.joinable()) thread_.join();
  for (int* fd : {&schedstat_fd_, &schedule_fd_, &stat_fd_}) {
    if (*fd >= 0) close(*fd);
    *fd = -1;
  }
  report_.total = total_.load(std::memory_order_relaxed);
  report_.dropped = report_.total - report_.misses.size();
  return std::move(report_);
}

}  // namespace rigor
