// Recordings of an OS1-32 (firmware 2.1.1, LEGACY) and an OS2-128 (2.3.0, RNG19_RFL8_SIG16_NIR16) and their
// digests by ouster-sdk, where the test data is present: every field of every packet, and of the scan.
//
// A digest of packets is the MD5 of a field's array, packet after packet: columns for headers, rows of
// columns for pixels, little-endian. That of a scan is the MD5 of rows of all columns of a turn.
#include <gtest/gtest.h>
#include <openssl/evp.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>

#include "drivers/network/pcap_feed.h"
#include "drivers/ouster/beam_table.h"
#include "drivers/ouster/frame_stream.h"
#include "rt-core/byte_order.h"
#include "tests/paths.h"

namespace rigor::ouster {
namespace {

std::filesystem::path folder() { return rigor::test::test_data("ouster_os"); }

class Md5 {
 public:
  Md5() : context_(EVP_MD_CTX_new(), &EVP_MD_CTX_free) {
    EVP_DigestInit_ex(context_.get(), EVP_md5(), nullptr);
  }
  template <class T>
  void add(T value) {
    std::uint8_t b[sizeof(T)];
    for (std::size_t i = 0; i < sizeof(T); ++i)
      b[i] = static_cast<std::uint8_t>(std::uint64_t{value} >> 8 * i);
    EVP_DigestUpdate(context_.get(), b, sizeof b);
  }
  std::string text() {
    unsigned char d[EVP_MAX_MD_SIZE];
    unsigned int n = 0;
    EVP_DigestFinal_ex(context_.get(), d, &n);
    std::string t;
    for (unsigned int i = 0; i < n; ++i) {
      char hex[3];
      std::snprintf(hex, sizeof hex, "%02x", d[i]);
      t += hex;
    }
    return t;
  }

 private:
  std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context_;
};

/// Each datagram of the recording that is a lidar packet.
void for_each_packet(const std::string& name, const PacketLayout& layout,
                     const std::function<void(const LidarPacket&, Bytes, RealtimeTime)>& f) {
  auto reader = network::PcapReader::open(folder() / (name + ".pcap"));
  ASSERT_TRUE(reader) << reader.error().text();
  while (true) {
    const auto record = reader->next();
    ASSERT_TRUE(record) << record.error().text();
    if (!*record) break;
    if (!(*record)->udp || (*record)->udp->destination_port != kLidarPort) continue;
    PacketFault fault{};
    const auto packet = LidarPacket::parse((*record)->udp->payload, layout, fault);
    ASSERT_TRUE(packet) << text_of(fault);
    f(*packet, (*record)->udp->payload, (*record)->t);
  }
}

class OusterDigest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(folder())) GTEST_SKIP() << "test data: no " << folder();
    name_ = GetParam();
    auto m = load_metadata(folder() / (name_ + ".json"));
    ASSERT_TRUE(m) << m.error().text();
    metadata_ = *m;
    std::ifstream in(folder() / (name_ + "_digest.json"));
    expected_ = nlohmann::json::parse(in);
  }
  std::string name_;
  Metadata metadata_;
  nlohmann::json expected_;
};

TEST_P(OusterDigest, EveryFieldOfEveryPacketIsAsOusterDecodesIt) {
  const PacketLayout layout = layout_of(metadata_);
  std::map<std::string, Md5> md5;
  int packets = 0;
  for_each_packet(name_, layout, [&](const LidarPacket& p, Bytes bytes, RealtimeTime) {
    ++packets;
    for (std::uint32_t i = 0; i < p.columns(); ++i) {
      const auto c = p.column(i);
      md5["TIMESTAMP"].add(c.timestamp_ns());
      md5["ENCODER_COUNT"].add(c.encoder());
      md5["MEASUREMENT_ID"].add(c.measurement_id());
      md5["STATUS"].add(c.status());
      // Columns carry it in the legacy profile alone; elsewhere the reference reads 0, and the packet's is in
      // the scan's.
      md5["FRAME_ID"].add(metadata_.profile == Profile::legacy ? p.frame_id() : std::uint16_t{0});
    }
    for (std::uint32_t row = 0; row < layout.pixels; ++row)
      for (std::uint32_t i = 0; i < p.columns(); ++i) {
        const auto c = p.column(i);
        const Pixel pixel = c.pixel(row);
        md5["RANGE"].add(pixel.range_mm);
        md5["SIGNAL"].add(pixel.signal);
        md5["REFLECTIVITY"].add(pixel.reflectivity);
        md5["FLAGS"].add(pixel.flags);
        md5["NEAR_IR"].add(c.near_infrared(row));
        // The bytes themselves, where pixels lie.
        for (std::size_t w = 0; w < 3; ++w)
          md5["RAW32_WORD" + std::to_string(w + 1)].add(load_le<std::uint32_t>(
              bytes, layout.header_bytes + i * layout.column_bytes + layout.column_header_bytes +
                         row * layout.pixel_bytes + 4 * w));
      }
  });
  EXPECT_EQ(packets, 64);
  for (const auto& [field, digest] : expected_["packet_hash"].items())
    EXPECT_EQ(md5[field].text(), digest.get<std::string>()) << field;
}

