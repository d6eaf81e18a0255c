#include "rt-core/realtime_setup.h"

#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>
#include <thread>

namespace rigor {
namespace {

using std::string;

string first_line(const char* path) {
  std::ifstream file(path);
  string line;
  std::getline(file, line);
  return line;
}

// CAP_IPC_LOCK lifts RLIMIT_MEMLOCK: bit 14 of the effective set.
bool may_lock_everything() {
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  if (limit.rlim_cur == RLIM_INFINITY) return true;
  std::ifstream status("/proc/self/status");
  for (string line; std::getline(status, line);)
    if (line.rfind("CapEff:", 0) == 0) return (std::stoull(line.substr(7), nullptr, 16) >> 14) & 1;
  return false;
}

// The pages below the present frame, so that deep calls in the loop find them there.
__attribute__((noinline)) void touch_stack(std::size_t bytes) {
  constexpr std::size_t kPage = 4096;
  char page[kPage];
  std::memset(page, 0, sizeof page);
  asm volatile("" : : "r"(page) : "memory");  // the compiler may not know that nobody looks
  if (bytes > kPage) touch_stack(bytes - kPage);
  asm volatile("" : : "r"(page) : "memory");  // and this frame lives while the deeper ones do
}

int last_allowed_cpu(int* count) {
  cpu_set_t set;
  CPU_ZERO(&set);
  int last = -1;
  *count = 0;
  if (sched_getaffinity(0, sizeof set, &set) != 0) return -1;
  for (int i = 0; i < CPU_SETSIZE; ++i)
    if (CPU_ISSET(i, &set)) last = i, ++*count;
  return last;
}

}  // namespace

RealtimeSetup::~RealtimeSetup() { restore_process(); }

void RealtimeSetup::set(RealtimeSetting setting) {
  for (RealtimeSetting& s : settings_)
    if (s.name == setting.name) {
      s = std::move(setting);
      return;
    }
  settings_.push_back(std::move(setting));
}

void RealtimeSetup::prepare_process(const RealtimeConfig& config) {
  if (!config.lock_memory) {
    set({"memory lock", false, false, "not asked for"});
  } else if (!may_lock_everything()) {
    // With a limit, MCL_FUTURE would make later allocations of any thread fail: worse than an unlocked page.
    rlimit limit{};
    getrlimit(RLIMIT_MEMLOCK, &limit);
    set({"memory lock", true, false,
         "memory is not locked: only " + std::to_string(limit.rlim_cur / 1024) +
             " KiB may be locked; raise it with `memlock unlimited` in /etc/security/limits.conf, or grant "
             "CAP_IPC_LOCK"});
  } else if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
    set({"memory lock", true, false,
         string("memory is not locked: mlockall says ") + std::strerror(errno) +
             "; raise `memlock` in /etc/security/limits.conf"});
  } else {
    locked_ = true;
    set({"memory lock", true, true, "all memory is locked, present and future"});
  }

  if (!config.hold_dma_latency) {
    set({"CPU latency", false, false, "not asked for"});
  } else {
    const std::int32_t zero = 0;
    if (dma_latency_fd_ < 0) dma_latency_fd_ = open("/dev/cpu_dma_latency", O_WRONLY | O_CLOEXEC);
    if (dma_latency_fd_ >= 0 && write(dma_latency_fd_, &zero, sizeof zero) == sizeof zero) {
      set({"CPU latency", true, true, "the CPU stays out of deep sleep (/dev/cpu_dma_latency held at 0)"});
    } else {
      const int error = errno;
      if (dma_latency_fd_ >= 0) close(dma_latency_fd_);
      dma_latency_fd_ = -1;
      set({"CPU latency", true, false,
           string("the CPU may sleep deeply, which delays wake-ups: /dev/cpu_dma_latency says ") +
               std::strerror(error) +
               (error == ENOENT ? "; this kernel has no CPU power management to hold"
                                : "; run as root, or give your group write access by a udev rule")});
    }
  }
}

