#include "drivers/velodyne/packet_decoder.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <numbers>

#include "drivers/velodyne/calibration_file.h"
#include "tests/drivers/velodyne/made_packets.h"

namespace rigor::velodyne {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

std::unique_ptr<DecodedPacket> decode(const DataPacketWriter& w, Model model, const Calibration& calibration,
                                      RingOrder rings = RingOrder::laser) {
  auto decoder = PacketDecoder::create(model, calibration, rings);
  EXPECT_TRUE(decoder);
  PacketFault fault{};
  const auto packet = DataPacket::parse(w.bytes(), fault);
  EXPECT_TRUE(packet) << text_of(fault);
  auto out = std::make_unique<DecodedPacket>();
  decoder->decode(*packet, *out);
  return out;
}

TEST(VelodyneDecoder, PutsEachLaserWhereItPointedWhenItFired) {
  for (const Model model : {Model::vlp16, Model::hdl32e}) {
    const DeviceFacts& f = facts_of(model);
    const test::Rotor rotor{.model = model, .rotation_hz = 10, .azimuth_deg = 359.5};
    const auto w = rotor.packet(0, [](std::uint32_t firing) {
      return DataPacket::Return{static_cast<std::uint16_t>(5000 + firing), 7};
    });
    const Calibration c = factory_calibration(model);
    const auto out = decode(w, model, c);
    ASSERT_EQ(out->point_count, kMaxReturns);
    ASSERT_EQ(out->sequence_count, f.sequences_per_packet(false));
    for (std::uint32_t i = 0; i < out->point_count; ++i) {
      const std::uint32_t sequence = i / f.lasers, laser = i % f.lasers;
      const LidarPoint& p = out->points[i];
      const std::int64_t t = sequence * f.sequence_ns + laser * f.laser_ns;
      EXPECT_EQ(p.t_offset_ns, t);
      EXPECT_EQ(p.ring, laser);
      const double range = (5000 + i) * 0.002, e = c.lasers[laser].elevation_rad;
      const double a = -(359.5 + 3600.0 * static_cast<double>(t) * 1e-9) * kDegree;
      // The packet's azimuths are rounded to 0.01 degrees, and so is the rate: 10 m · 1.5e-4 rad.
      ASSERT_NEAR(p.x_m, range * std::cos(e) * std::cos(a), 3e-3) << f.name << " " << i;
      ASSERT_NEAR(p.y_m, range * std::cos(e) * std::sin(a), 3e-3) << f.name << " " << i;
      ASSERT_NEAR(p.z_m, range * std::sin(e) + c.lasers[laser].vertical_offset_m, 2e-6);
      ASSERT_EQ(p.remission, 7);
    }
  }
}

TEST(VelodyneDecoder, RingsCountLasersOrElevations) {
  const Calibration c = factory_calibration(Model::vlp16);
  const test::Rotor rotor{};
  const auto w = rotor.packet(0, [](std::uint32_t) { return DataPacket::Return{500, 1}; });
  const auto out = decode(w, Model::vlp16, c, RingOrder::elevation);
  float last = -1e9F;
  for (std::uint16_t ring = 0; ring < 16; ++ring)
    for (std::uint32_t i = 0; i < 16; ++i)
      if (out->points[i].ring == ring) {
        EXPECT_GT(out->points[i].z_m, last);
        last = out->points[i].z_m;
      }
  EXPECT_EQ(out->points[0].ring, 0);
  EXPECT_EQ(out->points[1].ring, 8);  // +1 degree
}

TEST(VelodyneDecoder, DualReturnsComeOnceWhereTheyAreOne) {
  DataPacketWriter w;
  for (std::size_t b = 0; b < kBlocks; ++b) w.set_azimuth(b, static_cast<std::uint32_t>(100 + 40 * (b / 2)));
  w.set(0, 0, {1000, 10}), w.set(1, 0, {800, 90});   // last, strongest
  w.set(0, 1, {1000, 10}), w.set(1, 1, {1000, 10});  // one return
  w.set(2, 5, {700, 20});                            // in one block alone
  w.finish(0, ReturnMode::dual, 0x22);
  const auto out = decode(w, Model::vlp16, factory_calibration(Model::vlp16));
  ASSERT_EQ(out->point_count, 4u);
  EXPECT_EQ(out->points[0].return_index, 0);
  EXPECT_EQ(out->points[0].remission, 90);
  EXPECT_EQ(out->points[1].return_index, 1);
  EXPECT_EQ(out->points[1].remission, 10);
  EXPECT_EQ(out->points[2].return_index, 0);
  EXPECT_EQ(out->points[3].return_index, 0);
  EXPECT_EQ(out->points[3].t_offset_ns, 2 * 55'296 + 5 * 2'304) << "blocks 2 and 3 fire after blocks 0 and 1";
  EXPECT_EQ(out->sequence_count, 12u);
}

TEST(VelodyneDecoder, LeavesOutASectorWithoutSmearingIt) {
  DataPacketWriter w;
  const std::uint32_t azimuths[] = {100, 140, 180, 220, 9000, 9040, 9080, 9120, 9160, 9200, 9240, 9280};
  for (std::size_t b = 0; b < kBlocks; ++b) w.set_azimuth(b, azimuths[b]);
  w.finish(0, ReturnMode::strongest, 0x22);
  const auto out = decode(w, Model::vlp16, factory_calibration(Model::vlp16));
  EXPECT_NEAR(out->sequences[7].azimuth_cdeg, 240, 0.1)
      << "the second sequence of the last block before the gap";
  EXPECT_NEAR(out->sequences[9].azimuth_cdeg, 9020, 0.1);
}

TEST(VelodyneDecoder, AppliesACalibration) {
  Calibration c = factory_calibration(Model::vlp16);
  c.lasers[0] = {.elevation_rad = 0.1,
                 .azimuth_rad = 0.02,
                 .range_correction_m = 0.3,
                 .vertical_offset_m = 0.01,
                 .horizontal_offset_m = 0.05,
                 .min_intensity = 20,
                 .max_intensity = 100};
  DataPacketWriter w;
  for (std::size_t b = 0; b < kBlocks; ++b) w.set_azimuth(b, 0);
  w.set(0, 0, {1000, 3}), w.set(1, 0, {1000, 203});
  w.finish(0, ReturnMode::strongest, 0x22);
  const auto out = decode(w, Model::vlp16, c);
  const double r = 2.3;
  EXPECT_NEAR(out->points[0].x_m, r * std::cos(0.1) * std::cos(0.02) - 0.05 * std::sin(0.02), 1e-6);
  EXPECT_NEAR(out->points[0].y_m, r * std::cos(0.1) * std::sin(0.02) + 0.05 * std::cos(0.02), 1e-6);
  EXPECT_NEAR(out->points[0].z_m, r * std::sin(0.1) + 0.01, 1e-6);
  EXPECT_EQ(out->points[0].remission, 20);
  EXPECT_EQ(out->points[1].remission, 100);
}

TEST(ModelEvidence, ToldByTimeAndNotByTheProductByte) {
  for (const Model model : {Model::vlp16, Model::hdl32e})
    for (const bool dual : {false, true}) {
      ModelEvidence e;
      const test::Rotor rotor{.model = model, .dual = dual, .product = 0x21};
      for (std::uint32_t k = 0; k < 20; ++k) {
        const auto w = rotor.packet(k, [](std::uint32_t) { return DataPacket::Return{1, 1}; });
        PacketFault fault{};
        e.add(*DataPacket::parse(w.bytes(), fault));
      }
      ASSERT_TRUE(e.model()) << facts_of(model).name << (dual ? " dual" : "");
      EXPECT_EQ(*e.model(), model);
    }
}

// ------------------------------------------------------------------------------------------- calibration
// files

std::string yaml_for(int lasers, const std::string& of_laser_3 = "") {
  std::string s = "lasers:\n";
  for (int i = 0; i < lasers; ++i)
    s += "- {dist_correction: 0.0, dist_correction_x: 0.0, dist_correction_y: 0.0, focal_distance: 0.0,\n"
         "  focal_slope: 0.0, horiz_offset_correction: 0.0, laser_id: " +
         std::to_string(i) + ", rot_correction: 0.0,\n  vert_correction: " + std::to_string(i * 0.01) +
         ", vert_offset_correction: 0.0112" + (i == 3 ? of_laser_3 : "") + "}\n";
  return s + "num_lasers: 16\ndistance_resolution: 0.002\n";
}

TEST(CalibrationFile, OfTheRosDriverIsRead) {
  const auto c = parse_calibration(yaml_for(16), "db.yaml", Model::vlp16);
  ASSERT_TRUE(c) << c.error().text();
  EXPECT_NEAR(c->lasers[7].elevation_rad, 0.07, 1e-12);
  EXPECT_NEAR(c->lasers[7].vertical_offset_m, 0.0112, 1e-12);
}

TEST(CalibrationFile, SaysInWhichLineItIsWrong) {
  const auto where = [](const std::string& text, Model model = Model::vlp16) {
    const auto c = parse_calibration(text, "db.yaml", model);
    return c ? std::string("no error") : c.error().text();
  };
  // Laser 3 begins in line 11 and ends in line 13.
  EXPECT_NE(where(yaml_for(16, ", min_intensity: lots")).find("db.yaml:13:"), std::string::npos)
      << where(yaml_for(16, ", min_intensity: lots"));
  EXPECT_NE(where(yaml_for(16, ", vert_corection: 1")).find("vert_corection: unknown key"), std::string::npos)
      << where(yaml_for(16, ", vert_corection: 1"));
  EXPECT_NE(where(yaml_for(15)).find("none with laser_id 15"), std::string::npos) << where(yaml_for(15));
  EXPECT_NE(where(yaml_for(16), Model::hdl32e).find("expected 32"), std::string::npos);
  EXPECT_NE(where(yaml_for(16, ", two_pt_correction_available: true")).find("HDL-64E"), std::string::npos);
}

std::string xml_for(int lasers, const std::string& elevation_of_2 = "-13") {
  std::string s =
      "<?xml version=\"1.0\"?>\n<!-- a comment -->\n<boost_serialization><DB "
      "class_id=\"0\">\n<distLSB_>0.2</distLSB_>\n<points_>\n";
  for (int i = 0; i < lasers; ++i)
    s += "<item><px><id_>" + std::to_string(i) +
         "</id_><rotCorrection_>1.5</rotCorrection_>\n<vertCorrection_>" +
         (i == 2 ? elevation_of_2 : std::to_string(i)) +
         "</vertCorrection_><distCorrection_>12</distCorrection_><vertOffsetCorrection_>1.12</"
         "vertOffsetCorrection_>"
         "<horizOffsetCorrection_>-2.6</horizOffsetCorrection_></px></item>\n";
  return s +
         "</points_><minIntensity_><count>2</count><item>5</item><item>6</item></minIntensity_>\n</DB></"
         "boost_serialization>\n";
}

TEST(CalibrationFile, OfVeloViewIsRead) {
  const auto c = parse_calibration(xml_for(16), "db.xml", Model::vlp16);
  ASSERT_TRUE(c) << c.error().text();
  EXPECT_NEAR(c->lasers[2].elevation_rad, -13 * kDegree, 1e-12);
  EXPECT_NEAR(c->lasers[2].azimuth_rad, 1.5 * kDegree, 1e-12);
  EXPECT_NEAR(c->lasers[2].range_correction_m, 0.12, 1e-12);
  EXPECT_NEAR(c->lasers[2].horizontal_offset_m, -0.026, 1e-12);
  EXPECT_EQ(c->lasers[1].min_intensity, 6);
  EXPECT_NEAR(c->range_unit_m, 0.002, 1e-12);
  const auto bad = parse_calibration(xml_for(16, "steep"), "db.xml", Model::vlp16);
  ASSERT_FALSE(bad);
  EXPECT_NE(bad.error().text().find("db.xml:11:"), std::string::npos) << bad.error().text();
  EXPECT_NE(bad.error().text().find("steep"), std::string::npos);
  EXPECT_FALSE(parse_calibration(xml_for(15), "db.xml", Model::vlp16));
  EXPECT_FALSE(parse_calibration(xml_for(16).substr(0, 700), "db.xml", Model::vlp16));
}

}  // namespace
}  // namespace rigor::velodyne
