// Commands as bytes, and what the device answers to them.
#include "drivers/livox/livox_command.h"

#include <gtest/gtest.h>

#include "drivers/livox/lidar_control.h"
#include "rt-core/byte_order.h"
#include "tests/drivers/livox/made_livox.h"

namespace rigor::livox {
namespace {

using test::bytes_of_hex;
using Data = std::vector<std::uint8_t>;

// Written from the protocol document by Python, as those of packet_test.cpp.
const char* const kSearch = "aa0018000100000000000000000000000000a91f00000000";
const char* const kFound =
    "aa00300001000000000001010000000000008ab716b67e64000934374d444c3030303130313031000000c0a8010c24db";
const char* const kConfigure =
    "aa003200070000000001000000000000000015e805cc100403000000000001000306000800c0a80132eddbecdb1a00010001";
const char* const kConfigured = "aa001b00070000000001010100000000000012e812d941ff000000";
const char* const kInquire = "aa00200008000000010100000000000000005e7f32e7d07d0200000000800680";
const char* const kInquired =
    "aa0034000800000001010101000000000000"
    "3423ccf37e330002000080100034374d444c30303031303130310000000680010001";
const char* const kReboot = "aa001a000900000000020000000000000000cc72d0060e46f401";

constexpr std::uint32_t kDevice = 0xC0A8010C, kHost = 0xC0A80132;
MonotonicTime at_ms(std::int64_t ms) { return MonotonicTime(1'000'000'000'000 + ms * 1'000'000); }

LidarControl made_control(Duration start_up = {}) {
  LidarControl::Identity identity;
  identity.ipv4 = kDevice;
  identity.start_up = start_up;
  LidarControl::Setup setup;
  setup.point_host = {kHost, 1, 2};
  return {identity, setup, at_ms(0)};
}
Data request(CommandId id, const Data& data, std::uint32_t sequence = 5) {
  return compose_command({sequence, id, false, false, data});
}
Data set_one(Key key, const Data& value) {
  return request(CommandId::configure, parameter_data(std::vector<Parameter>{{key, value}}));
}
/// Code and key of an answer to parameters.
std::pair<ReturnCode, Key> judged(LidarControl& control, const Data& datagram) {
  const Data reply = control.answer(datagram, false, at_ms(1));
  const auto c = parse_command(reply);
  EXPECT_TRUE(c && c->answer && c->from_lidar && c->data.size() == 3);
  if (!c || c->data.size() != 3) return {};
  return {static_cast<ReturnCode>(c->data[0]), load_le<Key>(c->data, 1)};
}
Data value_of(LidarControl& control, Key key, MonotonicTime now) {
  Data data;
  append_le(data, std::uint16_t{1});
  append_le(data, std::uint16_t{0});
  append_le(data, key);
  const Data reply = control.answer(request(CommandId::inquire, data), false, now);
  const auto c = parse_command(reply);
  const auto list = c ? parse_parameters(c->data.subspan(3), 1) : std::nullopt;
  EXPECT_TRUE(list);
  return list ? Data((*list)[0].value.begin(), (*list)[0].value.end()) : Data{};
}

TEST(LivoxCommand, ChecksumsHaveTheirKnownValues) {
  const std::string_view digits = "123456789";
  EXPECT_EQ(crc16({reinterpret_cast<const std::uint8_t*>(digits.data()), 9}), 0x29B1);
  EXPECT_EQ(crc16({}), 0xFFFF);
}

TEST(LivoxCommand, RequestsAreAsTheDocumentSays) {
  EXPECT_EQ(compose_command({1, CommandId::search, false, false, {}}), bytes_of_hex(kSearch));
  const Data type{3}, mode{1};
  const auto host = bytes_of({kHost, 56301, 56300});
  const std::vector<Parameter> list{
      {Key::data_type, type}, {Key::point_host, host}, {Key::target_mode, mode}};
  EXPECT_EQ(compose_command({7, CommandId::configure, false, false, parameter_data(list)}),
            bytes_of_hex(kConfigure));
}

TEST(LivoxCommand, AnswersAreAsTheDocumentSays) {
  LidarControl control = made_control();
  EXPECT_EQ(control.answer(bytes_of_hex(kSearch), true, at_ms(1)), bytes_of_hex(kFound));
  EXPECT_EQ(control.answer(bytes_of_hex(kConfigure), false, at_ms(1)), bytes_of_hex(kConfigured));
  EXPECT_EQ(control.answer(bytes_of_hex(kInquire), false, at_ms(1)), bytes_of_hex(kInquired));
  const LidarControl::Active a = control.active(at_ms(2));
  EXPECT_EQ(a.setup.data_type, DataType::spherical);
  EXPECT_EQ(a.setup.point_host, (HostAddress{kHost, 56301, 56300}));
  const auto found = bytes_of_hex(kFound);
  const auto answer = parse_search(parse_command(found)->data);
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->serial, "47MDL00010101");
  EXPECT_EQ(answer->ipv4, kDevice);
  EXPECT_EQ(answer->command_port, 56100);
  EXPECT_EQ(answer->device_type, kMid360Type);
}

TEST(LivoxCommand, DamagedOnesAreNone) {
  const Data good = bytes_of_hex(kConfigure);
  ASSERT_TRUE(parse_command(good));
  for (std::size_t i = 0; i < good.size(); ++i) {
    Data b = good;
    b[i] ^= 0x40;
    EXPECT_FALSE(parse_command(b)) << "byte " << i;
  }
  EXPECT_FALSE(parse_command(Bytes(good).first(good.size() - 1)));
  EXPECT_FALSE(parse_command(Bytes(good).first(23)));
  Data longer = good;
  longer.push_back(0);
  EXPECT_FALSE(parse_command(longer));
}

TEST(LivoxCommand, ParametersHaveTheLengthsThatTheySay) {
  const Data list{6, 0, 2, 0, 9, 9, 26, 0, 0, 0};
  const auto two = parse_parameters(list, 2);
  ASSERT_TRUE(two);
  EXPECT_EQ((*two)[1].key, Key::target_mode);
  EXPECT_FALSE(parse_parameters(list, 1));
  EXPECT_FALSE(parse_parameters(list, 3));
  EXPECT_FALSE(parse_parameters(Bytes(list).first(9), 2));
  EXPECT_FALSE(parse_parameters(Bytes(list).first(5), 1));
}

TEST(LivoxControl, RefusesWhatItCannotTake) {
  LidarControl control = made_control();
  const auto before = control.active(at_ms(1)).generation;
  EXPECT_EQ(judged(control, set_one(Key::data_type, {4})),
            std::pair(ReturnCode::out_of_range, Key::data_type));
  EXPECT_EQ(judged(control, set_one(Key::data_type, {0})).first, ReturnCode::out_of_range);
  EXPECT_EQ(judged(control, set_one(Key::data_type, {1, 1})).first, ReturnCode::wrong_length);
  EXPECT_EQ(judged(control, set_one(Key::serial, Data(16))), std::pair(ReturnCode::read_only, Key::serial));
  EXPECT_EQ(judged(control, set_one(Key{0x7777}, {1})).first, ReturnCode::not_supported);
  EXPECT_EQ(judged(control, set_one(Key::target_mode, {5})).first, ReturnCode::out_of_range);
  EXPECT_EQ(judged(control, request(CommandId::configure, {2, 0, 0, 0, 0, 0, 1, 0, 2})).first,
            ReturnCode::wrong_count);
  EXPECT_EQ(judged(control, request(CommandId::configure, {1})).first, ReturnCode::wrong_count);
  // All of a request, or none.
  const Data type{2}, wrong{9};
  EXPECT_EQ(
      judged(control, request(CommandId::configure, parameter_data(std::vector<Parameter>{
                                                        {Key::data_type, type}, {Key::imu_enable, wrong}})))
          .second,
      Key::imu_enable);
  EXPECT_EQ(control.active(at_ms(1)).setup.data_type, DataType::cartesian_mm);
  EXPECT_EQ(control.active(at_ms(1)).generation, before);
  EXPECT_EQ(judged(control, set_one(Key::lidar_ip, Data(12))).first, ReturnCode::reboot_needed);
  // Not to it.
  EXPECT_TRUE(
      control.answer(compose_command({1, CommandId::search, true, false, {}}), true, at_ms(1)).empty());
  EXPECT_TRUE(
      control.answer(compose_command({1, CommandId::search, false, true, {}}), true, at_ms(1)).empty());
  EXPECT_TRUE(control.answer(bytes_of_hex(kInquire), true, at_ms(1)).empty()) << "the port for searching";
  EXPECT_TRUE(control.answer(Data(30), false, at_ms(1)).empty());
  const Data unknown = control.answer(request(CommandId{0x0400}, {1}), false, at_ms(1));
  EXPECT_EQ(parse_command(unknown)->data[0], static_cast<std::uint8_t>(ReturnCode::not_supported));
}

TEST(LivoxControl, StartsUpAndStartsAnewAfterAReboot) {
  LidarControl control = made_control(milliseconds(1000));
  EXPECT_EQ(control.active(at_ms(0)).state, WorkState::self_check);
  EXPECT_EQ(control.active(at_ms(600)).state, WorkState::motor_start);
  EXPECT_EQ(control.active(at_ms(1000)).state, WorkState::sampling);
  EXPECT_EQ(value_of(control, Key::state, at_ms(1500)), Data{1});
  EXPECT_EQ(judged(control, set_one(Key::target_mode, {2})).first, ReturnCode::success);
  EXPECT_EQ(control.active(at_ms(1600)).state, WorkState::idle);
  const auto generation = control.active(at_ms(1600)).generation;
  const Data reply = control.answer(bytes_of_hex(kReboot), false, at_ms(2000));  // in 500 ms
  EXPECT_EQ(parse_command(reply)->data[0], 0);
  EXPECT_EQ(control.active(at_ms(2499)).state, WorkState::idle);
  EXPECT_EQ(control.active(at_ms(2500)).state, WorkState::self_check);
  EXPECT_GT(control.active(at_ms(2500)).generation, generation);
  EXPECT_EQ(load_le<std::uint64_t>(value_of(control, Key::time_now, at_ms(2600))), 100'000'000u);
  EXPECT_EQ(load_le<std::uint32_t>(value_of(control, Key::power_ups, at_ms(2600))), 2u);
  EXPECT_EQ(control.active(at_ms(3600)).state, WorkState::idle) << "parameters are kept";
}

TEST(LivoxControl, TakesTheTimeOfGps) {
  LidarControl control = made_control();
  Data data{2};
  append_le(data, std::uint64_t{1'700'000'000'000'000'000});
  EXPECT_EQ(parse_command(control.answer(request(CommandId::set_gps_time, data), false, at_ms(500)))->data[0],
            0);
  const auto a = control.active(at_ms(600));
  EXPECT_TRUE(a.gps);
  EXPECT_EQ(a.gps_less_device_ns, 1'700'000'000'000'000'000 - 500'000'000);
  EXPECT_EQ(load_le<std::uint64_t>(value_of(control, Key::time_now, at_ms(600))), 1'700'000'000'100'000'000u);
  EXPECT_EQ(value_of(control, Key::time_sync, at_ms(600)), Data{2});
  data[0] = 1;
  EXPECT_NE(parse_command(control.answer(request(CommandId::set_gps_time, data), false, at_ms(500)))->data[0],
            0);
}

TEST(LivoxControl, PushesItsState) {
  LidarControl control = made_control();
  const Data first = control.push(at_ms(100)), second = control.push(at_ms(1100));
  const auto c = parse_command(first);
  ASSERT_TRUE(c);
  EXPECT_EQ(c->id, CommandId::push);
  EXPECT_FALSE(c->answer);
  EXPECT_TRUE(c->from_lidar);
  EXPECT_EQ(parse_command(second)->sequence, c->sequence + 1);
  const auto list = parse_parameters(c->data.subspan(4), load_le<std::uint16_t>(c->data, 0));
  ASSERT_TRUE(list);
  bool state = false, serial = false;
  for (const Parameter& p : *list) {
    state = state || (p.key == Key::state && p.value[0] == 1);
    serial = serial || (p.key == Key::serial && p.value[0] == '4');
  }
  EXPECT_TRUE(state && serial);
}

}  // namespace
}  // namespace rigor::livox
