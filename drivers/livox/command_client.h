// A host's side of the commands of a Mid-360, over UDP: asks, and asks again until it is answered.
#pragma once

#include <string>
#include <vector>

#include "drivers/livox/livox_command.h"
#include "rt-core/file_descriptor.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::livox {

/// One thread.
class CommandClient {
 public:
  /// bad_input, unavailable: no way to this address. Setup. `local_address`: where it asks from; 0.0.0.0: the
  /// address that leads there.
  [[nodiscard]] Status open(const std::string& host, std::uint16_t port, const std::string& local_address);
  void close() { socket_.reset(); }
  [[nodiscard]] bool is_open() const { return socket_.is_open(); }
  /// The address that the device sees, host order.
  [[nodiscard]] std::uint32_t local_ipv4() const { return local_ipv4_; }

  /// Data of the answer. not_found: none until `deadline`. `cut_fd`: readable ends the waiting; -1: none.
  [[nodiscard]] Result<std::vector<std::uint8_t>> ask(CommandId id, Bytes data, MonotonicTime deadline,
                                                      int cut_fd = -1);
  /// bad_input: the device refuses one; says which, and why.
  [[nodiscard]] Status set(std::span<const Parameter> parameters, MonotonicTime deadline, int cut_fd = -1);
  /// protocol: it answers with something else.
  [[nodiscard]] Result<WorkState> state(MonotonicTime deadline, int cut_fd = -1);

 private:
  FileDescriptor socket_;
  std::string where_;
  std::uint32_t local_ipv4_ = 0, sequence_ = 0;
};

/// Devices that answer to a search, by their serial number.
struct FoundLidar {
  std::string serial, address;
  std::uint8_t type = 0;
  std::uint16_t command_port = 0;
};
/// Blocks for `time`. `to`: an address or a broadcast address.
[[nodiscard]] std::vector<FoundLidar> search_lidars(const std::string& to, std::uint16_t port, Duration time);

}  // namespace rigor::livox
