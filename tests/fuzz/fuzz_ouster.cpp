// What an Ouster's ports, its HTTP interface and a recording's frames can hold. Input: a byte whose lower
// four bits say which (modulo 6), then for 0 records of `length:16 bytes` as datagrams of one stream
// (profile, window and time by the byte's upper bits; a record of 4 to 15 bytes makes a good packet, to be
// changed), for 1 metadata, for 2 IMU packets, for 3 fragments of captured frames as such records, for 4 a
// request to an emulated sensor, for 5 a stream of HTTP. Of a stream, 0 makes points, 6 images and 12 range
// images.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <vector>

#include "drivers/network/http.h"
#include "drivers/network/udp_frame.h"
#include "drivers/ouster/frame_stream.h"
#include "drivers/ouster/imu_stream.h"
#include "drivers/ouster/sensor_control.h"
#include "rt-core/byte_order.h"
#include "tests/drivers/ouster/made_sensor.h"

using namespace rigor;
using namespace rigor::ouster;

namespace {

void check(bool holds) {
  if (!holds) std::abort();
}

/// Small frames, so that a few packets are one.
Metadata small_sensor(std::uint8_t how) {
  Metadata m = ouster::test::made_metadata(kProfiles[how >> 4 & 3], {64, 10});
  m.pixels_per_column = 4;
  m.beam_altitude_deg.resize(4);
  m.beam_azimuth_deg.resize(4);
  m.columns_per_packet = 4;
  m.initialization_id = (how & 64) != 0 ? 1 : 0;
  if ((how & 128) != 0) m.window = {50, 10};
  return m;
}

/// Each profile with another field.
std::optional<ImageOptions> image_of(std::uint8_t how) {
  if ((how & 15) < 6) return {};
  ImageOptions o{.field = (how & 15) >= 12 ? Field::range : static_cast<Field>((how >> 4 & 3) % 3)};
  if ((how & 128) != 0) o.format = PixelFormat::mono8;
  return o;
}

struct Stream {
  Metadata metadata;
  FrameStream frames;
  LidarPacketWriter writer;
  explicit Stream(std::uint8_t how)
      : metadata(small_sensor(how)),
        frames(metadata, {.time = static_cast<packet_lidar::TimeSource>(how >> 6 & 3),
                          .image = image_of(how),
                          .this_initialization_only = (how & 64) != 0}),
        writer(layout_of(metadata)) {}
};

void fuzz_stream(std::uint8_t how, Bytes rest) {
  static std::unique_ptr<Stream> streams[3][16];
  auto& stream = streams[(how & 15) / 6][how >> 4];
  if (!stream) stream = std::make_unique<Stream>(how);
  stream->frames.reset();
  const FrameImage* image = stream->frames.image();
  const std::size_t most = image ? 0 : FrameStream::max_points(stream->metadata);
  BenchTime now(0);
  std::uint64_t last = 0;
  bool any = false;
  std::vector<std::uint8_t> made;
  while (rest.size() >= 2) {
    const std::size_t length = std::min<std::size_t>(rest[0] | rest[1] << 8, rest.size() - 2);
    Bytes record = rest.subspan(2, length);
    now = now + microseconds(1500);
    if (length >= 4 && length < 16) {
      // frame, slot, and bytes of a good packet that are others.
      stream->writer.set_header(record[0], 1, 1);
      for (std::uint32_t i = 0; i < 4; ++i) {
        const auto id = static_cast<std::uint16_t>(record[1] % 16 * 4 + i);
        stream->writer.set_column(i, static_cast<std::uint64_t>(now.ns()), id, true);
        for (std::uint32_t row = 0; row < 4; ++row)
          stream->writer.set_pixel(i, row, {1000 + row * 8, 1, 2, 0});
      }
      made.assign(stream->writer.bytes().begin(), stream->writer.bytes().end());
      for (std::size_t k = 2; k + 1 < length; k += 2) made[record[k] % made.size()] = record[k + 1];
      record = made;
    }
    stream->frames.take(record, now, [&](const packet_lidar::Cloud& c) {
      check(c.points.size() <= most && c.pixels.size() == (image ? image->bytes().size() : 0));
      if (image && image->options().field == Field::range)
        for (std::size_t at = 0; at < c.pixels.size(); at += sizeof(float))
          check(!std::isinf(load_le<float>(c.pixels, at)));
      check(!any || c.sequence > last);
      last = c.sequence, any = true;
      for (const LidarPoint& p : c.points)
        check(std::isfinite(p.x_m) && std::isfinite(p.y_m) && std::isfinite(p.z_m) && p.ring < 4 &&
              p.return_index < 2);
    });
    rest = rest.subspan(2 + length);
  }
  const auto& c = stream->frames.counters();
  check(c.packets_late <= c.packets);
}

void fuzz_fragments(std::uint8_t how, Bytes rest) {
  const int links[] = {network::kLinkNull, network::kLinkEthernet, network::kLinkRaw, network::kLinkSll};
  network::UdpReassembler whole(links[how >> 4 & 3]);
  std::int64_t t = 0;
  while (rest.size() >= 2) {
    const std::size_t length = std::min<std::size_t>(rest[0] | rest[1] << 8, rest.size() - 2);
    if (const auto d = whole.take(rest.subspan(2, length), RealtimeTime(t += 1'000'000))) {
      std::uint32_t sum = 0;
      for (const std::uint8_t b : d->payload) sum += b;  // each byte is there
      check(d->payload.size() <= 65'535 && sum <= 255 * 65'535U);
    }
    rest = rest.subspan(2 + length);
  }
  const auto& c = whole.counters();
  check(c.datagrams + c.given_up <= c.fragments);
}

struct Device {
  SensorDevice device = SensorDevice::create(std::make_shared<ouster::test::FormulaLidar>()).value();
};

void fuzz_control(std::string_view text) {
  static Device device;
  // A sensor as from the factory; made anew, which takes longest, after an input that changed it.
  static std::optional<SensorControl> sensor;
  if (!sensor) sensor.emplace(SensorControl::create(device.device, {}, "{}", MonotonicTime(0)).value());
  SensorControl& control = *sensor;
  const std::uint64_t generation = control.active().generation;
  const std::size_t line = text.find('\n');
  const std::string_view first = text.substr(0, line), body = line == text.npos ? "" : text.substr(line + 1);
  const auto get = control.http("GET", first, "", "10.0.0.1", MonotonicTime(1));
  check(get.status == 200 || get.status == 400 || get.status == 404);
  const auto post = control.http("POST", "/api/v1/sensor/config", body, "10.0.0.1", MonotonicTime(2));
  check(post.status == 200 || post.status == 400);
  const std::string answer = control.tcp(first, "10.0.0.1", MonotonicTime(3));
  check(!answer.empty());
  // Whatever was set, the sensor is one that its own client understands.
  if (control.active().generation != generation) {
    const auto metadata = control.http("GET", "/api/v1/sensor/metadata", "", "", MonotonicTime(4));
    check(metadata.status == 200 && parse_metadata(metadata.body, "own").has_value());
  }
  const bool kept = get.status != 200 && post.status != 200 && answer.rfind("error:", 0) == 0;
  if (!kept) sensor.reset();
}

void fuzz_http(std::string_view text) {
  static const network::TcpServer::Serve serve =
      network::http_server([](const network::HttpRequest& r, std::string_view) {
        return network::HttpReply{200, r.target};
      });
  network::TcpServer::Client client;
  client.address = "10.0.0.1";
  // In two pieces.
  for (const std::string_view piece : {text.substr(0, text.size() / 2), text.substr(text.size() / 2)}) {
    if (client.close) break;
    client.in += piece;
    serve(client);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::uint8_t how = data[0];
  const Bytes rest(data + 1, size - 1);
  const std::string_view text(reinterpret_cast<const char*>(rest.data()), rest.size());
  switch ((how & 15) % 6) {
    case 0:
      fuzz_stream(how, rest);
      break;
    case 1:
      if (const auto m = parse_metadata(text, "fuzz")) {
        check(m->beam_altitude_deg.size() == m->pixels_per_column && m->window.last < m->mode.columns);
        check(layout_of(*m).packet_bytes > 0 && m->window_columns() >= 1 &&
              m->window_columns() <= m->mode.columns);
      }
      break;
    case 2: {
      ImuStream imu({packet_lidar::TimeSource::device, Duration(0), milliseconds(10)});
      for (std::size_t at = 0; at + kImuBytes <= rest.size(); at += kImuBytes)
        if (const auto r =
                imu.take(rest.subspan(at, kImuBytes), BenchTime(static_cast<std::int64_t>(at) * 1'000'000)))
          check(std::isfinite(r->imu.specific_force_mps2[0]));
      (void)imu.take(rest, BenchTime(0));
      break;
    }
    case 3:
      fuzz_fragments(how, rest);
      break;
    case 4:
      fuzz_control(text);
      break;
    default:
      fuzz_http(text);
      break;
  }
  return 0;
}
