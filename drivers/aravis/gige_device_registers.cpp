// Access to the registers of the emulated camera by the rules of its table, and what the larger writes do.
#include <algorithm>
#include <numeric>
#include <utility>

#include "drivers/aravis/gige_device_model.h"

namespace rigor::gige {
namespace {

/// Of the bootstrap block: what is reserved between its registers reads as 0.
constexpr std::pair<reg::Address, reg::Address> kBlocks[] = {
    {0, 0xF8}, {reg::kFirstUrl, 0x670}, {0x900, 0x980}, {0xA00, 0xA18}, {0xD00, 0xD28}};

bool in_block(reg::Address a) {
  return std::any_of(std::begin(kBlocks), std::end(kBlocks),
                     [a](const auto& b) { return a >= b.first && a < b.second; });
}

}  // namespace

Register& RegisterTable::add(reg::Address address, Kind kind, const char* name, const char* tooltip) {
  Register& r = add(address, kind == Kind::real ? std::uint16_t{8} : std::uint16_t{4});
  r.features.push_back({.kind = kind, .category = category_, .name = name, .tooltip = tooltip});
  if (kind == Kind::command || kind == Kind::text) r.beginner();
  return r;
}

Register& RegisterTable::add(reg::Address address, std::uint16_t size) {
  Register& r = rows_.emplace_back();
  r.address = address, r.size = size;
  return r;
}

Register& RegisterTable::fixed(Kind kind, const char* name, const char* tooltip, const char* value) {
  Register& r = add(0, kind, name, tooltip);
  r.size = 0;
  r.features.back().fixed = value;
  return r;
}

void RegisterTable::sort() {
  by_address_.resize(rows_.size());
  std::iota(by_address_.begin(), by_address_.end(), std::uint16_t{0});
  std::erase_if(by_address_, [this](std::uint16_t i) { return rows_[i].size == 0; });
  std::sort(by_address_.begin(), by_address_.end(),
            [this](std::uint16_t a, std::uint16_t b) { return rows_[a].address < rows_[b].address; });
}

const Register* RegisterTable::find(reg::Address address) const {
  const auto after =
      std::upper_bound(by_address_.begin(), by_address_.end(), address,
                       [this](reg::Address a, std::uint16_t i) { return a < rows_[i].address; });
  if (after == by_address_.begin()) return nullptr;
  const Register& r = rows_[*(after - 1)];
  return address - r.address < r.size ? &r : nullptr;
}

GvStatus GigeDeviceModel::read_u32(reg::Address address, Endpoint from, std::uint32_t& value) const {
  const Register* r = registers_.find(address);
  const bool exclusive = (privilege_ & reg::kPrivilegeExclusive) != 0;
  if (exclusive && !is_owner(from) && !(r != nullptr && r->anyone)) return GvStatus::access_denied;
  if (r == nullptr && !in_block(address)) return GvStatus::invalid_address;
  if (r != nullptr && r->is_number()) {
    const std::uint64_t bits = r->access == Access::write_only ? 0 : r->read(*this);
    value = static_cast<std::uint32_t>(r->size == 8 && address == r->address ? bits >> 32 : bits);
  } else {
    value = load_be<std::uint32_t>(bootstrap_, address);
  }
  return GvStatus::success;
}

GvStatus GigeDeviceModel::write_registers(reg::Address address, Bytes data, Endpoint from, DeviceTime now,
                                          GvcpAnswer& answer) {
  // Everything is checked before anything is written, except where a value itself is refused.
  for (std::size_t at = 0; at < data.size(); at += 4) {
    const std::uint64_t a = std::uint64_t{address} + at;
    const Register* r = a > 0xFFFFFFFF ? nullptr : registers_.find(static_cast<reg::Address>(a));
    const bool description = a >= reg::kXml && a < reg::kXml + xml_.size();
    if (r == nullptr && !description && (a > 0xFFFFFFFF || !in_block(static_cast<reg::Address>(a))))
      return GvStatus::invalid_address;
    if (!is_owner(from) && !(r != nullptr && r->anyone)) return GvStatus::access_denied;
    if (r == nullptr || r->access == Access::read_only) return GvStatus::write_protect;
    // Half a number is none.
    if (r->is_number() && r->size == 8 && (a == r->address ? data.size() - at < 8 : at < 4))
      return GvStatus::invalid_parameter;
  }
  for (std::size_t at = 0; at < data.size();) {
    const auto a = static_cast<reg::Address>(address + at);
    const Register& r = *registers_.find(a);
    if (!r.is_number()) {
      store_be(bootstrap_, a, load_be<std::uint32_t>(data, at));
      at += 4;
      continue;
    }
    const std::uint64_t bits =
        r.size == 8 ? load_be<std::uint64_t>(data, at) : std::uint64_t{load_be<std::uint32_t>(data, at)};
    at += r.size;
    if (const auto s = write_number(r, bits, {from, now, answer}); s != GvStatus::success) return s;
  }
  return GvStatus::success;
}

GvStatus GigeDeviceModel::write_number(const Register& r, std::uint64_t bits, const Change& change) {
  if (r.locked && params_locked()) return GvStatus::access_denied;
  if (!within_bounds(r, bits)) return GvStatus::invalid_parameter;
  change.answer.schedule_changed = true;
  const Period before = period();
  const auto s = r.write(*this, bits, change);
  if (acquiring_ && index_ > 0 && !period().same_as(before)) {
    // The frame in progress keeps its place and is exposed to its end; the next one comes a new period behind
    // it.
    run_freely_from(
        on_grid(std::max(std::max(next_free_run_ - before + period(), sensor_free_), change.now)));
  }
  return s;
}

/// By the row's limits and choices. What is clamped is changed to the nearest value that is within.
bool GigeDeviceModel::within_bounds(const Register& r, std::uint64_t& bits) const {
  if (r.is_real()) {
    const double v = std::bit_cast<double>(bits);
    return !r.bounds || (v >= r.bounds->min && v <= r.bounds->max);
  }
  const Feature* f = r.features.empty() || r.features[0].lsb >= 0 ? nullptr : &r.features[0];
  if (f != nullptr && f->kind == Feature::Kind::flag) return bits <= 1;
  if (f != nullptr && f->kind == Feature::Kind::choice && !r.anyone)
    return std::any_of(f->choices.begin(), f->choices.end(),
                       [&](const Choice& c) { return c.value == bits; });
  if (!r.bounds) return true;
  const auto min = static_cast<std::uint64_t>(r.bounds->min);
  auto max = static_cast<std::uint64_t>(r.bounds->max);
  if (r.whole != 0) max = registers_.find(r.whole)->read(*this) - registers_.find(r.used)->read(*this);
  if (r.clamped) bits = std::clamp(bits, min, max);
  return bits >= min && bits <= max && (bits - min) % r.bounds->step == 0;
}

GvStatus GigeDeviceModel::write_privilege(GigeDeviceModel& m, std::uint64_t value, const Change& change) {
  if (m.privilege_ != 0 && !m.is_owner(change.from)) return GvStatus::access_denied;
  const auto wanted = static_cast<std::uint32_t>(value) & (reg::kPrivilegeControl | reg::kPrivilegeExclusive);
  if (wanted == 0) {
    m.release_control();
    return GvStatus::success;
  }
  if (m.privilege_ == 0) ++m.counters_.control_taken;
  m.privilege_ = wanted;
  m.owner_ = change.from;
  m.last_heartbeat_ = change.now;
  return GvStatus::success;
}

GvStatus GigeDeviceModel::write_packet_size(GigeDeviceModel& m, std::uint64_t value, const Change& change) {
  // A size that we cannot do becomes the nearest that we can; the client reads back which.
  m.packet_size_ = std::clamp(static_cast<std::uint32_t>(value & 0xFFFC), m.config_.min_packet_size,
                              m.config_.max_packet_size);
  m.do_not_fragment_ = (value & reg::kDoNotFragment) != 0;
  if ((value & reg::kFireTestPacket) != 0 && m.stream_port_ != 0)
    change.answer.test_packet = TestPacket{m.stream_destination(), m.packet_size_, m.do_not_fragment_};
  return GvStatus::success;
}

void GigeDeviceModel::open_stream(std::uint16_t port) {
  if (port == stream_port_) return;
  stream_port_ = port;
  // A receiver counts blocks from the opening of its stream; an old block must not answer for a new one. They
  // are not counted from AcquisitionStart: a receiver that stays open would take the second acquisition for
  // late packets.
  restart_blocks();
}

void GigeDeviceModel::restart_blocks() {
  next_block_id_ = 1;
  retained_.clear();
  ++epoch_;
}

void GigeDeviceModel::set_trigger(std::uint32_t& part, std::uint64_t value, DeviceTime now) {
  if (part != value) triggers_.clear();
  part = static_cast<std::uint32_t>(value);
  rewire(now);
}

void GigeDeviceModel::enable_ptp(bool on, DeviceTime now) {
  if (on && !ptp_enabled_) ptp_since_ = now;
  ptp_enabled_ = on;
}

}  // namespace rigor::gige
