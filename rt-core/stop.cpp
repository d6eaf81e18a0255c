#include "rt-core/stop.h"

#include <csignal>

namespace rigor {
namespace {

// Signal handlers know globals only.
std::atomic<StopSource*> g_source{nullptr};
struct sigaction g_old_int, g_old_term;

extern "C" void rigor_on_stop_signal(int) {
  if (StopSource* source = g_source.load(std::memory_order_acquire)) source->request(StopReason::signal);
}

}  // namespace

SignalStop::SignalStop(StopSource& source) noexcept {
  g_source.store(&source, std::memory_order_release);
  struct sigaction action {};
  action.sa_handler = rigor_on_stop_signal;
  sigemptyset(&action.sa_mask);
  // A second Ctrl-C falls back to the default action: the way out when the program does not react to the
  // first.
  action.sa_flags = static_cast<int>(SA_RESETHAND);
  sigaction(SIGINT, &action, &g_old_int);
  sigaction(SIGTERM, &action, &g_old_term);
}

SignalStop::~SignalStop() {
  sigaction(SIGINT, &g_old_int, nullptr);
  sigaction(SIGTERM, &g_old_term, nullptr);
  g_source.store(nullptr, std::memory_order_release);
}

}  // namespace rigor
