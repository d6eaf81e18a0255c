// The bus of virtual time: arbitration, durations, order.
#include "drivers/can/virtual_bus.h"

#include <gtest/gtest.h>

#include <limits>
#include <vector>

namespace rigor::can {
namespace {

CanFrame frame(std::uint32_t id, std::uint8_t length = 8) {
  CanFrame f;
  f.id = id;
  f.length = length;
  return f;
}

struct Station final : VirtualBus::Participant {
  Station(VirtualBus& b, VirtualBus::Rank rank) : bus(b) { bus.join(this, rank); }
  ~Station() override { bus.leave(this); }
  BenchTime next_action(BenchTime now) const noexcept override {
    return at < plan.size() && plan[at].first <= now ? plan[at].first : BenchTime::never();
  }
  void act(BenchTime t) override {
    acted.push_back(t);
    EXPECT_TRUE(bus.send(this, frame(plan[at++].second)));
  }
  void receive(const CanFrame& f, BenchTime t) override { seen.emplace_back(t, f.id); }
  VirtualBus& bus;
  std::vector<std::pair<BenchTime, std::uint32_t>> plan;
  std::size_t at = 0;
  std::vector<BenchTime> acted;
  std::vector<std::pair<BenchTime, std::uint32_t>> seen;
};

const BitRates kRates{500'000, 2'000'000};

TEST(VirtualBus, TheSmallestIdentifierWinsAndTheOthersWait) {
  VirtualBus bus(kRates);
  Station a(bus, VirtualBus::Rank::node), b(bus, VirtualBus::Rank::node), ear(bus, VirtualBus::Rank::sample);
  const BenchTime t0(milliseconds(1).ns());
  a.plan = {{t0, 0x300}, {t0, 0x200}};
  b.plan = {{t0, 0x100}, {t0 + microseconds(10), 0x050}};
  bus.advance(t0 + milliseconds(10));
  ASSERT_EQ(ear.seen.size(), 4u);
  EXPECT_EQ(ear.seen[0].second, 0x100u);  // at t0 the smallest; 0x050 comes while it is on the bus
  EXPECT_EQ(ear.seen[1].second, 0x050u);
  EXPECT_EQ(ear.seen[2].second, 0x200u);
  EXPECT_EQ(ear.seen[3].second, 0x300u);
  BenchTime t = t0;
  for (const auto& [end, id] : ear.seen) {
    t = t + frame_duration(frame(id), kRates);
    EXPECT_EQ(end, t);
  }
  EXPECT_EQ(bus.frames(), 4u);
  EXPECT_EQ(bus.busy(), t - t0);
  // Nobody hears himself.
  ASSERT_EQ(a.seen.size(), 2u);
  EXPECT_EQ(a.seen[0].second, 0x100u);
}

TEST(VirtualBus, HowOftenItIsAskedChangesNothing) {
  std::vector<std::pair<BenchTime, std::uint32_t>> once;
  for (const auto step : {microseconds(10'000), microseconds(100), microseconds(7), microseconds(333)}) {
    VirtualBus bus(kRates);
    Station a(bus, VirtualBus::Rank::node), b(bus, VirtualBus::Rank::command),
        ear(bus, VirtualBus::Rank::sample);
    for (int i = 0; i < 20; ++i) {
      a.plan.emplace_back(BenchTime(0) + microseconds(300 * i), 0x400 - i);
      b.plan.emplace_back(BenchTime(0) + microseconds(450 * i), 0x100 + i);
    }
    for (BenchTime t(0); t <= BenchTime(milliseconds(20).ns()); t = t + step) bus.advance(t);
    EXPECT_EQ(ear.seen.size(), 40u);
    if (once.empty()) once = ear.seen;
    EXPECT_EQ(ear.seen, once) << step.ns();
  }
}

TEST(VirtualBus, CommandsActBeforeNodesAtOneInstant) {
  VirtualBus bus(kRates);
  Station node(bus, VirtualBus::Rank::node), command(bus, VirtualBus::Rank::command),
      ear(bus, VirtualBus::Rank::sample);
  node.plan = command.plan = {{BenchTime(5000), 0x123}};
  bus.advance(BenchTime(seconds(1).ns()));
  // Equal identifiers: whoever asked first goes first, and that is the command.
  ASSERT_EQ(node.seen.size(), 1u);
  ASSERT_EQ(command.seen.size(), 1u);
  EXPECT_LT(node.seen[0].first, command.seen[0].first);
}

TEST(VirtualBus, RemembersNothingOfTheRunBefore) {
  VirtualBus bus(kRates);
  {
    Station a(bus, VirtualBus::Rank::node);
    a.plan = {{BenchTime(0), 1}, {BenchTime(0), 2}};
    bus.advance(BenchTime(1000));
  }
  Station ear(bus, VirtualBus::Rank::sample), b(bus, VirtualBus::Rank::node);
  b.plan = {{BenchTime(0), 7}};
  bus.advance(BenchTime(seconds(1).ns()));
  ASSERT_EQ(ear.seen.size(), 1u);
  EXPECT_EQ(ear.seen[0].second, 7u);
}

}  // namespace
}  // namespace rigor::can
