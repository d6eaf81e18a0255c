#include "drivers/gnss/config_dialog.h"

#include <algorithm>
#include <cstdio>

namespace rigor::gnss {
namespace {

constexpr std::uint16_t kUbx = 1, kNmea = 2, kRtcm3 = 32;

/// Of messages of one solution each; satellites and pulses once a second.
std::uint8_t rate_of(const OutputMessage& m, Duration period) {
  const bool slow = m.id == UbxId::nav_sat || m.id == UbxId::tim_tp || m.id == ubx_id(0xF0, 0x03);
  if (!slow || period.ns() <= 0) return 1;
  return static_cast<std::uint8_t>(std::clamp<std::int64_t>(seconds(1) / period, 1, 255));
}

std::uint16_t period_ms(Duration period) {
  return static_cast<std::uint16_t>(std::clamp<std::int64_t>((period.ns() + 500'000) / 1'000'000, 25, 65535));
}

}  // namespace

ConfigDialog::ConfigDialog(const ConfigureSettings& settings, Duration period, std::string where)
    : settings_(settings), period_(period), where_(std::move(where)) {
  append_ubx(poll_, UbxId::mon_ver, {});
  if (settings_.generation == 0)
    asks_ = true;
  else
    prepare(settings_.generation);
}

void ConfigDialog::prepare(unsigned generation) {
  const auto wanted = [&](const OutputMessage& m) {
    return std::find(settings_.messages.begin(), settings_.messages.end(), m.name) !=
           settings_.messages.end();
  };
  bool ubx = false, nmea = false;
  for (const OutputMessage& m : output_messages())
    if (wanted(m)) (m.nmea ? nmea : ubx) = true;
  const auto port = static_cast<std::uint32_t>(settings_.interface);
  if (generation == 9) {
    // Groups of protocols: UART1 0x73 and 0x74, UART2 0x75 and 0x76, USB 0x77 and 0x78.
    const std::uint32_t in = config_key::kUart1In + 0x20000 * (port - 1), out = in + 0x10000;
    std::vector<ConfigItem> items{{in + 1, 1}, {in + 2, 1}, {in + 4, 1}, {out + 1, ubx}, {out + 2, nmea}};
    if (period_.ns() > 0) {
      items.push_back({config_key::kRateMeasurement, period_ms(period_)});
      items.push_back({config_key::kRateNavigation, 1});
    }
    for (const OutputMessage& m : output_messages())
      items.push_back({m.key + port, wanted(m) ? rate_of(m, period_) : std::uint8_t{0}});
    Request r{UbxId::cfg_valset, {}};
    append_valset(r.bytes, items);
    requests_.push_back(std::move(r));
    return;
  }
  if (period_.ns() > 0) {
    Request r{UbxId::cfg_rate, {}};
    append_cfg_rate(r.bytes, period_ms(period_));
    requests_.push_back(std::move(r));
  }
  for (const OutputMessage& m : output_messages()) {
    // Generation 8 has neither; asking for them is refused, so that nobody waits for what never comes.
    if (!wanted(m) && (m.id == UbxId::nav_cov || m.id == UbxId::rxm_rawx)) continue;
    Request r{UbxId::cfg_msg, {}};
    append_cfg_msg(r.bytes, m.id, wanted(m) ? rate_of(m, period_) : std::uint8_t{0});
    requests_.push_back(std::move(r));
  }
}

Bytes ConfigDialog::request() { return asks_ ? Bytes(poll_) : Bytes(requests_[step_].bytes); }

std::string ConfigDialog::asked() const {
  if (asks_) return "MON-VER";
  switch (requests_[std::min(step_, requests_.size() - 1)].id) {
    case UbxId::cfg_valset:
      return "CFG-VALSET";
    case UbxId::cfg_rate:
      return "CFG-RATE";
    default:
      return "CFG-MSG";
  }
}

Result<bool> ConfigDialog::answer(const Message& m) {
  if (m.kind != Message::Kind::ubx) return false;
  if (m.ubx == UbxId::mon_ver) {
    const bool waited = asks_;
    version_ = parse_mon_ver(m.payload);
    if (!waited || !version_) return false;
    asks_ = false;
    prepare(version_->generation() == 8 ? 8 : 9);
    return true;
  }
  if (asks_ || (m.ubx != UbxId::ack_ack && m.ubx != UbxId::ack_nak)) return false;
  const auto about = parse_ack(m.payload);
  if (!about || step_ == requests_.size() || *about != requests_[step_].id) return false;
  if (m.ubx == UbxId::ack_nak) {
    std::string which = asked();
    if (requests_[step_].id == UbxId::cfg_msg) {
      char text[32];
      std::snprintf(text, sizeof text, " for message %02X-%02X", requests_[step_].bytes[6],
                    requests_[step_].bytes[7]);
      which += text;
    }
    return fail(ErrorCode::protocol, where_,
                "expected the receiver to take " + which +
                    ", it refuses (ACK-NAK): check `configure.messages` and the rate against its manual, and "
                    "`configure.generation`");
  }
  ++step_;
  return true;
}

void append_baud_request(Buffer& out, const ConfigureSettings& settings, unsigned generation) {
  if (generation == 8) {
    append_cfg_prt(out, {static_cast<std::uint8_t>(settings.interface), 0x8D0, settings.baud,
                         kUbx | kNmea | kRtcm3, kUbx | kNmea});
    return;
  }
  const std::uint32_t port = settings.interface == Interface::uart2 ? 1 : 0;
  const ConfigItem item{config_key::kUart1Baud + port * 0x10000, settings.baud};
  append_valset(out, {&item, 1});
}

}  // namespace rigor::gnss
