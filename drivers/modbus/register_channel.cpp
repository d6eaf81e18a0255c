#include "drivers/modbus/register_channel.h"

#include <algorithm>

namespace rigor::modbus {
namespace {

void describe(const RegisterMap& map, const std::string& name, ChannelDescription& d) {
  d.kind = SampleKind::register_block;
  d.frame_id = name;
  for (const auto& v : map.values()) {
    d.names.push_back(v.name);
    d.units.push_back(v.unit);
  }
}

}  // namespace

SourceSettings SourceSettings::parse(const ChannelConfig& config, ChannelDescription& description) {
  const auto& n = config.params;
  SourceSettings s;
  s.endpoint = Endpoint::parse(n, 1);
  s.map = RegisterMap::parse(n, "registers", RegisterMap::Access::read, RegisterBlock::kMax);
  if (config.period.ns() <= 0)
    throw n.error({}, "expected a rate_hz above 0: registers are asked for, they do not come by themselves");
  describe(s.map, config.name, description);
  return s;
}

namespace {

void parse_watchdog(const ConfigNode& n, SinkSettings& s) {
  if (!n.present()) return;
  const RegisterValue reg = parse_register(n.map("register"), RegisterMap::Access::write);
  const double timeout_ms = n.number("timeout_ms", {.min = 10, .max = 600000});
  s.watchdog_raw.resize(width(reg.type));
  if (encode(reg, timeout_ms, s.watchdog_raw) != EncodeStatus::good)
    throw n.error(
        "timeout_ms",
        "expected a time that the register can hold in its unit (`scale`: milliseconds a count), got one "
        "that it cannot");
  s.watchdog_map = RegisterMap({reg}, RegisterMap::Access::write);
  s.refresh = seconds_from(timeout_ms * 1e-3 / 3);
  n.finish();
}

}  // namespace

SinkSettings SinkSettings::parse(const ChannelConfig& config, ChannelDescription& description) {
  const auto& n = config.params;
  SinkSettings s;
  s.endpoint = Endpoint::parse(n, 0);
  s.map = RegisterMap::parse(n, "registers", RegisterMap::Access::write, Command{}.value.size());
  s.verify = n.flag_or("verify", false);
  parse_watchdog(n.map_or_absent("watchdog"), s);
  s.safe.resize(s.map.values().size());
  const auto safe = n.map("safe");
  std::vector<RegisterValue> values;
  std::vector<double> numbers;
  for (std::size_t i = 0; i < s.map.values().size(); ++i) {
    const auto& v = s.map.values()[i];
    if (!safe.has(v.name)) continue;
    const double x = safe.number(v.name);
    std::vector<std::uint16_t> raw(width(v.type));
    if (encode(v, x, raw) != EncodeStatus::good)
      throw safe.error(v.name, "expected a value that the register can hold, got one that it cannot");
    s.safe[i] = x;
    values.push_back(v);
    numbers.push_back(x);
  }
  safe.finish();
  if (values.empty())
    throw n.error(
        "safe",
        "expected a value for at least one of the registers, got none; the device needs a safe state");
  s.safe_map = RegisterMap(std::move(values), RegisterMap::Access::write);
  s.safe_raw.resize(s.safe_map.raw_size());
  std::size_t bad = 0;
  (void)s.safe_map.encode(numbers, s.safe_raw, bad);  // each was tried above
  describe(s.map, config.name, description);
  return s;
}

std::size_t pool_slots(const ChannelConfig& config) {
  const auto waiting = config.period.ns() > 0 ? config.latency.ns() / config.period.ns() : 0;
  return 64 + static_cast<std::size_t>(std::clamp<std::int64_t>(2 * waiting, 0, 4096));
}

void fill_sample(Sample& sample, const RegisterMap& map, std::span<const std::uint16_t> raw) noexcept {
  auto& block = sample.info.emplace<RegisterBlock>();
  block.count = static_cast<std::uint32_t>(map.values().size());
  // A NaN is handed on as what the device said; the flag says that it is no measurement.
  const unsigned strange = map.decode(raw, block.value);
  sample.stamp.validity = strange != 0 ? kCorrupt : kValid;
  sample.size_bytes = 0;
}

}  // namespace rigor::modbus
