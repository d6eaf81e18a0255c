// Packets of every profile, byte by byte and there and back; metadata in both of their forms, and what is
// wrong with others. Recordings of real sensors are in digest_test.cpp.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>

#include "drivers/ouster/beam_table.h"
#include "drivers/ouster/lidar_packet.h"
#include "rt-core/byte_order.h"
#include "tests/drivers/ouster/made_sensor.h"

namespace rigor::ouster {
namespace {

using nlohmann::json;
using test::made_metadata;

class EveryProfile : public testing::TestWithParam<Profile> {};

TEST_P(EveryProfile, WhatIsWrittenIsRead) {
  const Metadata m = made_metadata(GetParam());
  const PacketLayout layout = layout_of(m);
  const bool low = GetParam() == Profile::low_data, dual = GetParam() == Profile::dual;
  LidarPacketWriter w(layout);
  w.set_header(65'535, 0xABCDEF, 992'000'000'001);
  for (std::uint32_t i = 0; i < 16; ++i) {
    w.set_column(i, 0x0123'4567'89AB'0000 + i, static_cast<std::uint16_t>(496 + i), i != 3);
    for (std::uint32_t row = 0; row < layout.pixels; ++row) {
      w.set_pixel(i, row,
                  {8 * (100 * i + row), static_cast<std::uint16_t>(40'000 + row),
                   static_cast<std::uint8_t>(200 + i), 1});
      if (dual) w.set_pixel(i, row, {8 * (200 * i + row), 7, 8, 9}, 1);
      w.set_near_infrared(i, row, static_cast<std::uint16_t>(16 * row));
    }
  }
  PacketFault fault{};
  const auto p = LidarPacket::parse(w.bytes(), layout, fault);
  ASSERT_TRUE(p) << text_of(fault);
  EXPECT_EQ(p->frame_id(), 65'535);
  EXPECT_EQ(p->initialization_id(), GetParam() == Profile::legacy ? 0u : 0xABCDEFu);
  for (std::uint32_t i = 0; i < 16; ++i) {
    const auto c = p->column(i);
    EXPECT_EQ(c.timestamp_ns(), 0x0123'4567'89AB'0000 + i);
    EXPECT_EQ(c.measurement_id(), 496 + i);
    EXPECT_EQ(c.encoder(), GetParam() == Profile::legacy ? (496 + i) * 90112 / 512 : 0);
    EXPECT_EQ(c.good(), i != 3);
    for (std::uint32_t row = 0; row < layout.pixels; ++row) {
      EXPECT_EQ(c.pixel(row), (Pixel{8 * (100 * i + row), static_cast<std::uint16_t>(low ? 0 : 40'000 + row),
                                     static_cast<std::uint8_t>(200 + i), 1}));
      if (dual) {
        EXPECT_EQ(c.pixel(row, 1), (Pixel{8 * (200 * i + row), 7, 8, 9}));
      }
      EXPECT_EQ(c.near_infrared(row), 16 * row);
    }
  }
}
INSTANTIATE_TEST_SUITE_P(Ouster, EveryProfile, testing::ValuesIn(kProfiles),
                         [](const auto& which) { return std::string(name_of(which.param)); });

TEST(OusterPacket, HasTheSizesOfTheManual) {
  const auto bytes = [](Profile profile, std::uint32_t beams) {
    Metadata m = made_metadata(profile);
    m.pixels_per_column = beams;
    return layout_of(m).packet_bytes;
  };
  EXPECT_EQ(bytes(Profile::legacy, 64), 12'608u);
  EXPECT_EQ(bytes(Profile::legacy, 128), 24'896u);
  EXPECT_EQ(bytes(Profile::single, 128), 24'832u);
  EXPECT_EQ(bytes(Profile::dual, 128), 33'024u);
  EXPECT_EQ(bytes(Profile::low_data, 128), 8'448u);
}

TEST(OusterPacket, LiesInItsBytesAsTheManualSays) {
  const PacketLayout layout = layout_of(made_metadata(Profile::low_data));
  LidarPacketWriter w(layout);
  w.set_header(0x0102, 0x030405, 0x0607080900);
  w.set_column(1, 0x1122334455667788, 0x01FF, true);
  w.set_pixel(1, 2, {8 * 0x1234, 0, 0x56, 1});
  w.set_near_infrared(1, 2, 0x78 << 4);
  const Bytes b = w.bytes();
  EXPECT_EQ(b[0], 1);
  EXPECT_EQ(b[2], 0x02);
  EXPECT_EQ(b[3], 0x01);
  EXPECT_EQ(b[4], 0x05);
  EXPECT_EQ(b[6], 0x03);
  EXPECT_EQ(b[7], 0x00);
  EXPECT_EQ(b[8], 0x09);
  EXPECT_EQ(b[11], 0x06);
  const std::size_t column = 32 + layout.column_bytes, pixel = column + 12 + 2 * 4;
  EXPECT_EQ(b[column], 0x88);
  EXPECT_EQ(b[column + 8], 0xFF);
  EXPECT_EQ(b[column + 9], 0x01);
  EXPECT_EQ(b[column + 10], 1);
  EXPECT_EQ(b[pixel], 0x34);
  EXPECT_EQ(b[pixel + 1], 0x12 | 0x80);
  EXPECT_EQ(b[pixel + 2], 0x56);
  EXPECT_EQ(b[pixel + 3], 0x78);
}

/// The bytes of a pixel of each profile, from the tables of the manual's chapter on data packets: what reader
/// and writer got wrong alike would show nowhere else without a recording of a sensor.
TEST(OusterPacket, EachProfileHasItsFieldsWhereTheManualHasThem) {
  const auto pixel = [](Profile profile) {
    const PacketLayout layout = layout_of(made_metadata(profile));
    LidarPacketWriter w(layout);
    w.set_column(0, 0, 0, true);
    w.set_pixel(0, 0, {0x12340, 0x789A, 0x56, 1});
    if (profile == Profile::dual) w.set_pixel(0, 0, {0x23450, 0x6789, 0x67, 2}, 1);
    w.set_near_infrared(0, 0, 0x0BC0);
    const Bytes b = w.bytes().subspan(layout.header_bytes + layout.column_header_bytes, layout.pixel_bytes);
    return std::vector<int>(b.begin(), b.end());
  };
  // Range and flags; reflectivity; signal; near infrared.
  EXPECT_EQ(pixel(Profile::legacy),
            (std::vector<int>{0x40, 0x23, 0x01, 0x10, 0x56, 0, 0x9A, 0x78, 0xC0, 0x0B, 0, 0}));
  EXPECT_EQ(pixel(Profile::single),
            (std::vector<int>{0x40, 0x23, 0x01 | 1 << 3, 0, 0x56, 0, 0x9A, 0x78, 0xC0, 0x0B, 0, 0}));
  // Range, flags and reflectivity of one return, of the other, both signals, near infrared.
  EXPECT_EQ(pixel(Profile::dual),
            (std::vector<int>{0x40, 0x23, 0x01 | 1 << 3, 0x56, 0x50, 0x34, 0x02 | 2 << 3, 0x67, 0x9A, 0x78,
                              0x89, 0x67, 0xC0, 0x0B, 0, 0}));
  // Range in 8 mm with a flag on top, reflectivity, near infrared in 16.
  EXPECT_EQ(pixel(Profile::low_data), (std::vector<int>{0x68, 0x24 | 0x80, 0x56, 0xBC}));
}

TEST(OusterPacket, AnImuPacketHasItsFieldsWhereTheManualHasThem) {
  const auto b = compose_imu({0x0102, 0x0304, 0x0506, {1, 2, 4}, {-1, -2, -4}});
  EXPECT_EQ(load_le<std::uint64_t>(b, 0), 0x0102U) << "since the sensor started";
  EXPECT_EQ(load_le<std::uint64_t>(b, 8), 0x0304U) << "of the acceleration";
  EXPECT_EQ(load_le<std::uint64_t>(b, 16), 0x0506U) << "of the turn rate";
  for (std::size_t axis = 0; axis < 3; ++axis) {
    EXPECT_EQ(load_le<float>(b, 24 + 4 * axis), static_cast<float>(1 << axis)) << "acceleration, g";
    EXPECT_EQ(load_le<float>(b, 36 + 4 * axis), -static_cast<float>(1 << axis)) << "turn rate, degrees/s";
  }
}

TEST(OusterPacket, ARangeThatDoesNotFitIsNoReturn) {
  for (const auto& [profile, fits, beyond] :
       {std::tuple{Profile::legacy, 0xFFFFFU, 0x100000U}, std::tuple{Profile::single, 0x7FFFFU, 0x80000U},
        std::tuple{Profile::low_data, 0x7FFFU * 8, 0x8000U * 8}}) {
    const PacketLayout layout = layout_of(made_metadata(profile));
    LidarPacketWriter w(layout);
    w.set_header(1, 2, 3);
    w.set_column(0, 0, 0, true);
    w.set_pixel(0, 0, {fits, 1, 2, 0});
    w.set_pixel(0, 1, {beyond, 1, 2, 0});
    PacketFault fault{};
    const auto p = LidarPacket::parse(w.bytes(), layout, fault);
    ASSERT_TRUE(p);
    EXPECT_EQ(p->column(0).pixel(0).range_mm, fits) << name_of(profile);
    EXPECT_EQ(p->column(0).pixel(1), Pixel{}) << name_of(profile);
  }
}

TEST(OusterPacket, ARangeIsRoundedToTheStepsOfItsProfile) {
  const PacketLayout layout = layout_of(made_metadata(Profile::low_data));
  LidarPacketWriter w(layout);
  w.set_header(1, 2, 3);
  w.set_column(0, 0, 0, true);
  for (const auto& [row, mm] : {std::pair{0U, 11U}, {1U, 12U}, {2U, 19U}}) w.set_pixel(0, row, {mm, 0, 1, 0});
  PacketFault fault{};
  const auto p = LidarPacket::parse(w.bytes(), layout, fault);
  ASSERT_TRUE(p);
  EXPECT_EQ(p->column(0).pixel(0).range_mm, 8U);
  EXPECT_EQ(p->column(0).pixel(1).range_mm, 16U);
  EXPECT_EQ(p->column(0).pixel(2).range_mm, 16U);
}

TEST(OusterPacket, AColumnIsGoodByItsBitAlone) {
  for (const auto& [profile, good, other] : {std::tuple{Profile::single, 0x0001U, 0x0002U},
                                             std::tuple{Profile::legacy, 0xFFFFFFFFU, 0xFFFFFFFEU}}) {
    const PacketLayout layout = layout_of(made_metadata(profile));
    LidarPacketWriter w(layout);
    w.set_header(7, 2, 3);
    for (std::uint32_t i = 0; i < 16; ++i) w.set_column(i, 0, static_cast<std::uint16_t>(i), true);
    std::vector<std::uint8_t> b(w.bytes().begin(), w.bytes().end());
    const std::size_t status =
        layout.header_bytes + (profile == Profile::legacy ? layout.column_bytes - 4 : 10);
    const auto is_good = [&](std::uint32_t value) {
      if (profile == Profile::legacy)
        store_le(b, status, value);
      else
        store_le(b, status, static_cast<std::uint16_t>(value));
      PacketFault fault{};
      const auto p = LidarPacket::parse(b, layout, fault);
      return p && p->column(0).good();
    };
    EXPECT_TRUE(is_good(good)) << name_of(profile);
    EXPECT_FALSE(is_good(other)) << name_of(profile);
    EXPECT_FALSE(is_good(0)) << name_of(profile);
  }
}

TEST(OusterPacket, SaysWhatIsWrongWithOne) {
  for (const Profile profile : {Profile::legacy, Profile::single}) {
    const PacketLayout layout = layout_of(made_metadata(profile));
    LidarPacketWriter w(layout);
    w.set_header(7, 2, 3);
    for (std::uint32_t i = 0; i < 16; ++i) w.set_column(i, 0, static_cast<std::uint16_t>(i), true);
    const auto fault_with = [&](std::size_t at, std::uint8_t value) {
      std::vector<std::uint8_t> b(w.bytes().begin(), w.bytes().end());
      b[at] = value;
      PacketFault fault{};
      (void)LidarPacket::parse(b, layout, fault);
      return fault;
    };
    const std::size_t column = layout.header_bytes + layout.column_bytes;
    EXPECT_EQ(fault_with(0, 1), PacketFault::none);
    EXPECT_EQ(fault_with(column + 9, 2), PacketFault::column) << "measurement id 513 of 512";
    EXPECT_EQ(fault_with(column - layout.column_bytes + 9, 2), PacketFault::column) << "512, from 0";
    if (profile == Profile::legacy) {
      EXPECT_EQ(fault_with(column + 10, 8), PacketFault::frame);
    }
    if (profile == Profile::single) {
      EXPECT_EQ(fault_with(0, 2), PacketFault::type);
    }
    PacketFault fault{};
    EXPECT_FALSE(LidarPacket::parse(w.bytes().subspan(1), layout, fault));
    EXPECT_EQ(fault, PacketFault::size);
  }
}

TEST(OusterPacket, ImuIsReadAndWritten) {
  const ImuPacket sent{1, 2, 3, {0.1F, -0.2F, 1.0F}, {4, 5, -6}};
  auto bytes = compose_imu(sent);
  const auto got = parse_imu(bytes);
  ASSERT_TRUE(got);
  EXPECT_EQ(got->accelerometer_ns, 2u);
  EXPECT_EQ(got->acceleration_g, sent.acceleration_g);
  EXPECT_EQ(got->turn_rate_dps, sent.turn_rate_dps);
  EXPECT_FALSE(parse_imu(Bytes(bytes).first(47)));
  bytes[24 + 3] = 0x7F, bytes[24 + 2] = 0xC0;  // not a number
  EXPECT_FALSE(parse_imu(bytes));
}

json flat_form() {
  json j{{"prod_line", "OS-1-16"},
         {"prod_sn", "992000000001"},
         {"build_rev", "v2.1.1"},
         {"status", "RUNNING"},
         {"lidar_mode", "1024x10"},
         {"lidar_origin_to_beam_origin_mm", 15.806},
         {"lidar_to_sensor_transform", {-1, 0, 0, 1.5, 0, -1, 0, -2.5, 0, 0, 1, 36.18, 0, 0, 0, 1}}};
  j["data_format"] = {{"pixels_per_column", 16},
                      {"columns_per_frame", 1024},
                      {"columns_per_packet", 16},
                      {"column_window", {900, 100}}};
  for (int i = 0; i < 16; ++i)
    j["beam_altitude_angles"].push_back(15 - 2 * i), j["beam_azimuth_angles"].push_back(1.5);
  return j;
}
json nested_form() {
  const json f = flat_form();
  json format = f["data_format"];
  format["udp_profile_lidar"] = "RNG19_RFL8_SIG16_NIR16_DUAL";
  return {{"sensor_info",
           {{"prod_line", "OS-1-16"},
            {"prod_sn", "992000000001"},
            {"build_rev", "v3.1.0"},
            {"status", "RUNNING"},
            {"initialization_id", 5431293}}},
          {"config_params",
           {{"lidar_mode", "1024x10"}, {"udp_port_lidar", 17502}, {"timestamp_mode", "TIME_FROM_PTP_1588"}}},
          {"lidar_data_format", format},
          {"beam_intrinsics",
           {{"beam_altitude_angles", f["beam_altitude_angles"]},
            {"beam_azimuth_angles", f["beam_azimuth_angles"]},
            {"beam_to_lidar_transform", {1, 0, 0, 27.67, 0, 1, 0, 0, 0, 0, 1, 5.0, 0, 0, 0, 1}}}},
          {"lidar_intrinsics", {{"lidar_to_sensor_transform", f["lidar_to_sensor_transform"]}}}};
}

TEST(OusterMetadata, IsReadInTheFlatForm) {
  const auto m = parse_metadata(flat_form().dump(), "os.json");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_EQ(m->product_line, "OS-1-16");
  EXPECT_EQ(m->profile, Profile::legacy);
  EXPECT_EQ(m->mode, (LidarMode{1024, 10}));
  EXPECT_EQ(m->window, (ColumnWindow{900, 100}));
  EXPECT_EQ(m->window_columns(), 225u);
  EXPECT_TRUE(m->window.has(1000) && m->window.has(0) && !m->window.has(500));
  EXPECT_DOUBLE_EQ(m->beam_origin_m, 0.015806);
  EXPECT_DOUBLE_EQ(m->T_sensor_lidar[3], 0.0015);
  EXPECT_DOUBLE_EQ(m->T_sensor_lidar[7], -0.0025);
  EXPECT_DOUBLE_EQ(m->T_sensor_lidar[11], 0.03618);
  EXPECT_DOUBLE_EQ(m->beam_altitude_deg[15], -15);
}

TEST(OusterMetadata, IsReadInTheNestedForm) {
  const auto m = parse_metadata(nested_form().dump(), "os.json");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_EQ(m->profile, Profile::dual);
  EXPECT_EQ(m->initialization_id, 5431293u);
  EXPECT_EQ(m->lidar_port, 17502);
  EXPECT_EQ(m->imu_port, 0);
  EXPECT_EQ(m->timestamp_mode, "TIME_FROM_PTP_1588");
  EXPECT_DOUBLE_EQ(m->beam_origin_m, 0.02767);
  EXPECT_DOUBLE_EQ(m->beam_origin_z_m, 0.005);
}

TEST(OusterMetadata, AnInitializationIdHasTheBitsThatAPacketHas) {
  json j = nested_form();
  j["sensor_info"]["initialization_id"] = 0x1ABCDEF;
  const auto m = parse_metadata(j.dump(), "os.json");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_EQ(m->initialization_id, 0xABCDEFU);
}

TEST(OusterBeams, BeginBesideAndAboveTheLidarsOriginByTheClosedForm) {
  Metadata m = made_metadata();
  m.beam_origin_m = 0.03, m.beam_origin_z_m = 0.04;  // 50 mm from the origin
  m.T_sensor_lidar = {0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1};
  const BeamTable beams(m);
  for (const std::uint32_t column : {0U, 77U, 300U, 511U})
    for (const std::uint32_t row : {0U, 13U, 31U}) {
      const double e = 2 * M_PI * (1 - column / 512.0), b = m.beam_altitude_deg[row] * M_PI / 180;
      const double c = e - m.beam_azimuth_deg[row] * M_PI / 180, r = 20 - 0.05;
      const double x = r * std::cos(b) * std::cos(c) + 0.03 * std::cos(e),
                   y = r * std::cos(b) * std::sin(c) + 0.03 * std::sin(e), z = r * std::sin(b) + 0.04;
      const auto p = beams.at(column, row, 20);
      EXPECT_NEAR(p.x_m, 1 - y, 4e-6);
      EXPECT_NEAR(p.y_m, 2 + x, 4e-6);
      EXPECT_NEAR(p.z_m, 3 + z, 4e-6);
    }
}

TEST(OusterMetadata, SaysWhatIsWrongAndWhere) {
  const auto message = [](const std::function<void(json&)>& change) {
    json j = nested_form();
    change(j);
    const auto m = parse_metadata(j.dump(), "os.json");
    return m ? std::string() : m.error().text();
  };
  const auto has = [](const std::string& text, const std::string& part) {
    EXPECT_NE(text.find(part), std::string::npos) << "\"" << text << "\" without \"" << part << "\"";
  };
  EXPECT_EQ(message([](json&) {}), "");
  has(message([](json& j) { j["beam_intrinsics"]["beam_altitude_angles"].push_back(1); }),
      "os.json: beam_intrinsics.beam_altitude_angles: expected 16 numbers, got 17");
  has(message([](json& j) { j["beam_intrinsics"].erase("beam_azimuth_angles"); }),
      "beam_azimuth_angles: expected it");
  has(message([](json& j) { j["config_params"]["lidar_mode"] = "fast"; }),
      "config_params.lidar_mode: expected a mode like 1024x10, got \"fast\"");
  has(message([](json& j) { j["lidar_data_format"]["columns_per_frame"] = 512; }),
      "the 1024 columns of lidar_mode, got 512");
  has(message([](json& j) { j["lidar_data_format"]["columns_per_packet"] = 48; }), "whole number of packets");
  has(message([](json& j) { j["lidar_data_format"]["column_window"][1] = 1024; }),
      "from 0 to 1023, got 1024");
  has(message([](json& j) { j["lidar_data_format"]["udp_profile_lidar"] = "FIVE_WORD_PIXEL"; }),
      "expected LEGACY");
  has(message([](json& j) { j["lidar_intrinsics"]["lidar_to_sensor_transform"][0] = 2; }),
      "expected a rotation");
  has(message([](json& j) { j["lidar_data_format"]["pixels_per_column"] = 1'000'000; }), "from 1 to 256");
  EXPECT_NE(parse_metadata("{\"a\": ", "os.json").error().text().find("os.json: expected JSON"),
            std::string::npos);
  EXPECT_FALSE(parse_metadata("[1]", "os.json"));
  EXPECT_EQ(load_metadata("/nonexistent/os.json").error().code, ErrorCode::not_found);
}

}  // namespace
}  // namespace rigor::ouster
