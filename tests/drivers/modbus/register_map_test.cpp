// Raw registers against values worked out by hand, in both directions, and the keys of a register list.
#include "drivers/modbus/register_map.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace rigor::modbus {
namespace {

using Raw = std::vector<std::uint16_t>;

struct Known {
  ValueType type;
  ByteOrder order;
  double value;
  Raw raw;
};
class KnownRegisters : public testing::TestWithParam<Known> {};

TEST_P(KnownRegisters, GoBothWays) {
  const auto& k = GetParam();
  RegisterValue v;
  v.type = k.type;
  v.order = k.order;
  EXPECT_EQ(decode(v, k.raw), k.value);
  Raw raw(width(k.type), 0xDEAD);
  ASSERT_EQ(encode(v, k.value, raw), EncodeStatus::good);
  EXPECT_EQ(raw, k.raw);
}

using enum ValueType;
using enum ByteOrder;
INSTANTIATE_TEST_SUITE_P(
    Modbus, KnownRegisters,
    testing::Values(
        Known{u16, abcd, 0x1234, {0x1234}}, Known{u16, cdab, 0x1234, {0x1234}},
        Known{u16, badc, 0x1234, {0x3412}}, Known{u16, dcba, 0x1234, {0x3412}},
        Known{s16, abcd, -2, {0xFFFE}}, Known{s16, dcba, -2, {0xFEFF}},
        Known{u32, abcd, 0x12345678, {0x1234, 0x5678}}, Known{u32, cdab, 0x12345678, {0x5678, 0x1234}},
        Known{u32, badc, 0x12345678, {0x3412, 0x7856}}, Known{u32, dcba, 0x12345678, {0x7856, 0x3412}},
        Known{s32, abcd, -123456789, {0xF8A4, 0x32EB}}, Known{s32, cdab, -123456789, {0x32EB, 0xF8A4}},
        // 123.456f is 0x42F6E979
        Known{f32, abcd, double{123.456F}, {0x42F6, 0xE979}},
        Known{f32, cdab, double{123.456F}, {0xE979, 0x42F6}},
        Known{f32, badc, double{123.456F}, {0xF642, 0x79E9}},
        Known{f32, dcba, double{123.456F}, {0x79E9, 0xF642}},
        Known{u64, abcd, 0x0001020304050607, {0x0001, 0x0203, 0x0405, 0x0607}},
        Known{u64, cdab, 0x0001020304050607, {0x0607, 0x0405, 0x0203, 0x0001}},
        Known{u64, badc, 0x0001020304050607, {0x0100, 0x0302, 0x0504, 0x0706}},
        Known{u64, dcba, 0x0001020304050607, {0x0706, 0x0504, 0x0302, 0x0100}},
        Known{s64, abcd, -1, {0xFFFF, 0xFFFF, 0xFFFF, 0xFFFF}},
        Known{s64, cdab, -4294967296.0, {0x0000, 0x0000, 0xFFFF, 0xFFFF}},
        // −2.5 is 0xC004000000000000
        Known{f64, abcd, -2.5, {0xC004, 0, 0, 0}}, Known{f64, cdab, -2.5, {0, 0, 0, 0xC004}},
        Known{f64, badc, -2.5, {0x04C0, 0, 0, 0}}, Known{f64, dcba, -2.5, {0, 0, 0, 0x04C0}},
        Known{boolean, abcd, 1, {1}}, Known{boolean, abcd, 0, {0}}));

RegisterValue value(ValueType type, double scale = 1, double offset = 0) {
  RegisterValue v;
  v.type = type;
  v.scale = scale;
  v.offset = offset;
  return v;
}

TEST(RegisterValue, IsScaledAndShifted) {
  const auto v = value(s16, 0.1, -40);
  EXPECT_DOUBLE_EQ(decode(v, Raw{652}), 25.2);
  Raw raw(1);
  ASSERT_EQ(encode(v, 25.2, raw), EncodeStatus::good);
  EXPECT_EQ(raw[0], 652);
}

TEST(RegisterValue, RoundsToTheNearestHalvesAwayFromZero) {
  Raw raw(1);
  for (const auto& [x, expected] : {std::pair{2.4, 2}, {2.5, 3}, {-2.5, -3}, {-2.4, -2}, {32767.4, 32767}}) {
    ASSERT_EQ(encode(value(s16), x, raw), EncodeStatus::good);
    EXPECT_EQ(static_cast<std::int16_t>(raw[0]), expected);
  }
}

TEST(RegisterValue, RefusesWhatDoesNotFitAndLeavesTheRegistersAlone) {
  const double inf = std::numeric_limits<double>::infinity();
  const std::vector<std::tuple<ValueType, double, double>> limits{{u16, 0, 65535},
                                                                  {s16, -32768, 32767},
                                                                  {u32, 0, 4294967295.0},
                                                                  {s32, -2147483648.0, 2147483647.0},
                                                                  {boolean, 0, 1}};
  for (const auto& [type, low, high] : limits) {
    Raw raw(width(type), 0xBEEF);
    EXPECT_EQ(encode(value(type), low - 1, raw), EncodeStatus::out_of_range);
    EXPECT_EQ(encode(value(type), high + 1, raw), EncodeStatus::out_of_range);
    EXPECT_EQ(encode(value(type), inf, raw), EncodeStatus::out_of_range);
    EXPECT_EQ(encode(value(type), -inf, raw), EncodeStatus::out_of_range);
    EXPECT_EQ(encode(value(type), std::nan(""), raw), EncodeStatus::not_a_number);
    EXPECT_EQ(raw, Raw(width(type), 0xBEEF));
    EXPECT_EQ(encode(value(type), low, raw), EncodeStatus::good);
    EXPECT_EQ(encode(value(type), high, raw), EncodeStatus::good);
  }
  Raw four(4);
  EXPECT_EQ(encode(value(u64), 18446744073709551616.0, four), EncodeStatus::out_of_range);
  EXPECT_EQ(encode(value(u64), 18446744073709549568.0, four), EncodeStatus::good);
  EXPECT_EQ(four, (Raw{0xFFFF, 0xFFFF, 0xFFFF, 0xF800}));
  EXPECT_EQ(encode(value(s64), 9223372036854775808.0, four), EncodeStatus::out_of_range);
  EXPECT_EQ(encode(value(s64), -9223372036854775808.0, four), EncodeStatus::good);
  EXPECT_EQ(four, (Raw{0x8000, 0, 0, 0}));
  Raw two(2);
  EXPECT_EQ(encode(value(f32), 3.5e38, two), EncodeStatus::out_of_range);
  EXPECT_EQ(encode(value(f32), static_cast<double>(std::numeric_limits<float>::max()), two),
            EncodeStatus::good);
  EXPECT_EQ(encode(value(f64, 1e-300), 1e300, four), EncodeStatus::out_of_range);
}

RegisterMap parse(const std::string& yaml, RegisterMap::Access access = RegisterMap::Access::read,
                  std::size_t max = 64) {
  const auto n = ConfigDocument::parse(yaml, "rig.yaml");
  EXPECT_TRUE(n.has_value()) << (n ? "" : n.error().text());
  return RegisterMap::parse(*n, "registers", access, max);
}
std::string refusal(const std::string& yaml, RegisterMap::Access access = RegisterMap::Access::read,
                    std::size_t max = 64) {
  const auto r = catch_config([&] { return parse(yaml, access, max); });
  return r ? "(accepted)" : r.error().text();
}

TEST(RegisterMap, GroupsNeighboursOfOneTableIntoOneRequest) {
  const auto m = parse(
      "registers:\n"
      "  - { name: d, table: input_registers, address: 14 }\n"
      "  - { name: a, table: input_registers, address: 10, type: s32, byte_order: CDAB }\n"
      "  - { name: c, table: input_registers, address: 12, type: f32 }\n"
      "  - { name: far, table: input_registers, address: 16 }\n"
      "  - { name: other, table: holding_registers, address: 15 }\n"
      "  - { name: same, table: input_registers, address: 11 }\n"
      "  - { name: bit, table: coils, address: 15 }\n");
  ASSERT_EQ(m.requests().size(), 4u);
  EXPECT_EQ(m.raw_size(), 8u);
  const auto find = [&](RegisterTable t, std::uint16_t address) {
    for (const auto& r : m.requests())
      if (r.table == t && r.address == address) return r;
    ADD_FAILURE() << "no request at " << address;
    return Request{};
  };
  const auto in = find(RegisterTable::input_registers, 10);
  EXPECT_EQ(in.count, 5);
  EXPECT_EQ(find(RegisterTable::input_registers, 16).count, 1);
  Raw raw(m.raw_size());
  raw[in.raw_at] = 0x5678;
  raw[in.raw_at + 1] = 0x0012;
  raw[in.raw_at + 4] = 77;
  raw[find(RegisterTable::input_registers, 16).raw_at] = 88;
  raw[find(RegisterTable::holding_registers, 15).raw_at] = 99;
  raw[find(RegisterTable::coils, 15).raw_at] = 1;
  std::vector<double> out(7);
  EXPECT_EQ(m.decode(raw, out), 0u);
  EXPECT_EQ(out, (std::vector<double>{77, 0x125678, 0, 88, 99, 0x12, 1}));
}

TEST(RegisterMap, SplitsWhatIsLongerThanARequestMayBeAndNoValue) {
  std::vector<RegisterValue> values;
  for (int i = 0; i < 64; ++i) {
    RegisterValue v;
    v.type = ValueType::f64;
    v.address = static_cast<std::uint16_t>(4 * i);
    values.push_back(v);
  }
  const RegisterMap read(values, RegisterMap::Access::read);
  ASSERT_EQ(read.requests().size(), 3u);
  EXPECT_EQ(read.requests()[0].count, 124);
  EXPECT_EQ(read.requests()[1].address, 124);
  EXPECT_EQ(read.requests()[2].count, 8);
  EXPECT_EQ(read.raw_size(), 256u);
  const RegisterMap write(values, RegisterMap::Access::write);
  EXPECT_EQ(write.requests()[0].count, 120);
}

TEST(RegisterMap, CountsValuesThatAreNoNumbers) {
  const auto m = parse(
      "registers: [{ name: a, table: input_registers, address: 0, type: f32 },"
      "            { name: b, table: input_registers, address: 2, type: f32 }]");
  std::vector<double> out(2);
  EXPECT_EQ(m.decode(Raw{0x7FC0, 0, 0x3F80, 0}, out), 1u);
  EXPECT_TRUE(std::isnan(out[0]));
  EXPECT_EQ(out[1], 1);
}

TEST(RegisterMap, EncodesAllOrSaysWhichDoesNotFit) {
  const auto m = parse(
      "registers: [{ name: a, table: holding_registers, address: 0 },"
      "            { name: b, table: holding_registers, address: 4, type: s32, scale: 0.001 }]",
      RegisterMap::Access::write);
  Raw raw(m.raw_size());
  std::size_t bad = 9;
  ASSERT_EQ(m.encode(std::vector<double>{1, -1.5}, raw, bad), EncodeStatus::good);
  EXPECT_EQ(raw, (Raw{1, 0xFFFF, 0xFA24}));
  EXPECT_EQ(m.encode(std::vector<double>{1, 1e9}, raw, bad), EncodeStatus::out_of_range);
  EXPECT_EQ(bad, 1u);
}

TEST(RegisterMap, RefusesWhatIsNotARegister) {
  const auto one = [](const std::string& fields) { return "registers:\n  - { " + fields + " }\n"; };
  using enum RegisterMap::Access;
  EXPECT_EQ(refusal("a: 1"), "rig.yaml:1:1: registers: expected a list, got nothing: the key is missing");
  EXPECT_EQ(refusal("registers: []"), "rig.yaml:1:12: registers: expected 1 to 64 registers, got 0");
  EXPECT_EQ(refusal(one("name: a, table: input_register, address: 0")),
            "rig.yaml:2:23: registers.0.table: expected one of coils, discrete_inputs, input_registers, "
            "holding_registers, got input_register; did you mean 'input_registers'?");
  EXPECT_EQ(refusal(one("name: a, table: input_registers, address: 65535, type: u32")),
            "rig.yaml:2:49: registers.0.address: expected a whole number from 0 to 65534, got 65535");
  EXPECT_EQ(refusal(one("name: a, table: coils, address: 0, type: u16")),
            "rig.yaml:2:48: registers.0.type: expected bool, the only type of coils, got u16");
  EXPECT_EQ(refusal(one("name: a, table: coils, address: 0, scale: 2")),
            "rig.yaml:2:49: registers.0.scale: expected none for a bool, which is 0 or 1; remove it");
  EXPECT_EQ(refusal(one("name: a, table: input_registers, address: 0, scale: 0")),
            "rig.yaml:2:59: registers.0.scale: expected a number other than 0, got 0");
  EXPECT_EQ(refusal(one("name: a, table: input_registers, address: 0, byteorder: ABCD")),
            "rig.yaml:2:52: registers.0.byteorder: unknown key; did you mean byte_order?");
  EXPECT_EQ(refusal(one("name: a, table: input_registers, address: 0"), write),
            "rig.yaml:2:23: registers.0.table: expected coils or holding_registers, got input_registers, "
            "which Modbus "
            "cannot write");
  EXPECT_EQ(refusal("registers:\n  - { name: a, table: coils, address: 0 }\n  - { name: a, table: coils, "
                    "address: 1 }\n"),
            "rig.yaml:3:13: registers.1.name: expected each name once, got a again");
  EXPECT_EQ(refusal("registers:\n  - { name: a, table: holding_registers, address: 0, type: u32 }\n"
                    "  - { name: b, table: holding_registers, address: 1 }\n",
                    write),
            "rig.yaml:3:51: registers.1.address: expected registers of its own, got some that a has too");
}

}  // namespace
}  // namespace rigor::modbus
