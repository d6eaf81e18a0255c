// The emulated GigE camera without a network, and a client's commands to it at times of the test's choice.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <optional>

#include "drivers/aravis/gige_device_model.h"

namespace rigor::gige::testing {

inline constexpr Endpoint kAlice{0x7F000001, 5000};
inline constexpr Endpoint kMallory{0x0A000001, 6000};

class GigeModel : public ::testing::Test {
 protected:
  GigeModel() : model(GigeDeviceModel::create(config()).value()) {}
  static GigeCameraConfig config() {
    GigeCameraConfig c;
    c.formats = {PixelFormat::mono8, PixelFormat::mono12p, PixelFormat::mono16, PixelFormat::bayer_rg8,
                 PixelFormat::rgb8};
    return c;
  }
  GvStatus write(std::uint32_t address, std::uint32_t value, Endpoint from = kAlice) {
    const RegisterWrite w{address, value};
    return ask(encode_write_register_cmd(next_id(), std::span(&w, 1)), from).status;
  }
  GvStatus write_double(std::uint32_t address, double value) {
    std::array<std::uint8_t, 8> b{};
    store_be(b, 0, value);
    return ask(encode_write_memory_cmd(next_id(), address, b), kAlice).status;
  }
  GvStatus read(std::uint32_t address, std::uint32_t& value, Endpoint from = kAlice) {
    const auto a = ask(encode_read_register_cmd(next_id(), std::span(&address, 1)), from);
    if (const auto* r = std::get_if<ReadRegisterAck>(&a.body)) value = r->values.items[0];
    return a.status;
  }
  std::uint32_t get(std::uint32_t address) {
    std::uint32_t v = 0xDEAD;
    EXPECT_EQ(read(address, v), GvStatus::success);
    return v;
  }
  GvcpAck ask(const Datagram& d, Endpoint from) {
    last = model.handle_gvcp(from, d, now);
    GvcpAck a;
    EXPECT_EQ(decode_gvcp_ack(last.ack, a), DecodeStatus::ok);
    return a;
  }
  std::uint16_t next_id() { return ++id; }
  /// One exposure with its block, at the model's own time; nothing where none is due by `until`.
  std::optional<OutgoingBlock> expose(DeviceTime until, FrameRequest* request = nullptr) {
    const auto t = model.next_exposure();
    if (t > until) return std::nullopt;
    FrameJob job;
    if (!model.begin_frame(t, job)) return std::nullopt;
    if (request != nullptr) *request = job.request;
    std::fill(job.picture().begin(), job.picture().end(), std::uint8_t{1});
    return model.finish_frame(std::move(job), true);
  }
  void open() {
    ASSERT_EQ(write(reg::kControlPrivilege, reg::kPrivilegeControl), GvStatus::success);
    ASSERT_EQ(write(reg::kStreamDestination, kAlice.ip), GvStatus::success);
    ASSERT_EQ(write(reg::kStreamPort, 5001), GvStatus::success);
  }

  GigeDeviceModel model;
  DeviceTime now = DeviceTime(1'000'000'000);
  GvcpAnswer last;
  std::uint16_t id = 0;
};

}  // namespace rigor::gige::testing
