// Datagrams with the instant at which the kernel had them, many in one system call.
#pragma once

#include <netinet/in.h>
#include <sys/socket.h>

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "drivers/network/udp_frame.h"
#include "rt-core/epoch.h"
#include "rt-core/file_descriptor.h"
#include "rt-core/result.h"

namespace rigor::network {

/// One thread.
class UdpReceiver {
 public:
  struct Datagram {
    std::span<const std::uint8_t> bytes;
    BenchTime arrival;
    std::uint32_t source_ipv4;  ///< host order
  };
  static constexpr std::size_t kBatch = 32;

  UdpReceiver() = default;
  UdpReceiver(const UdpReceiver&) = delete;
  UdpReceiver& operator=(const UdpReceiver&) = delete;

  /// unavailable: the port is taken, or the address is not this machine's. Port 0: any. Setup.
  /// `max_bytes`: of one datagram; a longer one is handed on one byte longer than that.
  [[nodiscard]] Status open(const std::string& address, std::uint16_t port, std::int64_t buffer_bytes,
                            std::size_t max_bytes = kMtu);
  void close() { fd_.reset(); }
  [[nodiscard]] int fd() const { return fd_.get(); }
  [[nodiscard]] std::uint16_t port() const { return port_; }
  /// Bytes that the kernel grants; less than asked for where net.core.rmem_max is lower.
  [[nodiscard]] std::int64_t buffer_bytes() const { return buffer_bytes_; }
  /// What is there, up to kBatch, without waiting; valid until the next call. Empty: nothing, or an error
  /// (errno).
  [[nodiscard]] std::span<const Datagram> receive(const EpochPair& epoch) noexcept;
  /// Datagrams that the kernel dropped because the buffer was full.
  [[nodiscard]] std::uint64_t dropped() const { return dropped_; }

 private:
  FileDescriptor fd_;
  std::uint16_t port_ = 0;
  std::int64_t buffer_bytes_ = 0;
  std::uint32_t dropped_last_ = 0;
  std::uint64_t dropped_ = 0;
  std::size_t max_bytes_ = 0;
  std::vector<std::uint8_t> data_;  ///< kBatch times max_bytes_
  std::array<std::array<std::uint8_t, 128>, kBatch> control_{};
  std::array<sockaddr_in, kBatch> from_{};
  std::array<iovec, kBatch> vector_{};
  std::array<mmsghdr, kBatch> header_{};
  std::array<Datagram, kBatch> got_{};
};

}  // namespace rigor::network