void RealtimeSetup::prepare_thread(const RealtimeConfig& config) {
  if (config.prefault_stack_bytes == 0) {
    set({"stack prefault", false, false, "not asked for"});
  } else {
    pthread_attr_t attr;
    std::size_t stack = 0;
    void* low = nullptr;
    if (pthread_getattr_np(pthread_self(), &attr) == 0) {
      pthread_attr_getstack(&attr, &low, &stack);
      pthread_attr_destroy(&attr);
    }
    // Never touch below what is there: leave a margin of 64 KiB.
    const char here = 0;
    const auto room =
        static_cast<std::size_t>(std::max<std::ptrdiff_t>(0, &here - static_cast<const char*>(low)));
    const std::size_t bytes = std::min(config.prefault_stack_bytes, room > 65536 ? room - 65536 : 0);
    touch_stack(bytes);
    set({"stack prefault", true, bytes == config.prefault_stack_bytes,
         std::to_string(bytes / 1024) + " KiB of stack are in memory" +
             (bytes < config.prefault_stack_bytes
                  ? ", fewer than asked for: the thread's stack is small; raise `ulimit -s`"
                  : "")});
  }

  old_policy_ = sched_getscheduler(0);
  sched_param old{};
  sched_getparam(0, &old);
  old_priority_ = old.sched_priority;
  cpu_set_t set_of_cpus;
  CPU_ZERO(&set_of_cpus);
  old_affinity_.clear();
  if (sched_getaffinity(0, sizeof set_of_cpus, &set_of_cpus) == 0) {
    const auto* bytes = reinterpret_cast<const unsigned char*>(&set_of_cpus);
    old_affinity_.assign(bytes, bytes + sizeof set_of_cpus);
  }
  thread_changed_ = true;

  int count = 0;
  const int last = last_allowed_cpu(&count);
  const int cpu =
      config.cpu == RealtimeConfig::kAutoCpu ? (count > 1 ? last : RealtimeConfig::kAnyCpu) : config.cpu;
  if (cpu == RealtimeConfig::kAnyCpu) {
    set({"CPU affinity", config.cpu == RealtimeConfig::kAutoCpu, false,
         config.cpu == RealtimeConfig::kAutoCpu ? "the loop is not pinned: there is one CPU only"
                                                : "not asked for"});
  } else {
    cpu_set_t one;
    CPU_ZERO(&one);
    if (cpu >= 0 && cpu < CPU_SETSIZE) CPU_SET(cpu, &one);
    if (cpu >= 0 && sched_setaffinity(0, sizeof one, &one) == 0)
      set({"CPU affinity", true, true, "the loop is pinned to CPU " + std::to_string(cpu)});
    else
      set({"CPU affinity", true, false,
           "the loop is not pinned: CPU " + std::to_string(cpu) + " cannot be had (" + std::strerror(errno) +
               "); name one of the CPUs that `nproc --all` and the process's cpuset allow"});
  }

  if (config.fifo_priority <= 0) {
    set({"SCHED_FIFO", false, false, "not asked for"});
  } else {
    sched_param fifo{};
    fifo.sched_priority = std::min(config.fifo_priority, sched_get_priority_max(SCHED_FIFO));
    if (sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &fifo) == 0)
      set({"SCHED_FIFO", true, true,
           "the loop runs under SCHED_FIFO with priority " + std::to_string(fifo.sched_priority)});
    else
      set({"SCHED_FIFO", true, false,
           string("the loop shares the CPU with every other program: SCHED_FIFO says ") +
               std::strerror(errno) +
               "; add `rtprio 99` for your user to /etc/security/limits.conf and log in again, or grant "
               "CAP_SYS_NICE"});
  }
}

void RealtimeSetup::restore_thread() noexcept {
  if (!thread_changed_) return;
  thread_changed_ = false;
  sched_param old{};
  old.sched_priority = old_priority_;
  // Without CAP_SYS_NICE the reset-on-fork flag cannot be taken back; everything else can.
  if (sched_setscheduler(0, old_policy_, &old) != 0)
    sched_setscheduler(0, old_policy_ | SCHED_RESET_ON_FORK, &old);
  if (old_affinity_.size() == sizeof(cpu_set_t)) {
    cpu_set_t set_of_cpus;
    std::memcpy(&set_of_cpus, old_affinity_.data(), sizeof set_of_cpus);
    sched_setaffinity(0, sizeof set_of_cpus, &set_of_cpus);
  }
}

void RealtimeSetup::restore_process() noexcept {
  if (locked_) munlockall();
  locked_ = false;
  if (dma_latency_fd_ >= 0) close(dma_latency_fd_);
  dma_latency_fd_ = -1;
}

std::vector<RealtimeSetting> probe_realtime(const RealtimeConfig& config) {
  std::vector<RealtimeSetting> result;
  std::thread([&] {
    RealtimeSetup setup;
    setup.prepare_process(config);
    setup.prepare_thread(config);
    setup.restore_thread();
    setup.restore_process();
    result = setup.settings();
  }).join();

  const string version = [] {
    utsname u{};
    uname(&u);
    return string(u.release) + " " + u.version;
  }();
  const bool rt = version.find("PREEMPT_RT") != string::npos;
  result.push_back(
      {"real-time kernel", false, rt,
       rt ? "the kernel is PREEMPT_RT"
          : "the kernel is not PREEMPT_RT (" + version +
                "): expect rare wake-ups later than 100 us; `apt install linux-image-rt-amd64`"});

  const string clock = first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource");
  const bool fast_clock = clock == "tsc" || clock == "kvm-clock" || clock == "arch_sys_counter";
  result.push_back(
      {"clock source", false, fast_clock,
       fast_clock ? "`" + clock + "`, read without a system call"
                  : "`" + clock + "` is slow to read; boot with `clocksource=tsc` if the CPU's is stable"});

  const string throttle = first_line("/proc/sys/kernel/sched_rt_runtime_us");
  const bool unthrottled = throttle == "-1";
  result.push_back({"RT throttling", false, unthrottled,
                    unthrottled
                        ? "off"
                        : "the kernel takes the CPU from FIFO threads that use more than " + throttle +
                              " us of each second: a loop that spins all the time needs `sysctl "
                              "kernel.sched_rt_runtime_us=-1`"});

  const string isolated = first_line("/sys/devices/system/cpu/isolated");
  result.push_back({"isolated CPUs", false, !isolated.empty(),
                    !isolated.empty()
                        ? "CPUs " + isolated + " are kept free of other programs"
                        : "no CPU is kept free for the loop; boot with `isolcpus=N nohz_full=N` and "
                          "pin the loop to it"});

  std::ifstream cpuinfo("/proc/cpuinfo");
  std::stringstream all;
  all << cpuinfo.rdbuf();
  const bool guest = all.str().find(" hypervisor") != string::npos;
  result.push_back({"bare metal", false, !guest,
                    guest
                        ? "this is a virtual machine: its host may stall it for milliseconds, which the miss "
                          "report shows as host steal"
                        : "no hypervisor"});

  const string governor = first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
  if (!governor.empty())
    result.push_back({"CPU frequency", false, governor == "performance",
                      governor == "performance"
                          ? "governor `performance`"
                          : "governor `" + governor +
                                "` changes the clock under load; `cpupower frequency-set -g "
                                "performance`"});
  return result;
}

}  // namespace rigor
