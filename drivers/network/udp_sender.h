// Datagrams of an emulated device to one address, which may be a broadcast address; and a recording of them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>

#include "drivers/network/pcap_file.h"
#include "rt-core/file_descriptor.h"
#include "rt-core/result.h"

namespace rigor::network {

/// One thread.
class UdpSender {
 public:
  enum class Outcome : std::uint8_t {
    sent,
    nobody,  ///< nobody has the port open there, by what came back of an earlier one (ICMP)
    failed
  };
  /// bad_input: no IPv4 address. unavailable: no way there, or the port that it is to send from is taken.
  /// Also to change the address. Setup. `from_address`, `from_port`: where it sends from; empty, 0: any.
  [[nodiscard]] Status open(const std::string& address, std::uint16_t port,
                            const std::string& from_address = {}, std::uint16_t from_port = 0);
  /// not_writable. What is sent from now on is written as well. Setup.
  [[nodiscard]] Status record(const std::filesystem::path& file);
  /// Writes what was recorded. io, disk_full. Setup.
  [[nodiscard]] Status finish_recording();
  void close() { socket_.reset(); }
  [[nodiscard]] bool is_open() const { return socket_.is_open(); }

  /// `t`: for the recording.
  Outcome send(std::span<const std::uint8_t> bytes, std::uint16_t port, RealtimeTime t);

 private:
  FileDescriptor socket_;
  std::uint32_t local_ipv4_ = 0, destination_ipv4_ = 0;
  std::uint16_t from_port_ = 0;
  std::optional<PcapWriter> pcap_;
};

}  // namespace rigor::network
