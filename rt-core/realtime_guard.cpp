#include "rt-core/realtime_guard.h"

#include <dlfcn.h>
#include <execinfo.h>
#include <linux/futex.h>
#include <malloc.h>
#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>

#include "rt-core/realtime_scope.h"

#if !defined(__x86_64__) || !defined(__GLIBC__)
#error "the guard knows x86-64 and glibc; build without rigor_rt_guard elsewhere"
#endif

#ifndef PR_SET_SYSCALL_USER_DISPATCH
#define PR_SET_SYSCALL_USER_DISPATCH 59
#define PR_SYS_DISPATCH_OFF 0
#define PR_SYS_DISPATCH_ON 1
#define SYSCALL_DISPATCH_FILTER_ALLOW 0
#define SYSCALL_DISPATCH_FILTER_BLOCK 1
#endif
#ifndef SYS_USER_DISPATCH
#define SYS_USER_DISPATCH 2
#endif

// The one piece of code whose system calls always pass: the handler's own, and the return from it. The kernel
// compares the address after the instruction, so the range ends with one that is never reached.
__asm__(R"(
.pushsection .text
.globl rigor_guard_pass_begin, rigor_guard_syscall, rigor_guard_restorer, rigor_guard_pass_end
.p2align 4
rigor_guard_pass_begin:
.type rigor_guard_syscall, @function
rigor_guard_syscall:
  mov %rdi, %rax
  mov %rsi, %rdi
  mov %rdx, %rsi
  mov %rcx, %rdx
  mov %r8, %r10
  mov %r9, %r8
  mov 8(%rsp), %r9
  syscall
  ret
.size rigor_guard_syscall, .-rigor_guard_syscall
.type rigor_guard_restorer, @function
rigor_guard_restorer:
  mov $15, %eax
  syscall
  ud2
.size rigor_guard_restorer, .-rigor_guard_restorer
rigor_guard_pass_end:
.popsection
)");

extern "C" {
extern char rigor_guard_pass_begin[], rigor_guard_pass_end[];
long rigor_guard_syscall(long number, long a, long b, long c, long d, long e, long f);
void rigor_guard_restorer();
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void __libc_free(void*);
void* __libc_memalign(size_t, size_t);
}