TEST_P(OusterDigest, EveryFieldOfTheScanIsAsOusterAssemblesIt) {
  const PacketLayout layout = layout_of(metadata_);
  ASSERT_EQ(expected_["scans"].size(), 1u);
  struct Row {
    std::vector<Pixel> pixels;
    std::vector<std::uint16_t> near_infrared;
  };
  const std::uint32_t w = metadata_.mode.columns;
  std::vector<Row> rows(layout.pixels, {std::vector<Pixel>(w), std::vector<std::uint16_t>(w)});
  std::vector<std::uint64_t> timestamp(w), status(w), encoder(w);
  std::vector<std::uint16_t> id(w);
  int frame = -1;
  for_each_packet(name_, layout, [&](const LidarPacket& p, Bytes, RealtimeTime) {
    frame = p.frame_id();
    for (std::uint32_t i = 0; i < p.columns(); ++i) {
      const auto c = p.column(i);
      if (!c.good()) continue;
      const std::uint16_t m = c.measurement_id();
      timestamp[m] = c.timestamp_ns(), status[m] = c.status(), encoder[m] = c.encoder(), id[m] = m;
      for (std::uint32_t row = 0; row < layout.pixels; ++row)
        rows[row].pixels[m] = c.pixel(row), rows[row].near_infrared[m] = c.near_infrared(row);
    }
  });
  std::map<std::string, Md5> md5;
  for (std::uint32_t m = 0; m < w; ++m) {
    md5["TIMESTAMP"].add(timestamp[m]);
    md5["STATUS"].add(status[m]);
    md5["MEASUREMENT_ID"].add(id[m]);
    md5["ENCODER_COUNT"].add(encoder[m]);
  }
  for (const Row& row : rows)
    for (std::uint32_t m = 0; m < w; ++m) {
      md5["RANGE"].add(row.pixels[m].range_mm);
      md5["SIGNAL"].add(row.pixels[m].signal);
      md5["REFLECTIVITY"].add(row.pixels[m].reflectivity);
      md5["NEAR_IR"].add(row.near_infrared[m]);
    }
  for (const auto& [field, digest] : expected_["scans"][0].items())
    EXPECT_EQ(field == "FRAME_ID" ? std::to_string(frame) : md5[field].text(), digest.get<std::string>())
        << field;
}

/// The same digests by what channels of images hand on: columns back where they were measured.
TEST_P(OusterDigest, TheImagesOfTheFrameAreThoseThatOusterAssembles) {
  const std::uint32_t w = metadata_.mode.columns, rows = metadata_.pixels_per_column;
  const auto digest_of = [&](Field field, const std::function<void(Md5&, Bytes, std::size_t)>& add) {
    ImageOptions image{.field = field};
    FrameStream stream(metadata_, {.time = packet_lidar::TimeSource::fixed, .image = image});
    Md5 md5;
    int frames = 0;
    for_each_packet(name_, layout_of(metadata_), [&](const LidarPacket&, Bytes bytes, RealtimeTime t) {
      stream.take(bytes, BenchTime(t.ns()), [&](const packet_lidar::Cloud& c) {
        ++frames;
        for (std::uint32_t row = 0; row < rows; ++row)
          for (std::uint32_t m = 0; m < w; ++m) {
            const auto x = (m + w + static_cast<std::uint32_t>(metadata_.pixel_shift[row])) % w;
            add(md5, c.pixels, std::size_t{row} * w + x);
          }
      });
    });
    EXPECT_EQ(frames, 1);
    return md5.text();
  };
  const auto& scan = expected_["scans"][0];
  const auto word16 = [](Md5& md5, Bytes b, std::size_t at) { md5.add(load_le<std::uint16_t>(b, 2 * at)); };
  EXPECT_EQ(digest_of(Field::signal, word16), scan["SIGNAL"].get<std::string>());
  EXPECT_EQ(digest_of(Field::near_infrared, word16), scan["NEAR_IR"].get<std::string>());
  EXPECT_EQ(digest_of(Field::reflectivity,
                      [](Md5& md5, Bytes b, std::size_t at) {
                        md5.add(static_cast<std::uint8_t>(load_le<std::uint16_t>(b, 2 * at)));
                      }),
            scan["REFLECTIVITY"].get<std::string>());
  EXPECT_EQ(
      digest_of(Field::range,
                [](Md5& md5, Bytes b, std::size_t at) {
                  const float range = load_le<float>(b, 4 * at);
                  md5.add(std::isnan(range) ? 0U : static_cast<std::uint32_t>(std::lround(range * 1e3F)));
                }),
      scan["RANGE"].get<std::string>());
}

