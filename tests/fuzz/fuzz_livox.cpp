// What the ports of a Livox and its host can hold, and a scan pattern's file. Input: a byte that says which,
// then for 0 records of `length:16 bytes` as datagrams of one stream of points (time, frame and confidence by
// the byte's upper bits; a record of 4 to 12 bytes makes a good packet: steps of packets, of its count, type,
// time type, and bytes that are others), for 1 the same as readings of the inertial unit, for 2 such records
// as commands to an emulated device (one of 3 to 23 bytes becomes the data of a good one, whose id are its
// first two bytes), for 3 a command's answer, for 4 a scan pattern.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string_view>
#include <vector>

#include "drivers/livox/imu_decoder.h"
#include "drivers/livox/lidar_control.h"
#include "drivers/livox/point_stream.h"
#include "rt-core/byte_order.h"
#include "sensor-hal/models/lidar/scan_pattern.h"

using namespace rigor;
using namespace rigor::livox;

namespace {

void check(bool holds) {
  if (!holds) std::abort();
}

/// Calls `f` with each record.
template <class F>
void each_record(Bytes rest, const F& f) {
  while (rest.size() >= 2) {
    const std::size_t length = std::min<std::size_t>(load_le<std::uint16_t>(rest, 0), rest.size() - 2);
    f(rest.subspan(2, length));
    rest = rest.subspan(2 + length);
  }
}

/// A good packet by a short record, the next after `j` packets.
void make_packet(Bytes record, std::uint64_t& j, bool imu, std::vector<std::uint8_t>& out) {
  j += record[0];
  PacketHead head;
  head.udp_count = static_cast<std::uint16_t>(j + record[1]);
  head.time_type = static_cast<TimeType>(record[3] % 3);
  head.timestamp_ns = j * 480'000 + (record[3] & 0x80 ? std::uint64_t{1} << 60 : 0);
  if (imu) {
    out = compose_imu(head, {{1, 2, 3}, {0, 0, 1}});
  } else {
    std::vector<Point> points(kDots, Point{1, 2, 3, 4, 5});
    compose_points(static_cast<DataType>(1 + record[2] % 3), head, points, out);
  }
  for (std::size_t k = 4; k + 1 < record.size(); k += 2) out[record[k] % out.size()] = record[k + 1];
  // Changed bytes get past the checksum, too.
  if (record[2] & 0x80) std::fill(out.begin() + 24, out.begin() + 28, std::uint8_t{0});
}

void fuzz_points(std::uint8_t how, Bytes rest) {
  PointStreamOptions o;
  o.time = static_cast<packet_lidar::TimeSource>(how >> 4 & 3);
  o.frame = (how & 64) != 0 ? milliseconds(1) : Duration(777'777);
  o.drop_noise = (how & 128) != 0;
  PointStream stream(o);
  BenchTime now(0);
  std::uint64_t last = 0, j = 0;
  bool any = false;
  std::vector<std::uint8_t> made;
  each_record(rest, [&](Bytes record) {
    now = now + microseconds(480);
    if (record.size() >= 4 && record.size() <= 12) {
      make_packet(record, j, false, made);
      record = made;
    }
    stream.take(record, now, [&](const packet_lidar::Cloud& c) {
      check(c.points.size() <= stream.max_points());
      check(!any || c.sequence > last);
      last = c.sequence, any = true;
      for (const LidarPoint& p : c.points)
        check(std::isfinite(p.x_m) && std::isfinite(p.y_m) && std::isfinite(p.z_m) && p.ring < kLines &&
              p.t_offset_ns >= 0 && p.t_offset_ns < o.frame.ns());
    });
  });
  const auto& c = stream.counters();
  check(c.packets_late <= c.packets && c.noise <= c.points && c.frames_incomplete <= c.frames);
}

void fuzz_imu(std::uint8_t how, Bytes rest) {
  ImuDecoder imu({static_cast<packet_lidar::TimeSource>(how >> 4 & 3), milliseconds(5)}, std::nullopt);
  BenchTime now(0);
  std::uint64_t j = 0, last = 0;
  bool any = false;
  std::vector<std::uint8_t> made;
  each_record(rest, [&](Bytes record) {
    now = now + milliseconds(5);
    if (record.size() >= 4 && record.size() <= 12) {
      make_packet(record, j, true, made);
      record = made;
    }
    if (const auto r = imu.take(record, now)) {
      check(std::isfinite(r->imu.specific_force_mps2[0]) && (!any || r->sequence > last));
      last = r->sequence, any = true;
    }
  });
}

void fuzz_commands(Bytes rest) {
  LidarControl control({}, {}, MonotonicTime(0));
  MonotonicTime now(0);
  std::uint32_t sequence = 0;
  std::vector<std::uint8_t> made;
  each_record(rest, [&](Bytes record) {
    now = now + milliseconds(20);
    if (record.size() >= 3 && record.size() < kCommandHeaderBytes) {
      made = compose_command({++sequence, load_le<CommandId>(record, 0), false, false, record.subspan(2)});
      record = made;
    }
    for (const bool searching : {false, true}) {
      const auto reply = control.answer(record, searching, now);
      if (reply.empty()) continue;
      const auto c = parse_command(reply);
      check(c && c->answer && c->from_lidar && !c->data.empty());
    }
  });
  // Whatever was set, it is a device that its hosts understand.
  const auto pushed = control.push(now);
  const auto c = parse_command(pushed);
  check(c && parse_parameters(c->data.subspan(4), load_le<std::uint16_t>(c->data, 0)).has_value());
  const auto a = control.active(now);
  check(a.setup.data_type != DataType::imu && a.setup.data_type <= DataType::spherical);
}

void fuzz_answer(Bytes rest) {
  if (const auto c = parse_command(rest))
    check(compose_command(*c) == std::vector(rest.begin(), rest.end()) ||
          rest[12] + rest[13] + rest[14] + rest[15] + rest[16] + rest[17] > 0);
  if (const auto s = parse_search(rest)) check(s->serial.size() <= 16);
  for (const std::size_t count : {0, 1, 3})
    if (const auto list = parse_parameters(rest, count)) check(list->size() == count);
}

void fuzz_pattern(std::uint8_t how, std::string_view text) {
  auto table = models::parse_scan_pattern(text, "fuzz");
  if (!table) {
    check(!table.error().message.empty());
    return;
  }
  check(!table->firings.empty() && table->firings.front().time_ns == 0);
  if ((how & 16) != 0 && !models::set_period(*table, (how & 32) != 0 ? 1'000'000 : 0)) return;
  // Scans that are short enough for the rows of an input.
  const std::int64_t span = std::max(table->period_ns, table->firings.back().time_ns);
  const std::int64_t scan_ns = std::clamp<std::int64_t>(span / 3, 1, 2'000'000'000);
  const std::size_t most = table->max_firings(scan_ns);
  std::vector<models::PatternFiring> out;
  for (const std::uint64_t k : {std::uint64_t{0}, std::uint64_t{1}, std::uint64_t{5}, ~std::uint64_t{0}}) {
    out.clear();
    table->scan(k, scan_ns, out);
    check(out.size() <= most);
    std::int64_t last = 0;
    for (const auto& f : out) {
      check(f.time_ns >= last && f.time_ns < scan_ns && std::isfinite(f.azimuth_rad));
      last = f.time_ns;
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::uint8_t how = data[0];
  const Bytes rest(data + 1, size - 1);
  switch ((how & 15) % 5) {
    case 0:
      fuzz_points(how, rest);
      break;
    case 1:
      fuzz_imu(how, rest);
      break;
    case 2:
      fuzz_commands(rest);
      break;
    case 3:
      fuzz_answer(rest);
      break;
    default:
      fuzz_pattern(how, {reinterpret_cast<const char*>(rest.data()), rest.size()});
      break;
  }
  return 0;
}
