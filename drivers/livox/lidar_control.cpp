#include "drivers/livox/lidar_control.h"

#include <algorithm>
#include <span>

#include "rt-core/byte_order.h"

namespace rigor::livox {
namespace {

/// A parameter: how long its value is, whether hosts set it, and which first bytes it may have (0, 0: any).
struct Rule {
  Key key;
  std::uint16_t bytes;
  bool writable = true;
  std::uint8_t least = 0, most = 0;
};
constexpr Rule kRules[] = {{Key::data_type, 1, true, 1, 3},
                           {Key::pattern_mode, 1, true, 0, 2},
                           {Key::lidar_ip, 12},
                           {Key::state_host, 8},
                           {Key::point_host, 8},
                           {Key::imu_host, 8},
                           {Key::install_attitude, 24},
                           {Key::fov_0, 20},
                           {Key::fov_1, 20},
                           {Key::fov_enable, 1, true, 0, 3},
                           {Key::detect_mode, 1, true, 0, 1},
                           {Key::io, 4},
                           {Key::target_mode, 1, true, 1, 9},
                           {Key::imu_enable, 1, true, 0, 1},
                           {Key::serial, 16, false},
                           {Key::product, 64, false},
                           {Key::firmware, 4, false},
                           {Key::loader, 4, false},
                           {Key::hardware, 4, false},
                           {Key::mac, 6, false},
                           {Key::state, 1, false},
                           {Key::temperature, 4, false},
                           {Key::power_ups, 4, false},
                           {Key::time_now, 8, false},
                           {Key::last_sync, 8, false},
                           {Key::time_offset, 8, false},
                           {Key::time_sync, 1, false},
                           {Key::diagnosis, 2, false},
                           {Key::firmware_type, 1, false},
                           {Key::hms_code, 32, false}};
/// What a push has.
constexpr Key kPushed[] = {Key::data_type,   Key::lidar_ip,   Key::state_host, Key::point_host,
                           Key::imu_host,    Key::imu_enable, Key::serial,     Key::state,
                           Key::temperature, Key::time_now,   Key::last_sync,  Key::time_offset,
                           Key::time_sync,   Key::diagnosis};

const Rule* rule_of(Key key) {
  const Rule* r =
      std::find_if(std::begin(kRules), std::end(kRules), [&](const Rule& k) { return k.key == key; });
  return r == std::end(kRules) ? nullptr : r;
}

ReturnCode judge(const Parameter& p) {
  const Rule* r = rule_of(p.key);
  if (!r) return ReturnCode::not_supported;
  if (!r->writable) return ReturnCode::read_only;
  if (p.value.size() != r->bytes) return ReturnCode::wrong_length;
  if (r->most > 0 && (p.value[0] < r->least || p.value[0] > r->most)) return ReturnCode::out_of_range;
  if (p.key == Key::target_mode) {
    const auto mode = static_cast<WorkState>(p.value[0]);
    if (mode != WorkState::sampling && mode != WorkState::idle && mode != WorkState::ready)
      return ReturnCode::out_of_range;
  }
  return ReturnCode::success;
}

}  // namespace

LidarControl::LidarControl(const Identity& identity, const Setup& setup, MonotonicTime now)
    : identity_(identity) {
  for (const Rule& r : kRules) values_[r.key].assign(r.bytes, 0);
  const auto text = [&](Key key, const std::string& s) {
    Value& v = values_[key];
    std::copy_n(s.begin(), std::min(s.size(), v.size()), v.begin());
  };
  text(Key::serial, identity.serial);
  text(Key::product, identity.product);
  values_[Key::firmware] = {13, 18, 2, 37};
  values_[Key::mac] = {0x02, 0, 0, 0, 0, 1};
  values_[Key::firmware_type] = {1};
  Value& ip = values_[Key::lidar_ip];
  store_be(ip, 0, identity.ipv4);
  store_be(ip, 4, 0xFFFFFF00U);
  values_[Key::data_type] = {static_cast<std::uint8_t>(setup.data_type)};
  values_[Key::target_mode] = {static_cast<std::uint8_t>(setup.target)};
  values_[Key::imu_enable] = {static_cast<std::uint8_t>(setup.imu ? 1 : 0)};
  const auto host = [&](Key key, const HostAddress& h) {
    const auto bytes = bytes_of(h);
    values_[key].assign(bytes.begin(), bytes.end());
  };
  host(Key::state_host, setup.state_host);
  host(Key::point_host, setup.point_host);
  host(Key::imu_host, setup.imu_host);
  switch_on(now);
}

void LidarControl::switch_on(MonotonicTime now) {
  switched_on_ = now;
  reboots_ = gps_ = false;
  store_le(values_[Key::power_ups], 0, ++power_ups_);
  ++generation_;
}

void LidarControl::pass(MonotonicTime now) {
  if (reboots_ && now >= reboot_at_) switch_on(reboot_at_);
}

WorkState LidarControl::state(MonotonicTime now) const {
  const Duration on = now - switched_on_;
  if (on < identity_.start_up / 2) return WorkState::self_check;
  if (on < identity_.start_up) return WorkState::motor_start;
  return static_cast<WorkState>(values_.at(Key::target_mode)[0]);
}

LidarControl::Setup LidarControl::setup() const {
  Setup s;
  s.data_type = static_cast<DataType>(values_.at(Key::data_type)[0]);
  s.state_host = host_of(values_.at(Key::state_host));
  s.point_host = host_of(values_.at(Key::point_host));
  s.imu_host = host_of(values_.at(Key::imu_host));
  s.imu = values_.at(Key::imu_enable)[0] != 0;
  s.target = static_cast<WorkState>(values_.at(Key::target_mode)[0]);
  return s;
}

LidarControl::Active LidarControl::active(MonotonicTime now) {
  pass(now);
  return {setup(), state(now), switched_on_, gps_less_device_ns_, gps_, generation_};
}

/// What it tells of itself and its clock.
void LidarControl::measure_itself(MonotonicTime now) {
  values_[Key::state] = {static_cast<std::uint8_t>(state(now))};
  store_le(values_[Key::temperature], 0, std::int32_t{4500});
  const std::int64_t device_ns = (now - switched_on_).ns();
  store_le(values_[Key::time_now], 0,
           static_cast<std::uint64_t>(device_ns + (gps_ ? gps_less_device_ns_ : 0)));
  store_le(values_[Key::time_offset], 0, gps_ ? -gps_less_device_ns_ : std::int64_t{0});
  values_[Key::time_sync] = {static_cast<std::uint8_t>(gps_ ? TimeType::gps : TimeType::none)};
}

std::vector<std::uint8_t> LidarControl::answer(Bytes datagram, bool searching, MonotonicTime now) {
  const auto request = parse_command(datagram);
  if (!request || request->answer || request->from_lidar) return {};
  if (searching && request->id != CommandId::search) return {};
  pass(now);
  measure_itself(now);
  Value data;
  switch (request->id) {
    case CommandId::search:
      data = search_data(
          {ReturnCode::success, kMid360Type, identity_.serial, identity_.ipv4, identity_.command_port});
      break;
    case CommandId::configure:
      data = configure(request->data);
      break;
    case CommandId::inquire:
      data = inquire(request->data);
      break;
    case CommandId::reboot:
      if (request->data.size() != 2) {
        data = {static_cast<std::uint8_t>(ReturnCode::wrong_length)};
        break;
      }
      reboots_ = true;
      reboot_at_ = now + milliseconds(load_le<std::uint16_t>(request->data, 0));
      data = {static_cast<std::uint8_t>(ReturnCode::success)};
      break;
    case CommandId::set_gps_time:
      data = gps_time(request->data, now);
      break;
    default:
      data = {static_cast<std::uint8_t>(ReturnCode::not_supported)};
  }
  return compose_command({request->sequence, request->id, true, true, data});
}

LidarControl::Value LidarControl::configure(Bytes data) {
  ReturnCode code = ReturnCode::success;
  auto wrong = Key{};
  const auto list = data.size() < 4 ? std::optional<std::vector<Parameter>>()
                                    : parse_parameters(data.subspan(4), load_le<std::uint16_t>(data, 0));
  if (!list) {
    code = ReturnCode::wrong_count;
  } else {
    // All of them, or none.
    for (const Parameter& p : *list)
      if (const ReturnCode judged = judge(p); judged != ReturnCode::success && code == ReturnCode::success)
        code = judged, wrong = p.key;
    bool changed = false;
    for (const Parameter& p : *list) {
      if (code != ReturnCode::success && code != ReturnCode::reboot_needed) break;
      Value& v = values_[p.key];
      if (std::equal(v.begin(), v.end(), p.value.begin(), p.value.end())) continue;
      v.assign(p.value.begin(), p.value.end());
      changed = true;
      if (p.key == Key::lidar_ip) code = ReturnCode::reboot_needed, wrong = p.key;
    }
    generation_ += changed;
  }
  Value out{static_cast<std::uint8_t>(code)};
  append_le(out, wrong);
  return out;
}

LidarControl::Value LidarControl::inquire(Bytes data) {
  const auto refuse = [](ReturnCode code) {
    Value out{static_cast<std::uint8_t>(code)};
    append_le(out, std::uint16_t{0});
    return out;
  };
  if (data.size() < 4) return refuse(ReturnCode::wrong_count);
  const std::size_t count = load_le<std::uint16_t>(data, 0);
  if (data.size() - 4 != count * 2) return refuse(ReturnCode::wrong_count);
  Value out{static_cast<std::uint8_t>(ReturnCode::success)};
  append_le(out, static_cast<std::uint16_t>(count));
  for (std::size_t i = 0; i < count; ++i) {
    const auto key = load_le<Key>(data, 4 + 2 * i);
    const auto v = values_.find(key);
    if (v == values_.end()) return refuse(ReturnCode::not_supported);
    append_parameter(out, key, v->second);
    if (out.size() > kMaxCommandBytes - kCommandHeaderBytes) return refuse(ReturnCode::wrong_length);
  }
  return out;
}

LidarControl::Value LidarControl::gps_time(Bytes data, MonotonicTime now) {
  if (data.size() != 9) return {static_cast<std::uint8_t>(ReturnCode::wrong_length)};
  const auto time_ns = load_le<std::uint64_t>(data, 1);
  if (data[0] != static_cast<std::uint8_t>(TimeType::gps) || time_ns > std::uint64_t{1} << 62)
    return {static_cast<std::uint8_t>(ReturnCode::out_of_range)};
  gps_ = true;
  gps_less_device_ns_ = static_cast<std::int64_t>(time_ns) - (now - switched_on_).ns();
  store_le(values_[Key::last_sync], 0, time_ns);
  ++generation_;
  return {static_cast<std::uint8_t>(ReturnCode::success)};
}

std::vector<std::uint8_t> LidarControl::push(MonotonicTime now) {
  pass(now);
  measure_itself(now);
  std::vector<Parameter> list;
  for (const Key key : kPushed) list.push_back({key, values_[key]});
  const Value data = parameter_data(list);
  return compose_command({++sequence_, CommandId::push, false, true, data});
}

}  // namespace rigor::livox