TEST_P(OusterDigest, ThePointsOfTheFrameAreThoseOfTheClosedForm) {
  const PacketLayout layout = layout_of(metadata_);
  FrameStream stream(metadata_, {.time = packet_lidar::TimeSource::fixed});
  // By the manual's formula, with the angles as they stand in the metadata.
  const auto closed_form = [&](std::uint32_t m, std::uint32_t row, double range_m) {
    const double degree = M_PI / 180;
    const double e = 2 * M_PI * (1 - static_cast<double>(m) / metadata_.mode.columns);
    const double c = e - metadata_.beam_azimuth_deg[row] * degree,
                 b = metadata_.beam_altitude_deg[row] * degree;
    const double n = metadata_.beam_origin_m, r = range_m - n;
    const double p[4] = {r * std::cos(b) * std::cos(c) + n * std::cos(e),
                         r * std::cos(b) * std::sin(c) + n * std::sin(e), r * std::sin(b), 1};
    std::array<double, 3> out{};
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t k = 0; k < 4; ++k) out[i] += metadata_.T_sensor_lidar[4 * i + k] * p[k];
    return out;
  };
  std::vector<std::array<double, 3>> expected;
  std::vector<std::int64_t> offsets;
  std::uint64_t first_ns = 0;
  std::size_t clouds = 0;
  for_each_packet(name_, layout, [&](const LidarPacket& p, Bytes bytes, RealtimeTime t) {
    for (std::uint32_t i = 0; i < p.columns(); ++i) {
      const auto c = p.column(i);
      if (!c.good()) continue;
      if (first_ns == 0) first_ns = c.timestamp_ns();
      for (std::uint32_t row = 0; row < layout.pixels; ++row)
        if (const Pixel pixel = c.pixel(row); pixel.range_mm != 0) {
          expected.push_back(closed_form(c.measurement_id(), row, pixel.range_mm * 1e-3));
          offsets.push_back(static_cast<std::int64_t>(c.timestamp_ns() - first_ns));
        }
    }
    stream.take(bytes, BenchTime(t.ns()), [&](const packet_lidar::Cloud& cloud) {
      ++clouds;
      EXPECT_EQ(cloud.validity, 0u);
      EXPECT_EQ(cloud.t_capture.ns(), static_cast<std::int64_t>(first_ns));
      ASSERT_EQ(cloud.points.size(), expected.size());
      for (std::size_t k = 0; k < expected.size(); ++k) {
        const LidarPoint& q = cloud.points[k];
        // Rounded to float once: half a step, 2^-24 of the value; the formulas in double differ by far less.
        for (const auto& [got, exact] :
             {std::pair{q.x_m, expected[k][0]}, {q.y_m, expected[k][1]}, {q.z_m, expected[k][2]}})
          ASSERT_NEAR(got, exact, 1e-9 + std::abs(exact) * 0x1p-23) << k;
        ASSERT_EQ(q.t_offset_ns, offsets[k]);
      }
    });
  });
  EXPECT_EQ(clouds, 1u) << "the frame is whole, and handed on with its last packet";
  EXPECT_GT(expected.size(), 10'000u);
  EXPECT_EQ(stream.counters().packets, 64u);
  EXPECT_EQ(stream.counters().packets_lost, 0u);
}

INSTANTIATE_TEST_SUITE_P(Recordings, OusterDigest,
                         testing::Values("OS-1-32-G_v2.1.1_1024x10", "OS-2-128-U1_v2.3.0_1024x10"),
                         [](const auto& which) {
                           return which.index == 0 ? "legacy_OS1_32" : "single_OS2_128";
                         });

}  // namespace
}  // namespace rigor::ouster