namespace rigor::guard {
namespace {

constexpr std::size_t kFindings = 64;
std::array<Finding, kFindings> g_findings;
std::atomic<std::size_t> g_finding_count{0};
std::atomic<std::uint64_t> g_counts[4];

// initial-exec: no lazy allocation of thread-local memory from within malloc.
#define RIGOR_GUARD_TLS thread_local __attribute__((tls_model("initial-exec")))
RIGOR_GUARD_TLS bool t_inside = false;     // in a RealtimeScope
RIGOR_GUARD_TLS bool t_recording = false;  // the guard's own doings do not count
RIGOR_GUARD_TLS volatile char t_selector = SYSCALL_DISPATCH_FILTER_ALLOW;  // read by the kernel
RIGOR_GUARD_TLS bool t_dispatching = false;
RIGOR_GUARD_TLS long t_minor = 0, t_major = 0;
bool g_dispatch_works = false;

// noinline: the frames to leave out are known.
__attribute__((noinline)) void found(Violation kind, const char* what, long number) noexcept {
  t_recording = true;
  const char selector = t_selector;
  t_selector = SYSCALL_DISPATCH_FILTER_ALLOW;
  g_counts[static_cast<int>(kind)].fetch_add(
      kind == Violation::page_fault ? static_cast<std::uint64_t>(number) : 1);
  const std::size_t i = g_finding_count.fetch_add(1);
  if (i < kFindings) {
    Finding& f = g_findings[i];
    f.kind = kind;
    f.what = what;
    f.number = number;
    f.depth = backtrace(f.stack.data(), static_cast<int>(f.stack.size()));
  }
  t_selector = selector;
  t_recording = false;
}

bool watched() noexcept { return t_inside && !t_recording; }

void faults(long& minor, long& major) noexcept {
  rusage r{};
  rigor_guard_syscall(SYS_getrusage, RUSAGE_THREAD, reinterpret_cast<long>(&r), 0, 0, 0, 0);
  minor = r.ru_minflt;
  major = r.ru_majflt;
}

void enter() noexcept {
  if (g_dispatch_works && !t_dispatching) {
    const auto from = reinterpret_cast<unsigned long>(rigor_guard_pass_begin);
    const auto length = static_cast<unsigned long>(rigor_guard_pass_end - rigor_guard_pass_begin);
    t_dispatching = prctl(PR_SET_SYSCALL_USER_DISPATCH, PR_SYS_DISPATCH_ON, from, length, &t_selector) == 0;
  }
  faults(t_minor, t_major);
  t_inside = true;
  if (t_dispatching) t_selector = SYSCALL_DISPATCH_FILTER_BLOCK;
}

void leave() noexcept {
  t_selector = SYSCALL_DISPATCH_FILTER_ALLOW;
  long minor = 0, major = 0;
  faults(minor, major);
  t_inside = false;
  const long n = (minor - t_minor) + (major - t_major);
  if (n > 0) found(Violation::page_fault, major > t_major ? "major page fault" : "minor page fault", n);
}

constexpr RealtimeHooks kHooks{enter, leave};

bool harmless(long number) noexcept {
  switch (number) {
    case SYS_getrusage:
    case SYS_clock_gettime:
    case SYS_gettimeofday:
    case SYS_time:
    case SYS_getcpu:
    case SYS_gettid:
    case SYS_getpid:
    case SYS_rt_sigreturn:
    case SYS_rt_sigprocmask:
      return true;
    default:
      return false;
  }
}

// A system call within a scope: note it, then make it all the same.
void on_dispatch(int, siginfo_t* info, void* context) noexcept {
  const int saved_errno = errno;
  t_selector = SYSCALL_DISPATCH_FILTER_ALLOW;
  greg_t* r = static_cast<ucontext_t*>(context)->uc_mcontext.gregs;
  const long number = info->si_syscall;
  // Waking another thread does not wait for it.
  const bool wakes = number == SYS_futex && (static_cast<int>(r[REG_RSI]) & FUTEX_CMD_MASK) == FUTEX_WAKE;
  if (!harmless(number) && !wakes && !t_recording) found(Violation::system_call, "system call", number);
  r[REG_RAX] =
      rigor_guard_syscall(number, r[REG_RDI], r[REG_RSI], r[REG_RDX], r[REG_R10], r[REG_R8], r[REG_R9]);
  errno = saved_errno;
  if (t_inside) t_selector = SYSCALL_DISPATCH_FILTER_BLOCK;
}

struct KernelSigaction {  // as the system call has it: libc's would put its own restorer in
  void (*handler)(int, siginfo_t*, void*) noexcept;
  unsigned long flags;
  void (*restorer)();
  unsigned long mask;
};

const char* name_of(long number) {
  switch (number) {
    case SYS_read:
      return "read";
    case SYS_write:
      return "write";
    case SYS_openat:
      return "openat";
    case SYS_close:
      return "close";
    case SYS_poll:
      return "poll";
    case SYS_mmap:
      return "mmap";
    case SYS_munmap:
      return "munmap";
    case SYS_brk:
      return "brk";
    case SYS_ioctl:
      return "ioctl";
    case SYS_nanosleep:
      return "nanosleep";
    case SYS_clock_nanosleep:
      return "clock_nanosleep";
    case SYS_futex:
      return "futex";
    case SYS_sendto:
      return "sendto";
    case SYS_recvfrom:
      return "recvfrom";
    case SYS_fsync:
      return "fsync";
    case SYS_sched_yield:
      return "sched_yield";
    case SYS_newfstatat:
      return "newfstatat";
    case SYS_madvise:
      return "madvise";
    case SYS_clone3:
      return "clone3";
    default:
      return nullptr;
  }
}

template <class F>
F* real(const char* name, const char* version = nullptr) noexcept {
  void* f = version ? dlvsym(RTLD_NEXT, name, version) : dlsym(RTLD_NEXT, name);
  if (!f) std::abort();  // without the real one the program cannot go on
  return reinterpret_cast<F*>(f);
}

}  // namespace

Status install() {
  void* warm[4];
  (void)backtrace(warm, 4);  // loads libgcc now, which allocates
  KernelSigaction action{};
  action.handler = on_dispatch;
  constexpr unsigned long kRestorer = 0x04000000;  // SA_RESTORER
  action.flags = SA_SIGINFO | SA_NODEFER | kRestorer;
  action.restorer = rigor_guard_restorer;
  bool works = syscall(SYS_rt_sigaction, SIGSYS, &action, nullptr, 8) == 0;
  // A trial: are calls really handed over?
  if (works) {
    const auto from = reinterpret_cast<unsigned long>(rigor_guard_pass_begin);
    const auto length = static_cast<unsigned long>(rigor_guard_pass_end - rigor_guard_pass_begin);
    works = t_dispatching ||
            prctl(PR_SET_SYSCALL_USER_DISPATCH, PR_SYS_DISPATCH_ON, from, length, &t_selector) == 0;
    t_dispatching = works;
  }
  g_dispatch_works = works;
  clear();
  realtime_hooks.store(&kHooks, std::memory_order_release);
  if (!works)
    return fail(ErrorCode::unavailable, "syscall user dispatch",
                "this kernel does not hand system calls back to their process (Linux 5.11 does): "
                "allocations, locks and "
                "page faults are guarded, system calls are not");
  return {};
}

void uninstall() noexcept { realtime_hooks.store(nullptr, std::memory_order_release); }

void clear() noexcept {
  g_finding_count.store(0);
  for (auto& c : g_counts) c.store(0);
}

Report report() {
  Report r;
  r.allocations = g_counts[0].load();
  r.locks = g_counts[1].load();
  r.page_faults = g_counts[2].load();
  r.system_calls = g_counts[3].load();
  r.findings.assign(g_findings.begin(), g_findings.begin() + std::min(kFindings, g_finding_count.load()));
  return r;
}

std::string Report::text() const {
  std::string s = std::to_string(allocations) + " allocations, " + std::to_string(locks) + " locks, " +
                  std::to_string(page_faults) + " page faults, " + std::to_string(system_calls) +
                  " system calls within the real-time loop\n";
  for (const Finding& f : findings) {
    s += f.what;
    if (f.kind == Violation::system_call) {
      const char* name = name_of(f.number);
      s.append(" ").append(std::to_string(f.number));
      if (name) s.append(" (").append(name).append(")");
    } else if (f.kind == Violation::page_fault) {
      s += " x " + std::to_string(f.number);
    }
    s += "\n";
    char** symbols = backtrace_symbols(f.stack.data(), f.depth);
    for (int i = 1; symbols && i < f.depth; ++i) s.append("    ").append(symbols[i]).append("\n");
    std::free(symbols);
  }
  return s;
}

namespace {
void note_allocation(const char* what) noexcept {
  if (watched()) found(Violation::allocation, what, 0);
}
void note_lock(const char* what) noexcept {
  if (watched()) found(Violation::lock, what, 0);
}
}  // namespace

}  // namespace rigor::guard

