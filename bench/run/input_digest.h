// A digest of what the application saw: which sample was visible on which port in which cycle, to the last
// byte that a recording has of it.
//
// A wall-clock run and its replay print the same SHA-256, or the replay is not one. The loop only hands
// entries over; a thread of its own does the hashing. Samples without bytes are copied into their entries; of
// those with bytes a lease is held, of each port at most kLeases at a time where the loop does not wait.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "rt-core/port.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/record/sample_codec.h"
#include "sensor-hal/types/sample.h"

struct evp_md_ctx_st;  // OpenSSL's

namespace rigor {

class InputDigest {
 public:
  static constexpr std::uint32_t kLeases = 3;
  /// `kinds`: of the ports, in their order. Setup context.
  InputDigest(const std::vector<SampleKind>& kinds, bool may_wait);
  ~InputDigest();

  /// Loop thread, wait-free (in virtual time it waits for room instead of losing an entry).
  void saw(std::uint64_t cycle, BenchTime t_cycle, std::uint32_t port, PortStatus status,
           const SampleLease& sample) noexcept;
  /// After the loop has ended: hex of the SHA-256, or empty when entries had to be dropped.
  [[nodiscard]] std::string finish();

 private:
  struct Entry {
    std::uint64_t cycle = 0;
    BenchTime t_cycle;
    std::uint32_t port = 0;
    PortStatus status = PortStatus::never;
    bool has_sample = false;
    Stamp stamp;
    decltype(Sample::info) info;  ///< of a fresh sample without bytes
    SampleLease lease;            ///< of a fresh sample with bytes
  };
  void work();
  void hash(Entry& entry);

  bool may_wait_;
  std::vector<record::SampleEncoder> encoders_;
  std::unique_ptr<std::atomic<std::uint32_t>[]> leases_;  ///< held, by port
  SpscRing<Entry> ring_{2048};
  Sample without_bytes_;
  std::uint64_t dropped_ = 0;
  bool encoded_ = true;
  std::atomic<bool> stop_{false};
  struct FreeContext {
    void operator()(evp_md_ctx_st* context) const noexcept;
  };
  std::unique_ptr<evp_md_ctx_st, FreeContext> context_;
  std::thread thread_;
};

}  // namespace rigor
