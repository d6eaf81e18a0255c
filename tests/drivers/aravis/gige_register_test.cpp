// Every register of the emulated camera behaves as its row of the table says, and the description says the
// same.
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <map>
#include <regex>
#include <set>

#include "drivers/aravis/gige_genicam_xml.h"

namespace rigor::gige {
namespace {

constexpr Endpoint kClient{0x7F000001, 5000}, kStranger{0x0A000001, 6000};

GigeCameraConfig ptp_camera(bool range = false) {
  GigeCameraConfig c;
  c.formats = {PixelFormat::mono8, PixelFormat::rgb8};
  c.ptp.present = true;
  c.range.present = range;
  if (range) c.formats = {PixelFormat::coord3d_c16};
  return c;
}

/// A camera in the hands of kClient.
struct HeldCamera {
  explicit HeldCamera(const GigeCameraConfig& c = ptp_camera()) : model(GigeDeviceModel::create(c).value()) {
    EXPECT_EQ(write(reg::kControlPrivilege, 4, reg::kPrivilegeControl), GvStatus::success);
  }
  GvcpAck ask(const Datagram& d, Endpoint from = kClient) {
    GvcpAck a;
    bytes = model.handle_gvcp(from, d, now).ack;
    EXPECT_EQ(decode_gvcp_ack(bytes, a), DecodeStatus::ok);
    return a;
  }
  GvStatus write_bytes(std::uint32_t address, Bytes data, Endpoint from = kClient) {
    return ask(encode_write_memory_cmd(++id, address, data), from).status;
  }
  GvStatus write(std::uint32_t address, std::uint16_t size, std::uint64_t bits, Endpoint from = kClient) {
    std::vector<std::uint8_t> data;
    if (size == 8)
      append_be(data, bits);
    else
      append_be(data, static_cast<std::uint32_t>(bits));
    return write_bytes(address, data, from);
  }
  std::uint64_t read(std::uint32_t address, std::uint16_t size) {
    const auto a = ask(encode_read_memory_cmd(++id, {address, size}));
    EXPECT_EQ(a.status, GvStatus::success) << std::hex << address;
    const auto& m = std::get<ReadMemoryAck>(a.body);
    return size == 8 ? load_be<std::uint64_t>(m.data) : load_be<std::uint32_t>(m.data);
  }
  GigeDeviceModel model;
  DeviceTime now{1'000'000'000};
  Datagram bytes;
  std::uint16_t id = 0;
};

TEST(GigeRegisters, LieApartAndAreFoundByEachOfTheirWords) {
  for (const bool range : {false, true}) {
    const auto table = GigeDeviceModel::registers(ptp_camera(range));
    std::map<std::uint32_t, const Register*> words;
    for (const Register& r : table.rows())
      for (std::uint32_t at = 0; at < r.size; at += 4) {
        EXPECT_TRUE(words.emplace(r.address + at, &r).second) << std::hex << r.address;
        EXPECT_EQ(table.find(r.address + at), &r);
      }
    EXPECT_EQ(table.find(0x8000), nullptr);
    EXPECT_EQ(table.find(reg::kFeatureEnd), nullptr);
    EXPECT_EQ(table.find(reg::kScan3dScale) != nullptr, range);
  }
}

TEST(GigeRegisters, ReadOnlyOnesRefuseWholeAndHalfWrites) {
  HeldCamera d(ptp_camera(true));
  int seen = 0;
  const auto table = GigeDeviceModel::registers(ptp_camera(true));
  for (const Register& r : table.rows()) {
    if (r.size == 0 || r.access != Access::read_only) continue;
    ++seen;
    EXPECT_EQ(d.write(r.address, 4, 1), GvStatus::write_protect) << std::hex << r.address;
    EXPECT_EQ(d.write(r.address + r.size - 4, 4, 1), GvStatus::write_protect) << std::hex << r.address;
    if (r.size != 8) continue;
    EXPECT_EQ(d.write(r.address, 8, 1), GvStatus::write_protect) << std::hex << r.address;
  }
  EXPECT_GE(seen, 25);
}

TEST(GigeRegisters, WideNumbersAreReadInHalvesAndWrittenWhole) {
  HeldCamera d;
  int writable = 0;
  const auto table = GigeDeviceModel::registers(ptp_camera());
  for (const Register& r : table.rows()) {
    if (r.size != 8) continue;
    const std::uint64_t whole = d.read(r.address, 8);
    EXPECT_EQ(d.read(r.address, 4), whole >> 32) << std::hex << r.address;
    EXPECT_EQ(d.read(r.address + 4, 4), whole & 0xFFFFFFFF) << std::hex << r.address;
    if (r.access == Access::read_only) continue;
    ++writable;
    for (const std::uint32_t half : {0u, 4u})
      EXPECT_EQ(d.write(r.address + half, 4, 0x3FF00000), GvStatus::invalid_parameter)
          << std::hex << r.address;
    EXPECT_EQ(d.read(r.address, 8), whole);
    EXPECT_EQ(d.write(r.address, 8, whole), GvStatus::success) << std::hex << r.address;
  }
  EXPECT_EQ(writable, 4);  // frame rate, exposure, gain, delay
  EXPECT_EQ(std::bit_cast<double>(d.read(reg::kExposureTime, 8)), 10'000);
}

TEST(GigeRegisters, TakeTheirLimitsAndRefuseOrClampWhatLiesBeyond) {
  HeldCamera d;
  int refused = 0, clamped = 0;
  const auto table = GigeDeviceModel::registers(ptp_camera());
  for (const Register& r : table.rows()) {
    if (r.access == Access::read_only || !r.bounds || r.whole != 0) continue;
    const auto bits = [&](double v) {
      return r.is_real() ? std::bit_cast<std::uint64_t>(v) : static_cast<std::uint64_t>(v);
    };
    const double beyond = r.is_real() ? std::nextafter(r.bounds->max, INFINITY) : r.bounds->max + 1;
    for (const double limit : {r.bounds->min, r.bounds->max}) {
      if (r.address == reg::kStreamPort) continue;  // which opens a stream
      EXPECT_EQ(d.write(r.address, r.size, bits(limit)), GvStatus::success) << std::hex << r.address;
      EXPECT_EQ(d.read(r.address, r.size), bits(limit)) << std::hex << r.address;
    }
    if (r.clamped) {
      ++clamped;
      EXPECT_EQ(d.write(r.address, r.size, bits(beyond)), GvStatus::success);
      EXPECT_EQ(d.read(r.address, r.size), bits(r.bounds->max)) << std::hex << r.address;
      EXPECT_EQ(d.write(r.address, r.size, 0), GvStatus::success);
      EXPECT_EQ(d.read(r.address, r.size), bits(r.bounds->min)) << std::hex << r.address;
      continue;
    }
    ++refused;
    const auto before = d.read(r.address, r.size);
    EXPECT_EQ(d.write(r.address, r.size, bits(beyond)), GvStatus::invalid_parameter) << std::hex << r.address;
    if (r.is_real()) {
      EXPECT_EQ(d.write(r.address, 8, bits(std::nan(""))), GvStatus::invalid_parameter)
          << std::hex << r.address;
    }
    if (r.bounds->min > 0) {
      EXPECT_EQ(d.write(r.address, r.size, r.is_real() ? bits(std::nextafter(r.bounds->min, 0)) : 0),
                GvStatus::invalid_parameter)
          << std::hex << r.address;
    }
    EXPECT_EQ(d.read(r.address, r.size), before) << std::hex << r.address;
  }
  EXPECT_EQ(clamped, 1);  // the heartbeat
  EXPECT_GE(refused, 7);
}

TEST(GigeRegisters, ChoicesAndFlagsTakeTheirValuesAlone) {
  HeldCamera d(ptp_camera(true));
  int seen = 0;
  const auto table = GigeDeviceModel::registers(ptp_camera(true));
  for (const Register& r : table.rows()) {
    if (r.access != Access::read_write || r.anyone || r.features.empty() || r.features[0].lsb >= 0) continue;
    const Feature& f = r.features[0];
    std::vector<std::uint32_t> values;
    if (f.kind == Feature::Kind::flag) values = {0, 1};
    for (const Choice& c : f.choices) values.push_back(c.value);
    if (values.empty()) continue;
    ++seen;
    for (const auto v : values) {
      EXPECT_EQ(d.write(r.address, 4, v), GvStatus::success) << f.name << " " << v;
      if (r.address != reg::kChunkEnable && r.address != reg::kComponentEnable) {
        EXPECT_EQ(d.read(r.address, 4), v) << f.name;
      }
    }
    const auto before = d.read(r.address, 4);
    for (const std::uint32_t v : {77u, 0xFFFFFFFFu, 0x80000001u})
      EXPECT_EQ(d.write(r.address, 4, v), GvStatus::invalid_parameter) << f.name << " " << v;
    EXPECT_EQ(d.read(r.address, 4), before) << f.name;
  }
  EXPECT_GE(seen, 11);
}

TEST(GigeRegisters, TheRegionIsBoundByWhatTheOtherEdgeLeaves) {
  HeldCamera d;
  EXPECT_EQ(d.write(reg::kWidth, 4, 320), GvStatus::success);
  EXPECT_EQ(d.write(reg::kOffsetX, 4, 322), GvStatus::invalid_parameter);
  EXPECT_EQ(d.write(reg::kOffsetX, 4, 318), GvStatus::success);
  EXPECT_EQ(d.write(reg::kWidth, 4, 324), GvStatus::invalid_parameter);
  EXPECT_EQ(d.write(reg::kOffsetX, 4, 319), GvStatus::invalid_parameter);  // steps of 2
  EXPECT_EQ(d.write(reg::kWidth, 4, 318), GvStatus::invalid_parameter);    // steps of 4
  EXPECT_EQ(d.write(reg::kWidth, 4, 12), GvStatus::invalid_parameter);     // below the least
  EXPECT_EQ(d.read(reg::kOffsetX, 4), 318u);
  EXPECT_EQ(d.read(reg::kWidth, 4), 320u);
}

TEST(GigeRegisters, AWriteOverSeveralIsRefusedBeforeAnythingIsWritten) {
  HeldCamera d;
  std::vector<std::uint8_t> name(16, 'x');
  name.back() = 0;
  EXPECT_EQ(d.write_bytes(reg::kUserName, name), GvStatus::success);
  std::vector<std::uint8_t> beyond(20, 'y');  // what is behind the name does not exist
  EXPECT_EQ(d.write_bytes(reg::kUserName, beyond), GvStatus::invalid_address);
  // Frame rate, then its read-only result.
  std::vector<std::uint8_t> rates;
  append_be(rates, 20.0);
  append_be(rates, 20.0);
  EXPECT_EQ(d.write_bytes(reg::kFrameRate, rates), GvStatus::write_protect);
  EXPECT_EQ(std::bit_cast<double>(d.read(reg::kFrameRate, 8)), 25.0);
  // A flag, then one half of a rate.
  std::vector<std::uint8_t> half(8, 0);
  EXPECT_EQ(d.write_bytes(reg::kFrameRateEnable, half), GvStatus::invalid_parameter);
  EXPECT_EQ(d.read(reg::kFrameRateEnable, 4), 1u);
  // A flag and a whole rate.
  std::vector<std::uint8_t> both(4, 0);
  append_be(both, 30.0);
  EXPECT_EQ(d.write_bytes(reg::kFrameRateEnable, both), GvStatus::success);
  EXPECT_EQ(d.read(reg::kFrameRateEnable, 4), 0u);
  EXPECT_EQ(std::bit_cast<double>(d.read(reg::kFrameRate, 8)), 30.0);
  EXPECT_EQ(d.write_bytes(0xFFFFFFFC, half), GvStatus::invalid_address);
  EXPECT_EQ(d.write_bytes(reg::kXml, half), GvStatus::write_protect);
}

TEST(GigeRegisters, AWriteOfSeveralEndsWithTheFirstThatIsRefusedAndSaysHowManyWereDone) {
  HeldCamera d;
  const RegisterWrite writes[] = {{reg::kWidth, 320}, {reg::kWidthMax, 1}, {reg::kHeight, 240}};
  const auto a = d.ask(encode_write_register_cmd(++d.id, writes));
  EXPECT_EQ(a.status, GvStatus::write_protect);
  ASSERT_TRUE(std::holds_alternative<WriteRegisterAck>(a.body));
  EXPECT_EQ(std::get<WriteRegisterAck>(a.body).index, 1);
  EXPECT_EQ(d.read(reg::kWidth, 4), 320U);
  EXPECT_EQ(d.read(reg::kHeight, 4), 480U);
}

TEST(GigeRegisters, AnAddressBetweenTwoIsABadAlignment) {
  HeldCamera d;
  const std::uint32_t between = reg::kWidth + 2;
  EXPECT_EQ(d.ask(encode_read_register_cmd(++d.id, std::span(&between, 1))).status, GvStatus::bad_alignment);
  EXPECT_EQ(d.write(between, 4, 320), GvStatus::bad_alignment);
}

TEST(GigeRegisters, TheDescriptionIsReadToItsEndAndNotBeyond) {
  HeldCamera d;
  const auto c = ptp_camera();
  const auto size = static_cast<std::uint32_t>(make_genicam_xml(c, GigeDeviceModel::registers(c)).size());
  ASSERT_EQ(size % 4, 0U) << "clients read words";
  EXPECT_EQ(d.ask(encode_read_memory_cmd(++d.id, {reg::kXml + size - 4, 4})).status, GvStatus::success);
  for (const std::uint32_t at : {size - 4, size, 0xFFFFFFF8 - reg::kXml})
    EXPECT_EQ(d.ask(encode_read_memory_cmd(++d.id, {reg::kXml + at, 8})).status, GvStatus::invalid_address);
}

TEST(GigeRegisters, AStrangerWritesNothingButThePrivilege) {
  HeldCamera d;
  const auto table = GigeDeviceModel::registers(ptp_camera());
  for (const Register& r : table.rows()) {
    if (r.size == 0) continue;
    EXPECT_EQ(d.write(r.address, r.size == 8 ? 8 : 4, 1, kStranger), GvStatus::access_denied)
        << std::hex << r.address;
  }
  EXPECT_EQ(d.write(reg::kControlPrivilege, 4, 0), GvStatus::success);
  EXPECT_EQ(d.write(reg::kControlPrivilege, 4, reg::kPrivilegeControl, kStranger), GvStatus::success);
}

TEST(GigeRegisters, WriteOnlyOnesReadZero) {
  HeldCamera d;
  EXPECT_EQ(d.write(reg::kActionDeviceKey, 4, 4711), GvStatus::success);
  EXPECT_EQ(d.read(reg::kActionDeviceKey, 4), 0u);
  EXPECT_EQ(d.write(reg::kTimestampControl, 4, reg::kTimestampLatch), GvStatus::success);
  EXPECT_EQ(d.read(reg::kTimestampControl, 4), 0u);
  EXPECT_EQ(d.read(reg::kTimestampHigh, 8), 1'000'000'000u);
}

TEST(GigeRegisters, TheConfigurationTakesOnlyWhatTheCapabilitySays) {
  HeldCamera d;
  EXPECT_EQ(d.write(reg::kGvcpConfiguration, 4, 0xFFFFFFFF), GvStatus::success);
  EXPECT_EQ(d.read(reg::kGvcpConfiguration, 4),
            reg::kExtendedStatus | reg::kUnconditionalAction | reg::kIeee1588);
  EXPECT_EQ(d.read(reg::kPtpEnable, 4), 1u) << "the same switch";
  EXPECT_EQ(d.read(reg::kIeee1588Status, 4), 4u) << "listening";
  auto plain = ptp_camera();
  plain.ptp.present = false;
  HeldCamera without(plain);
  EXPECT_EQ(without.write(reg::kGvcpConfiguration, 4, 0xFFFFFFFF), GvStatus::success);
  EXPECT_EQ(without.read(reg::kGvcpConfiguration, 4), reg::kExtendedStatus | reg::kUnconditionalAction);
  EXPECT_EQ(without.read(reg::kGvcpCapability, 4) & (reg::kScheduledAction | reg::kIeee1588), 0u);
}

TEST(GigeRegisters, TheDescriptionSaysAddressLengthAndAccessOfEachRow) {
  const auto c = ptp_camera(true);
  const auto table = GigeDeviceModel::registers(c);
  const std::string xml = make_genicam_xml(c, table);
  std::set<std::uint32_t> described;
  const std::regex one(
      R"x(<Address>0x(\w+)</Address>\s*<Length>(\d+)</Length>\s*<AccessMode>(\w+)</AccessMode>\s*<pPort>Device<)x");
  for (std::sregex_iterator i(xml.begin(), xml.end(), one), end; i != end; ++i) {
    const auto address = static_cast<std::uint32_t>(std::stoul((*i)[1], nullptr, 16));
    const Register* r = table.find(address);
    ASSERT_NE(r, nullptr) << (*i)[1];
    EXPECT_EQ(r->address, address);
    EXPECT_EQ(std::to_string(r->size), (*i)[2]) << (*i)[1];
    EXPECT_TRUE((*i)[3] == "RO" || r->access == ((*i)[3] == "WO" ? Access::write_only : Access::read_write))
        << (*i)[1];
    described.insert(address);
  }
  for (const Register& r : table.rows())
    if (r.size != 0 && !r.features.empty()) {
      EXPECT_EQ(described.count(r.address), 1u) << std::hex << r.address;
    }
  for (const Chunk& chunk : chunk_table()) {
    EXPECT_EQ(chunk.id, static_cast<std::uint32_t>(&chunk - chunk_table().data()) + 1);
    EXPECT_NE(xml.find("<EnumEntry Name=\"" + std::string(chunk.name) + "\""), std::string::npos);
    char id[16];
    std::snprintf(id, sizeof id, "%08X", chunk.id);
    EXPECT_EQ(xml.find("<ChunkID>" + std::string(id)) != std::string::npos, chunk.value != nullptr);
  }
}

}  // namespace
}  // namespace rigor::gige