// What stands in front of libc. new and delete come here through malloc and free.
extern "C" {

void* malloc(size_t n) noexcept {
  rigor::guard::note_allocation("malloc");
  return __libc_malloc(n);
}
void* calloc(size_t n, size_t m) noexcept {
  rigor::guard::note_allocation("calloc");
  return __libc_calloc(n, m);
}
void* realloc(void* p, size_t n) noexcept {
  rigor::guard::note_allocation("realloc");
  return __libc_realloc(p, n);
}
void free(void* p) noexcept {
  if (p) rigor::guard::note_allocation("free");
  __libc_free(p);
}
void* memalign(size_t a, size_t n) noexcept {
  rigor::guard::note_allocation("memalign");
  return __libc_memalign(a, n);
}
void* aligned_alloc(size_t a, size_t n) noexcept {
  rigor::guard::note_allocation("aligned_alloc");
  return __libc_memalign(a, n);
}
int posix_memalign(void** out, size_t a, size_t n) noexcept {
  rigor::guard::note_allocation("posix_memalign");
  if (a < sizeof(void*) || (a & (a - 1)) != 0) return EINVAL;
  void* p = __libc_memalign(a, n);
  if (!p) return ENOMEM;
  *out = p;
  return 0;
}

#define RIGOR_GUARD_LOCK(NAME, VERSION, PARAMETERS, ARGUMENTS)                               \
  int NAME PARAMETERS {                                                                      \
    static int(*const real) PARAMETERS = rigor::guard::real<int PARAMETERS>(#NAME, VERSION); \
    rigor::guard::note_lock(#NAME);                                                          \
    return real ARGUMENTS;                                                                   \
  }

RIGOR_GUARD_LOCK(pthread_rwlock_rdlock, nullptr, (pthread_rwlock_t * l), (l))
RIGOR_GUARD_LOCK(pthread_rwlock_wrlock, nullptr, (pthread_rwlock_t * l), (l))
RIGOR_GUARD_LOCK(pthread_spin_lock, nullptr, (pthread_spinlock_t * l), (l))
RIGOR_GUARD_LOCK(pthread_mutex_timedlock, nullptr, (pthread_mutex_t * m, const timespec* t), (m, t))
RIGOR_GUARD_LOCK(pthread_cond_wait, "GLIBC_2.3.2", (pthread_cond_t * c, pthread_mutex_t* m), (c, m))
RIGOR_GUARD_LOCK(pthread_cond_timedwait, "GLIBC_2.3.2",
                 (pthread_cond_t * c, pthread_mutex_t* m, const timespec* t), (c, m, t))
RIGOR_GUARD_LOCK(pthread_cond_clockwait, nullptr,
                 (pthread_cond_t * c, pthread_mutex_t* m, clockid_t k, const timespec* t), (c, m, k, t))
RIGOR_GUARD_LOCK(sem_wait, nullptr, (sem_t * s), (s))
RIGOR_GUARD_LOCK(sem_timedwait, nullptr, (sem_t * s, const timespec* t), (s, t))

// Called from the initialisation of static variables itself, so its own pointer is found without one.
int pthread_mutex_lock(pthread_mutex_t* m) noexcept {
  using F = int(pthread_mutex_t*);
  static std::atomic<F*> real{nullptr};
  F* f = real.load(std::memory_order_acquire);
  if (!f) {
    f = rigor::guard::real<F>("pthread_mutex_lock");
    real.store(f, std::memory_order_release);
  }
  rigor::guard::note_lock("pthread_mutex_lock");
  return f(m);
}

}  // extern "C"
