// The emulated device as its clients see it: the well-behaved one is libmodbus, the others are raw sockets.
#include <arpa/inet.h>
#include <modbus/modbus.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include "tests/drivers/modbus/modbus_test_tools.h"

namespace rigor::modbus {
namespace {

int connect_raw(std::uint16_t port, int receive_buffer = 0) {
  const int s = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (receive_buffer > 0) ::setsockopt(s, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
  sockaddr_in a{};
  a.sin_family = AF_INET;
  a.sin_port = htons(port);
  a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  EXPECT_EQ(::connect(s, reinterpret_cast<sockaddr*>(&a), sizeof a), 0);
  const timeval limit{3, 0};
  ::setsockopt(s, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
  return s;
}
/// All that comes until the peer closes or the answer has `n` bytes.
std::vector<std::uint8_t> receive(int s, std::size_t n) {
  std::vector<std::uint8_t> all;
  while (all.size() < n) {
    std::uint8_t b[512];
    const auto got = ::recv(s, b, std::min(sizeof b, n - all.size()), 0);
    if (got <= 0) break;
    all.insert(all.end(), b, b + got);
  }
  return all;
}
void send_raw(int s, const std::vector<std::uint8_t>& bytes) {
  ASSERT_EQ(::send(s, bytes.data(), bytes.size(), MSG_NOSIGNAL), static_cast<ssize_t>(bytes.size()));
}

class ModbusServer : public testing::Test {
 protected:
  void SetUp() override {
    for (std::uint16_t i = 0; i < 200; ++i) {
      bank_->set(RegisterTable::holding_registers, i, {static_cast<std::uint16_t>(1000 + i)});
      bank_->set(RegisterTable::input_registers, i, {static_cast<std::uint16_t>(2000 + i)});
      bank_->set(RegisterTable::coils, i, {static_cast<std::uint16_t>(i % 3 == 0)});
      bank_->set(RegisterTable::discrete_inputs, i, {static_cast<std::uint16_t>(i % 5 == 0)});
    }
    client_ = modbus_new_tcp("127.0.0.1", device_.port());
    ASSERT_EQ(modbus_connect(client_), 0) << modbus_strerror(errno);
  }
  void TearDown() override {
    modbus_close(client_);
    modbus_free(client_);
  }
  void expect_well() {
    std::uint16_t r = 0;
    ASSERT_EQ(modbus_read_registers(client_, 7, 1, &r), 1) << modbus_strerror(errno);
    EXPECT_EQ(r, bank_->holding(7));
  }
  std::shared_ptr<Bank> bank_ = std::make_shared<Bank>();
  Device device_{bank_, 0, "max_clients: 6\n"};
  modbus_t* client_ = nullptr;
};

TEST_F(ModbusServer, AnswersEveryFunctionThatAMasterHas) {
  std::uint16_t r[125];
  std::uint8_t bits[200];
  ASSERT_EQ(modbus_read_registers(client_, 0, 125, r), 125);
  EXPECT_EQ(r[124], 1124);
  ASSERT_EQ(modbus_read_input_registers(client_, 5, 2, r), 2);
  EXPECT_EQ(r[1], 2006);
  ASSERT_EQ(modbus_read_bits(client_, 0, 200, bits), 200);
  EXPECT_EQ(bits[99], 1);
  EXPECT_EQ(bits[100], 0);
  ASSERT_EQ(modbus_read_input_bits(client_, 10, 3, bits), 3);
  EXPECT_EQ(bits[0], 1);
  EXPECT_EQ(bits[1], 0);
  ASSERT_EQ(modbus_write_register(client_, 3, 0xABCD), 1);
  EXPECT_EQ(bank_->holding(3), 0xABCD);
  const std::uint16_t three[3] = {1, 2, 3};
  ASSERT_EQ(modbus_write_registers(client_, 100, 3, three), 3);
  EXPECT_EQ(bank_->holding(102), 3);
  ASSERT_EQ(modbus_write_bit(client_, 1, 1), 1);
  EXPECT_EQ(bank_->get(RegisterTable::coils, 1), 1);
  const std::uint8_t ten[10] = {1, 0, 1, 1, 0, 0, 0, 0, 1, 1};
  ASSERT_EQ(modbus_write_bits(client_, 20, 10, ten), 10);
  EXPECT_EQ(bank_->get(RegisterTable::coils, 29), 1);
  EXPECT_EQ(bank_->get(RegisterTable::coils, 21), 0);
  bank_->set(RegisterTable::holding_registers, 4, {0x12});
  ASSERT_EQ(modbus_mask_write_register(client_, 4, 0xF2, 0x25), 1);  // the example of the specification
  EXPECT_EQ(bank_->holding(4), 0x17);
  const std::uint16_t two[2] = {71, 72};
  ASSERT_EQ(modbus_write_and_read_registers(client_, 50, 2, two, 49, 4, r), 4);
  EXPECT_EQ(std::vector<std::uint16_t>(r, r + 4), (std::vector<std::uint16_t>{1049, 71, 72, 1052}));
  EXPECT_EQ(bank_->holding(51), 72);
}

TEST_F(ModbusServer, RefusesWhatDoesNotExistWithoutLosingTheConnection) {
  std::uint16_t r[125];
  EXPECT_EQ(modbus_read_registers(client_, 255, 2, r), -1);
  EXPECT_EQ(errno, EMBXILADD);
  EXPECT_EQ(modbus_write_register(client_, 300, 1), -1);
  EXPECT_EQ(errno, EMBXILADD);
  EXPECT_EQ(modbus_report_slave_id(client_, 10, reinterpret_cast<std::uint8_t*>(r)), -1);
  EXPECT_EQ(errno, EMBXILFUN);
  expect_well();
}

TEST_F(ModbusServer, RefusesCountsOutOfRange) {
  const int s = connect_raw(device_.port());
  send_raw(s, {0, 9, 0, 0, 0, 6, 1, 3, 0, 0, 0, 126});
  EXPECT_EQ(receive(s, 9), (std::vector<std::uint8_t>{0, 9, 0, 0, 0, 3, 1, 0x83, 3}));
  send_raw(s, {0, 10, 0, 0, 0, 6, 1, 3, 0, 0, 0, 0});
  EXPECT_EQ(receive(s, 9).back(), 3);
  send_raw(s, {0, 11, 0, 0, 0, 6, 1, 5, 0, 0, 0x12, 0x34});  // a coil is FF00 or 0000
  EXPECT_EQ(receive(s, 9).back(), 3);
  ::close(s);
}

TEST_F(ModbusServer, PutsRequestsTogetherHoweverTheyArrive) {
  const int s = connect_raw(device_.port());
  std::vector<std::uint8_t> three;
  for (std::uint8_t i = 0; i < 3; ++i) {
    const std::vector<std::uint8_t> one{0, i, 0, 0, 0, 6, 1, 3, 0, i, 0, 1};
    three.insert(three.end(), one.begin(), one.end());
  }
  send_raw(s, three);
  const auto answers = receive(s, 33);
  ASSERT_EQ(answers.size(), 33u);
  for (std::size_t i = 0; i < 3; ++i)
    EXPECT_EQ(answers[11 * i + 9] * 256 + answers[11 * i + 10], 1000 + int(i));
  for (const auto b : {0, 7, 0, 0, 0, 6, 1, 3, 0, 9, 0, 1}) {
    send_raw(s, {static_cast<std::uint8_t>(b)});
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  EXPECT_EQ(receive(s, 11).back(), (1009 & 0xFF));
  ::close(s);
}

TEST_F(ModbusServer, HostileClientsCostTheirOwnConnectionAlone) {
  const std::vector<std::vector<std::uint8_t>> attacks{
      {0, 1, 0, 9, 0, 6, 1, 3, 0, 0, 0, 1},            // not Modbus
      {0, 1, 0, 0, 0, 1, 1},                           // no function
      {0, 1, 0, 0, 0xFF, 0xFF, 1, 3},                  // a length of 64 KiB
      {0, 1, 0, 0, 0, 7, 1, 3, 0, 0, 0, 1, 0},         // a byte too many
      {0, 1, 0, 0, 0, 9, 1, 16, 0, 0, 0, 2, 4, 0, 1},  // says 4 bytes, has 2
      {0, 1, 0, 0, 0, 7, 1, 15, 0, 0, 0, 16, 1},       // 16 coils in one byte
      {'G', 'E', 'T', ' ', '/', ' ', 'H', 'T', 'T', 'P', '/', '1', '.', '1', '\r', '\n', '\r', '\n'}};
  for (const auto& bytes : attacks) {
    const int s = connect_raw(device_.port());
    send_raw(s, bytes);
    EXPECT_TRUE(receive(s, 1).empty()) << "was answered";  // closed by the server
    ::close(s);
    expect_well();
  }
  EXPECT_EQ(device_->server()->counters().malformed.load(), attacks.size());
}

TEST_F(ModbusServer, HalfOpenClientsHoldNobodyUp) {
  std::vector<int> sockets;
  for (int i = 0; i < 4; ++i) {
    sockets.push_back(connect_raw(device_.port()));
    send_raw(sockets.back(), {0, 1, 0, 0, 0, 6, 1});  // and never the rest
  }
  for (int i = 0; i < 50; ++i) expect_well();  // a client's own time limit is half a second for each
  for (const int s : sockets) ::close(s);
}

/// One byte at a time, for far longer than the limit, keeps no place.
TEST(ModbusIdleLimit, DropsWhoseRequestDoesNotComeToItsEnd) {
  Device device{std::make_shared<Bank>(), 0, "idle_limit_s: 0.05\n"};
  const int trickle = connect_raw(device.port());
  send_raw(trickle, {0, 1, 0, 0, 0, 250, 1});
  int sent = 0;
  for (; sent < 240 && device->server()->counters().dropped == 0; ++sent) {
    const std::uint8_t byte = 3;
    (void)::send(trickle, &byte, 1, MSG_NOSIGNAL);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  EXPECT_LT(sent, 240) << "more than a second of single bytes kept the place";
  ::close(trickle);
}

TEST_F(ModbusServer, AClientThatTakesNoAnswersIsDropped) {
  const int s = connect_raw(device_.port(), 4096);
  std::vector<std::uint8_t> many;
  for (int i = 0; i < 100; ++i) many.insert(many.end(), {0, 1, 0, 0, 0, 6, 1, 3, 0, 0, 0, 125});
  EXPECT_TRUE(eventually(seconds(30),
                         [&] {
                           for (int i = 0; i < 20; ++i)
                             (void)::send(s, many.data(), many.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
                           return device_->server()->counters().dropped.load() > 0;
                         }))
      << device_->server()->counters().requests.load() << " requests, "
      << device_->server()->counters().clients.load() << " clients";
  ::close(s);
  expect_well();
}

TEST_F(ModbusServer, TurnsAwayMoreClientsThanItHasPlacesFor) {
  std::vector<int> sockets;
  for (int i = 0; i < 7; ++i) sockets.push_back(connect_raw(device_.port()));
  EXPECT_TRUE(eventually(seconds(20), [&] { return device_->server()->counters().turned_away.load() == 2; }));
  expect_well();
  for (const int s : sockets) ::close(s);
  EXPECT_TRUE(eventually(seconds(20), [&] { return device_->server()->counters().clients.load() == 1; }));
}

TEST_F(ModbusServer, IsConnectedWhileAClientIs) {
  EXPECT_TRUE(eventually(seconds(20), [&] { return device_->health().connected; }));
  modbus_close(client_);
  EXPECT_TRUE(eventually(seconds(20), [&] { return !device_->health().connected; }));
}

TEST_F(ModbusServer, DelaysAndFaultsToOrder) {
  device_->set_faults({.response_delay = milliseconds(60)});
  auto begin = monotonic_now();
  expect_well();
  const auto took = (monotonic_now() - begin).seconds();
  EXPECT_GE(took, 0.055);
  device_->set_faults({.exception_every = 1, .exception_code = 6});
  std::uint16_t r = 0;
  EXPECT_EQ(modbus_read_registers(client_, 0, 1, &r), -1);
  EXPECT_EQ(errno, EMBXSBUSY);
  device_->set_faults({});
  expect_well();
}

TEST(ModbusEmulator, SaysWhyItCannotServe) {
  Device first(std::make_shared<Bank>());
  const auto error_of = [](const std::string& keys) {
    ModbusEmulator e;
    e.attach(parts_of(std::make_shared<Bank>()));
    ChannelConfig c;
    c.name = "table";
    c.params = yaml(keys);
    auto s = e.configure(c);
    if (s) s = e.arm({});
    return s ? Error{} : s.error();
  };
  const auto taken = error_of("port: " + std::to_string(first.port()));
  EXPECT_EQ(taken.code, ErrorCode::unavailable);
  EXPECT_NE(taken.text().find("another program has the port"), std::string::npos) << taken.text();
  EXPECT_EQ(error_of("{ address: 192.0.2.77, port: 5020 }").code, ErrorCode::not_found);
  EXPECT_EQ(error_of("port: 65536").text(),
            "rig.yaml:1:7: port: expected a whole number from 0 to 65535, got 65536");
  EXPECT_EQ(error_of("{ port: 0, faults: { exception_every: -1 } }").code, ErrorCode::bad_input);
  ModbusEmulator no_model;
  ChannelConfig c;
  c.name = "table";
  c.params = yaml("port: 0");
  ASSERT_TRUE(no_model.configure(c));
  EXPECT_EQ(no_model.arm({}).error().code, ErrorCode::bad_input);
}

}  // namespace
}  // namespace rigor::modbus
