#include "drivers/network/pcap_file.h"

#include <pcap/pcap.h>

#include <cerrno>
#include <cstring>
#include <fstream>

#include "rt-core/byte_order.h"

namespace rigor::network {
namespace {

struct Close {
  void operator()(pcap_t* p) const { pcap_close(p); }
  void operator()(pcap_dumper_t* p) const { pcap_dump_close(p); }
  void operator()(std::FILE* f) const { std::fclose(f); }
};

/// A recording's number for a link type. libpcap says raw IP by the system's own, which is 12 on Linux.
int link_type_of(pcap_t* file) {
  const int dlt = pcap_datalink(file);
  return dlt == DLT_RAW ? kLinkRaw : dlt;
}

/// A stamp of seconds and nanoseconds; empty: no time of a recording. pcapng has 64 bits for it.
std::optional<RealtimeTime> instant(std::int64_t s, std::int64_t ns) {
  constexpr std::int64_t kMost_s = 3'999'999'000;
  if (s < -kMost_s || s > kMost_s || ns < 0 || ns > 900'000'000'000) return {};
  return RealtimeTime(s * 1'000'000'000 + ns);
}

}  // namespace

bool is_pcap(const std::filesystem::path& file) {
  std::uint8_t b[4] = {};
  std::ifstream in(file, std::ios::binary);
  if (!in.read(reinterpret_cast<char*>(b), sizeof b)) return false;
  const auto big = load_be<std::uint32_t>(b);
  // µs and ns, in both byte orders; pcapng's section header.
  return big == 0xA1B2C3D4U || big == 0xD4C3B2A1U || big == 0xA1B23C4DU || big == 0x4D3CB2A1U ||
         big == 0x0A0D0D0AU;
}

struct PcapReader::Impl {
  std::string name;
  std::unique_ptr<pcap_t, Close> file;
  std::optional<UdpReassembler> datagrams;
  std::uint64_t frames = 0;
};

PcapReader::PcapReader(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PcapReader::PcapReader(PcapReader&&) noexcept = default;
PcapReader& PcapReader::operator=(PcapReader&&) noexcept = default;
PcapReader::~PcapReader() = default;

Result<PcapReader> PcapReader::open(const std::filesystem::path& file) {
  std::error_code ec;
  if (!std::filesystem::exists(file, ec))
    return fail(ErrorCode::not_found, file.string(),
                "expected a recording (pcap or pcapng), got nothing: no such file");
  std::FILE* stream = std::fopen(file.c_str(), "rbe");
  if (!stream)
    return fail(ErrorCode::bad_input, file.string(),
                std::string("expected a recording that can be read: ") + std::strerror(errno));
  return open(stream, file.string());
}

Result<PcapReader> PcapReader::open(std::FILE* taken, std::string name) {
  std::unique_ptr<std::FILE, Close> stream(taken);
  auto impl = std::make_unique<Impl>();
  impl->name = std::move(name);
  char why[PCAP_ERRBUF_SIZE] = {};
  impl->file.reset(pcap_fopen_offline_with_tstamp_precision(stream.get(), PCAP_TSTAMP_PRECISION_NANO, why));
  if (!impl->file)
    return fail(ErrorCode::bad_input, impl->name,
                std::string("expected a recording (pcap or pcapng), got something else: ") + why);
  (void)stream.release();  // closed with the reader
  const int link_type = link_type_of(impl->file.get());
  if (!knows_link_type(link_type)) {
    const char* link = pcap_datalink_val_to_name(pcap_datalink(impl->file.get()));
    return fail(ErrorCode::bad_input, impl->name,
                std::string("expected frames of Ethernet, Linux cooked (SLL) or raw IP, got link type ") +
                    (link ? link : std::to_string(link_type).c_str()));
  }
  impl->datagrams.emplace(link_type);
  return PcapReader(std::move(impl));
}

Result<std::optional<PcapReader::Record>> PcapReader::next() {
  pcap_pkthdr* header = nullptr;
  const u_char* data = nullptr;
  std::FILE* stream = pcap_file(impl_->file.get());
  const long before = stream ? std::ftell(stream) : -1;
  const int r = pcap_next_ex(impl_->file.get(), &header, &data);
  if (r == PCAP_ERROR_BREAK) return std::optional<Record>{};
  const auto broken = [&](const std::string& what) {
    const std::string place = "packet " + std::to_string(impl_->frames + 1) +
                              (before >= 0 ? " at byte " + std::to_string(before) : std::string());
    return fail(
        ErrorCode::protocol, impl_->name,
        place + ": expected " + what + "; the " + std::to_string(impl_->frames) + " before it are whole");
  };
  if (r != 1) return broken(std::string("a whole packet, got: ") + pcap_geterr(impl_->file.get()));
  // With nanosecond precision tv_usec holds nanoseconds.
  const auto t = instant(header->ts.tv_sec, header->ts.tv_usec);
  if (!t)
    return broken("a stamp between the years 1844 and 2096, got " + std::to_string(header->ts.tv_sec) +
                  " s and " + std::to_string(header->ts.tv_usec) + " ns");
  ++impl_->frames;
  Record record;
  record.t = *t;
  record.udp = impl_->datagrams->take({data, header->caplen}, *t);
  return std::optional<Record>(record);
}

std::uint64_t PcapReader::frames() const { return impl_->frames; }
const UdpReassembler::Counters& PcapReader::fragments() const { return impl_->datagrams->counters(); }

struct PcapWriter::Impl {
  std::string name;
  std::unique_ptr<pcap_t, Close> format;
  std::unique_ptr<pcap_dumper_t, Close> file;
  std::uint16_t identification = 0;
};

PcapWriter::PcapWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PcapWriter::PcapWriter(PcapWriter&&) noexcept = default;
PcapWriter& PcapWriter::operator=(PcapWriter&&) noexcept = default;
PcapWriter::~PcapWriter() = default;

Result<PcapWriter> PcapWriter::create(const std::filesystem::path& file) {
  auto impl = std::make_unique<Impl>();
  impl->name = file.string();
  impl->format.reset(pcap_open_dead_with_tstamp_precision(DLT_EN10MB, 65535, PCAP_TSTAMP_PRECISION_NANO));
  if (impl->format) impl->file.reset(pcap_dump_open(impl->format.get(), impl->name.c_str()));
  if (!impl->file)
    return fail(ErrorCode::not_writable, impl->name,
                std::string("expected a file that can be written: ") +
                    (impl->format ? pcap_geterr(impl->format.get()) : "no memory"));
  return PcapWriter(std::move(impl));
}

void PcapWriter::write(RealtimeTime t, const UdpDatagram& datagram) {
  pcap_pkthdr header{};
  header.ts.tv_sec = static_cast<decltype(header.ts.tv_sec)>(t.ns() / 1'000'000'000);
  header.ts.tv_usec = static_cast<decltype(header.ts.tv_usec)>(t.ns() % 1'000'000'000);
  for (const auto& frame : ethernet_frames(datagram, impl_->identification++)) {
    header.caplen = header.len = static_cast<bpf_u_int32>(frame.size());
    pcap_dump(reinterpret_cast<u_char*>(impl_->file.get()), &header, frame.data());
  }
}

Status PcapWriter::flush() {
  if (pcap_dump_flush(impl_->file.get()) != 0 || std::ferror(pcap_dump_file(impl_->file.get())) != 0)
    return fail(errno == ENOSPC ? ErrorCode::disk_full : ErrorCode::io, impl_->name,
                std::string("expected to write the recording: ") + std::strerror(errno));
  return {};
}

std::string sender_of(const UdpDatagram& d) {
  return (d.source_ipv4 == 0 ? "IPv6" : text_of_ipv4(d.source_ipv4)) + ":" + std::to_string(d.source_port);
}

}  // namespace rigor::network
