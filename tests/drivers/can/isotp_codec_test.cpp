// ISO-TP: sender against receiver, and frames against the standard's examples.
#include "drivers/can/isotp_codec.h"

#include <gtest/gtest.h>

#include <numeric>
#include <string>

namespace rigor::can {
namespace {

std::vector<std::uint8_t> counting(std::size_t n) {
  std::vector<std::uint8_t> v(n);
  std::iota(v.begin(), v.end(), std::uint8_t{0});
  return v;
}
IsoTpOptions side(bool sender) {
  IsoTpOptions o;
  o.tx_id = sender ? 0x7e0 : 0x7e8;
  o.rx_id = sender ? 0x7e8 : 0x7e0;
  return o;
}
CanFrame frame(std::uint32_t id, std::initializer_list<std::uint8_t> data) {
  CanFrame f;
  f.id = id;
  f.length = static_cast<std::uint8_t>(data.size());
  std::copy(data.begin(), data.end(), f.data.begin());
  return f;
}

/// Runs both machines on one line until the sender is done; returns how many frames went each way.
struct Traffic {
  int data = 0, flow = 0;
  BenchTime end;
};
Traffic run(IsoTpSender& sender, IsoTpReceiver& receiver, BenchTime t) {
  Traffic out;
  while (sender.state() == IsoTpState::busy && out.data < 100000) {
    if (sender.next_event() == BenchTime::never()) break;
    t = std::max(t, sender.next_event());
    auto f = sender.next(t);
    if (!f) continue;
    ++out.data;
    if (auto answer = receiver.receive(*f, t)) {
      ++out.flow;
      sender.receive(*answer, t);
    }
  }
  out.end = t;
  return out;
}

TEST(IsoTp, AShortMessageIsOneFrame) {
  IsoTpSender sender(side(true));
  ASSERT_TRUE(sender.start(counting(3), BenchTime(0)));
  const auto f = sender.next(BenchTime(0));
  ASSERT_TRUE(f);
  EXPECT_EQ(f->id, 0x7e0u);
  EXPECT_EQ(f->length, 4);
  EXPECT_EQ(f->data[0], 0x03);
  EXPECT_EQ(f->data[3], 2);
  EXPECT_EQ(sender.state(), IsoTpState::done);
}

TEST(IsoTp, MessagesOfAllLengthsComeThrough) {
  for (const bool fd : {false, true})
    for (const std::size_t n : {1u, 7u, 8u, 20u, 62u, 63u, 100u, 4095u, 4096u, 70000u}) {
      auto a = side(true), b = side(false);
      a.fd = b.fd = fd;
      b.block_size = n % 2 ? 0 : 5;
      IsoTpSender sender(a);
      IsoTpReceiver receiver(b);
      ASSERT_TRUE(sender.start(counting(n), BenchTime(0)));
      const auto traffic = run(sender, receiver, BenchTime(0));
      EXPECT_EQ(sender.state(), IsoTpState::done) << n;
      ASSERT_EQ(receiver.state(), IsoTpState::done) << n;
      const auto message = receiver.message();
      EXPECT_EQ(std::vector<std::uint8_t>(message.begin(), message.end()), counting(n)) << n;
      if (!fd && n == 20) {
        EXPECT_EQ(traffic.data, 3);  // 6 + 7 + 7
        EXPECT_EQ(traffic.flow, 1);
      }
    }
}

TEST(IsoTp, BlocksAndSeparationAreKept) {
  auto b = side(false);
  b.block_size = 2;
  b.separation = 10;  // ms
  IsoTpSender sender(side(true));
  IsoTpReceiver receiver(b);
  ASSERT_TRUE(sender.start(counting(6 + 7 * 6), BenchTime(0)));
  const auto traffic = run(sender, receiver, BenchTime(0));
  EXPECT_EQ(traffic.data, 7);
  EXPECT_EQ(traffic.flow, 3);
  EXPECT_EQ(traffic.end, BenchTime(milliseconds(30).ns())) << "three pauses within the blocks";
  EXPECT_EQ(separation_time(0xf3), microseconds(300));
  EXPECT_EQ(separation_time(0x80), milliseconds(127));
}

TEST(IsoTp, WhoDoesNotAnswerIsGivenUp) {
  IsoTpSender sender(side(true));
  ASSERT_TRUE(sender.start(counting(50), BenchTime(0)));
  ASSERT_TRUE(sender.next(BenchTime(0)));
  EXPECT_FALSE(sender.next(BenchTime(seconds(1).ns() - 1)));
  EXPECT_EQ(sender.state(), IsoTpState::busy);
  EXPECT_FALSE(sender.next(BenchTime(seconds(1).ns())));
  EXPECT_EQ(sender.state(), IsoTpState::timed_out);
  IsoTpReceiver receiver(side(false));
  ASSERT_TRUE(receiver.receive(frame(0x7e0, {0x10, 20, 1, 2, 3, 4, 5, 6}), BenchTime(0)));
  receiver.check(BenchTime(seconds(1).ns()));
  EXPECT_EQ(receiver.state(), IsoTpState::timed_out);
}

TEST(IsoTp, WaitsAndOverflowsAreObeyed) {
  IsoTpSender sender(side(true));
  ASSERT_TRUE(sender.start(counting(50), BenchTime(0)));
  ASSERT_TRUE(sender.next(BenchTime(0)));
  sender.receive(frame(0x7e8, {0x31, 0, 0}), BenchTime(milliseconds(900).ns()));
  EXPECT_FALSE(sender.next(BenchTime(milliseconds(1800).ns())));
  EXPECT_EQ(sender.state(), IsoTpState::busy) << "a wait gives another second";
  sender.receive(frame(0x7e8, {0x32, 0, 0}), BenchTime(milliseconds(1801).ns()));
  EXPECT_EQ(sender.state(), IsoTpState::overflow);
  auto small = side(false);
  small.most_bytes = 100;
  IsoTpReceiver receiver(small);
  const auto answer = receiver.receive(frame(0x7e0, {0x1f, 0xff, 1, 2, 3, 4, 5, 6}), BenchTime(0));
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->data[0], 0x32);
  EXPECT_EQ(receiver.state(), IsoTpState::overflow);
}

TEST(IsoTp, AFrameThatIsMissingEndsTheMessage) {
  IsoTpReceiver receiver(side(false));
  ASSERT_TRUE(receiver.receive(frame(0x7e0, {0x10, 20, 1, 2, 3, 4, 5, 6}), BenchTime(0)));
  EXPECT_FALSE(receiver.receive(frame(0x7e0, {0x22, 7, 8, 9, 10, 11, 12, 13}), BenchTime(1)));
  EXPECT_EQ(receiver.state(), IsoTpState::wrong_frame);
  // And the next begins anew.
  EXPECT_FALSE(receiver.receive(frame(0x7e0, {0x02, 7, 8}), BenchTime(2)));
  EXPECT_EQ(receiver.state(), IsoTpState::done);
  EXPECT_EQ(receiver.message().size(), 2u);
  // Frames of others are nobody's business.
  EXPECT_FALSE(receiver.receive(frame(0x7e1, {0x02, 1, 1}), BenchTime(3)));
  EXPECT_EQ(receiver.message()[0], 7);
}

}  // namespace
}  // namespace rigor::can
