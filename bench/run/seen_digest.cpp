#include "bench/run/seen_digest.h"

#include <openssl/evp.h>

#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <limits>

namespace rigor {
namespace {

/// Appends numbers byte by byte, little-endian, so that padding never reaches the digest.
class Flat {
 public:
  void add(std::uint64_t v) {
    for (int i = 0; i < 8; ++i) bytes_[size_++] = static_cast<unsigned char>(v >> (8 * i));
  }
  void add(double v) { add(std::bit_cast<std::uint64_t>(v)); }
  [[nodiscard]] const unsigned char* data() const { return bytes_.data(); }
  [[nodiscard]] std::size_t size() const { return size_; }

 private:
  std::array<unsigned char, 1024> bytes_{};
  std::size_t size_ = 0;
};

void add_info(Flat& flat, const Sample& s) {
  flat.add(static_cast<std::uint64_t>(s.kind()));
  if (const auto* image = s.as<ImageInfo>()) {
    flat.add(static_cast<std::uint64_t>(image->format));
    flat.add(std::uint64_t{image->width_px} << 32 | image->height_px);
    flat.add(std::uint64_t{image->offset_x_px} << 32 | image->offset_y_px);
    flat.add(static_cast<std::uint64_t>(image->exposure.ns()));
    flat.add(image->gain_db);
  } else if (const auto* r = s.as<RangeImageInfo>()) {
    flat.add(std::uint64_t{r->width_px} << 32 | r->height_px);
  } else if (const auto* c = s.as<PointCloudInfo>()) {
    flat.add(std::uint64_t{c->count});
  } else if (const auto* f = s.as<CanFrame>()) {
    flat.add(std::uint64_t{f->id} << 32 | f->length);
    for (std::size_t i = 0; i < f->length; ++i) flat.add(std::uint64_t{f->data[i]});
  } else if (const auto* b = s.as<RegisterBlock>()) {
    for (std::size_t i = 0; i < b->count; ++i) flat.add(b->value[i]);
  } else if (const auto* p = s.as<Pose>()) {
    for (double v : p->position_m) flat.add(v);
    for (double v : p->orientation_wxyz) flat.add(v);
  } else if (const auto* imu = s.as<ImuSample>()) {
    for (double v : imu->specific_force_mps2) flat.add(v);
    for (double v : imu->angular_rate_radps) flat.add(v);
    flat.add(std::isnan(imu->temperature_c) ? std::numeric_limits<double>::quiet_NaN() : imu->temperature_c);
  } else if (const auto* fix = s.as<NavFix>()) {
    flat.add(std::uint64_t{fix->satellites} << 8 | static_cast<std::uint64_t>(fix->status));
    flat.add(fix->latitude_deg);
    flat.add(fix->longitude_deg);
    flat.add(fix->height_m);
    for (double v : fix->covariance_enu_m2) flat.add(v);
  } else if (const auto* o = s.as<Odometry>()) {
    for (double v : o->T_odom_base.position_m) flat.add(v);
    for (double v : o->T_odom_base.orientation_wxyz) flat.add(v);
    for (double v : o->velocity_mps) flat.add(v);
    for (double v : o->turn_rate_radps) flat.add(v);
    for (double v : o->pose_variance) flat.add(v);
    for (double v : o->twist_variance) flat.add(v);
    for (double v : o->wheel_angle_rad) flat.add(v);
    for (double v : o->wheel_rate_radps) flat.add(v);
  } else if (const auto* e = s.as<EventInfo>()) {
    flat.add(std::uint64_t{e->code});
    flat.add(e->value);
  }
}

}  // namespace

void SeenDigest::FreeContext::operator()(evp_md_ctx_st* context) const noexcept { EVP_MD_CTX_free(context); }

SeenDigest::SeenDigest(bool may_wait) : may_wait_(may_wait), context_(EVP_MD_CTX_new()), thread_() {
  EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr);
  thread_ = std::thread([this] { work(); });
}

SeenDigest::~SeenDigest() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
}

void SeenDigest::saw(std::uint64_t cycle, BenchTime t_cycle, std::uint32_t port, PortStatus status,
                     const SampleLease& sample) noexcept {
  Entry e{cycle, t_cycle, port, status, sample};
  while (!ring_.try_push(std::move(e))) {
    if (!may_wait_) {
      ++dropped_;
      return;
    }
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  }
}

void SeenDigest::work() {
  for (;;) {
    const bool last_round = stop_;  // read before the ring: what was pushed before stop is still hashed
    for (Entry e; ring_.try_pop(e); e = Entry{}) hash(e);
    if (last_round) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

void SeenDigest::hash(const Entry& e) {
  Flat flat;
  flat.add(e.cycle);
  flat.add(static_cast<std::uint64_t>(e.t_cycle.ns()));
  flat.add(std::uint64_t{e.port} << 8 | static_cast<std::uint64_t>(e.status));
  if (e.sample) {
    const Stamp& s = e.sample->stamp;
    flat.add(s.sequence);
    flat.add(static_cast<std::uint64_t>(s.t_capture.ns()));
    flat.add(static_cast<std::uint64_t>(s.t_release.ns()));
    flat.add(std::uint64_t{s.validity});
    if (e.status == PortStatus::fresh) add_info(flat, *e.sample);
  }
  EVP_DigestUpdate(context_.get(), flat.data(), flat.size());
  if (e.sample && e.status == PortStatus::fresh)
    EVP_DigestUpdate(context_.get(), e.sample->bytes().data(), e.sample->bytes().size());
}

std::string SeenDigest::finish() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
  if (dropped_ > 0) return {};
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
