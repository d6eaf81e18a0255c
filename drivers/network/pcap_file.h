// Recordings of packets (pcap, pcapng) by libpcap: read for inspection and as a source, written by the
// emulator.
#pragma once

#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "drivers/network/udp_frame.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::network {

/// Whether a file begins like a pcap or pcapng.
[[nodiscard]] bool is_pcap(const std::filesystem::path& file);

class PcapReader {
 public:
  struct Record {
    RealtimeTime t;
    /// Empty: another frame, or a fragment that completes no datagram. Valid until the next record.
    std::optional<UdpDatagram> udp;
  };
  /// not_found; bad_input: no recording, or one of a link type that is not understood.
  [[nodiscard]] static Result<PcapReader> open(const std::filesystem::path& file);
  /// The same of a stream at its beginning, which is closed in any case; `name` is for messages.
  [[nodiscard]] static Result<PcapReader> open(std::FILE* stream, std::string name);
  PcapReader(PcapReader&&) noexcept;
  PcapReader& operator=(PcapReader&&) noexcept;
  ~PcapReader();

  /// Empty at the end. protocol: the file ends within a packet or is damaged; says where. Stamps are within
  /// 4e18 ns of 1970, so that differences of any two are instants' differences, too.
  [[nodiscard]] Result<std::optional<Record>> next();
  /// Frames read so far.
  [[nodiscard]] std::uint64_t frames() const;
  /// What of them were fragments.
  [[nodiscard]] const UdpReassembler::Counters& fragments() const;

 private:
  struct Impl;
  explicit PcapReader(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// Every datagram to the end of a recording, as `take(t, datagram)`. Empty: it is whole.
template <class Take>
[[nodiscard]] std::optional<Error> read_datagrams(PcapReader& reader, Take&& take) {
  while (true) {
    const auto record = reader.next();
    if (!record) return record.error();
    if (!*record) return {};
    if ((*record)->udp) take((*record)->t, *(*record)->udp);
  }
}

/// Who sent it: "192.168.1.201:2368".
[[nodiscard]] std::string sender_of(const UdpDatagram& datagram);

class PcapWriter {
 public:
  /// not_writable. Nanosecond stamps, Ethernet.
  [[nodiscard]] static Result<PcapWriter> create(const std::filesystem::path& file);
  PcapWriter(PcapWriter&&) noexcept;
  PcapWriter& operator=(PcapWriter&&) noexcept;
  ~PcapWriter();  ///< flushes and closes

  /// A datagram that is longer than an Ethernet frame leaves in fragments, as on the wire.
  void write(RealtimeTime t, const UdpDatagram& datagram);
  /// io or disk_full: something could not be written.
  [[nodiscard]] Status flush();

 private:
  struct Impl;
  explicit PcapWriter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::network
