#include "bench/run/input_digest.h"

#include <openssl/evp.h>

#include <chrono>

namespace rigor {
namespace {

/// Numbers byte by byte, little-endian, so that padding never reaches the digest.
class Flat {
 public:
  void add(std::uint64_t v) {
    for (int i = 0; i < 8; ++i) bytes_[size_++] = static_cast<unsigned char>(v >> (8 * i));
  }
  [[nodiscard]] const unsigned char* data() const { return bytes_.data(); }
  [[nodiscard]] std::size_t size() const { return size_; }

 private:
  std::array<unsigned char, 64> bytes_{};
  std::size_t size_ = 0;
};

}  // namespace

void InputDigest::FreeContext::operator()(evp_md_ctx_st* context) const noexcept { EVP_MD_CTX_free(context); }

InputDigest::InputDigest(const std::vector<SampleKind>& kinds, bool may_wait)
    : may_wait_(may_wait),
      leases_(std::make_unique<std::atomic<std::uint32_t>[]>(kinds.size())),
      context_(EVP_MD_CTX_new()) {
  // Names and frames are the rig's, and not what was measured.
  for (const SampleKind kind : kinds) {
    record::SampleChannel channel;
    channel.kind = kind;
    encoders_.emplace_back(std::move(channel));
  }
  EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr);
  thread_ = std::thread([this] { work(); });
}

InputDigest::~InputDigest() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
}

void InputDigest::saw(std::uint64_t cycle, BenchTime t_cycle, std::uint32_t port, PortStatus status,
                      const SampleLease& sample) noexcept {
  Entry e;
  e.cycle = cycle;
  e.t_cycle = t_cycle;
  e.port = port;
  e.status = status;
  if (sample) {
    e.has_sample = true;
    e.stamp = sample->stamp;
    if (status == PortStatus::fresh && sample->size_bytes == 0) e.info = sample->info;
    if (status == PortStatus::fresh && sample->size_bytes > 0) {
      if (!may_wait_ && leases_[port].load(std::memory_order_acquire) >= kLeases) {
        ++dropped_;
        return;
      }
      leases_[port].fetch_add(1, std::memory_order_relaxed);
      e.lease = sample;
    }
  }
  while (!ring_.try_push(std::move(e))) {
    if (!may_wait_) {
      if (e.lease) leases_[port].fetch_sub(1, std::memory_order_relaxed);
      ++dropped_;
      return;
    }
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  }
}

void InputDigest::work() {
  for (;;) {
    const bool last_round = stop_;  // read before the ring: what was pushed before stop is still hashed
    for (Entry e; ring_.try_pop(e); e = Entry{}) hash(e);
    if (last_round) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

void InputDigest::hash(Entry& e) {
  Flat flat;
  flat.add(e.cycle);
  flat.add(static_cast<std::uint64_t>(e.t_cycle.ns()));
  flat.add(std::uint64_t{e.port} << 8 | static_cast<std::uint64_t>(e.status));
  if (e.has_sample) {
    flat.add(e.stamp.sequence);
    flat.add(static_cast<std::uint64_t>(e.stamp.t_capture.ns()));
    flat.add(static_cast<std::uint64_t>(e.stamp.t_release.ns()));
    flat.add(std::uint64_t{e.stamp.validity});
  }
  EVP_DigestUpdate(context_.get(), flat.data(), flat.size());
  if (!e.has_sample || e.status != PortStatus::fresh) return;
  if (!e.lease) {
    without_bytes_.stamp = e.stamp;
    without_bytes_.info = e.info;
  }
  record::SampleEncoder& encoder = encoders_[e.port];
  const auto messages = encoder.encode(e.lease ? *e.lease : without_bytes_);
  if (messages) {
    // The companion with the stamps has the arrival, which a replay need not have.
    for (const record::SampleMessage& m : *messages)
      if (encoder.streams()[m.stream].type != record::msg::SampleStamp::kType)
        for (const auto& piece : m.pieces) EVP_DigestUpdate(context_.get(), piece.data(), piece.size());
  } else {
    encoded_ = false;
  }
  if (e.lease) {
    e.lease = {};
    leases_[e.port].fetch_sub(1, std::memory_order_release);
  }
}

std::string InputDigest::finish() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
  if (dropped_ > 0 || !encoded_) return {};
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned size = 0;
  EVP_DigestFinal_ex(context_.get(), digest.data(), &size);
  std::string hex;
  for (unsigned i = 0; i < size; ++i) {
    static constexpr char kHex[] = "0123456789abcdef";
    hex += kHex[digest[i] >> 4];
    hex += kHex[digest[i] & 15];
  }
  return hex;
}

}  // namespace rigor
