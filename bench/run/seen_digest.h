// A digest of what the application saw: which sample was visible on which port in which cycle, to the last
// byte.
//
// A wall-clock run and its replay print the same SHA-256, or the replay is not one. The loop only hands
// leases over; a thread of its own does the hashing.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>

#include "rt-core/port.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/types/sample.h"

struct evp_md_ctx_st;  // OpenSSL's

namespace rigor {

class SeenDigest {
 public:
  explicit SeenDigest(bool may_wait);
  ~SeenDigest();

  /// Loop thread, wait-free (in virtual time it waits for room instead of losing an entry).
  void saw(std::uint64_t cycle, BenchTime t_cycle, std::uint32_t port, PortStatus status,
           const SampleLease& sample) noexcept;
  /// After the loop has ended: hex of the SHA-256, or empty when entries had to be dropped.
  [[nodiscard]] std::string finish();
  [[nodiscard]] std::uint64_t dropped() const noexcept { return dropped_; }

 private:
  struct Entry {
    std::uint64_t cycle = 0;
    BenchTime t_cycle;
    std::uint32_t port = 0;
    PortStatus status = PortStatus::never;
    SampleLease sample;
  };
  void work();
  void hash(const Entry& entry);

  bool may_wait_;
  SpscRing<Entry> ring_{4096};
  std::uint64_t dropped_ = 0;
  std::atomic<bool> stop_{false};
  struct FreeContext {
    void operator()(evp_md_ctx_st* context) const noexcept;
  };
  std::unique_ptr<evp_md_ctx_st, FreeContext> context_;
  std::thread thread_;
};

}  // namespace rigor
