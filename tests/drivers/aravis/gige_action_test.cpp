// Action commands at the emulated camera, and the clock and bookkeeping of whoever sends them.
#include <gtest/gtest.h>

#include <cstdlib>

#include "drivers/aravis/action_group.h"
#include "drivers/aravis/gige_client.h"
#include "drivers/aravis/gige_memory_link.h"

namespace rigor::gige {
namespace {

constexpr std::uint32_t kDevice = 0x4711, kGroup = 7, kMask = 0x6;

struct ActionRig {
  explicit ActionRig(bool ptp = true, bool extended = true)
      : model(GigeDeviceModel::create(config(ptp)).value()) {
    link.advance(now);
    EXPECT_TRUE(client.connect());
    EXPECT_TRUE(client.set_exposure(milliseconds(5)));
    EXPECT_TRUE(client.write(reg::kTriggerMode, 1));
    EXPECT_TRUE(client.write(reg::kTriggerSource, reg::kTriggerSourceAction0));
    EXPECT_TRUE(client.write(reg::kActionDeviceKey, kDevice));
    EXPECT_TRUE(client.write(reg::kActionGroupKey, kGroup));
    EXPECT_TRUE(client.write(reg::kActionGroupMask, kMask));
    if (extended) {
      EXPECT_TRUE(client.write(reg::kGvcpConfiguration, reg::kExtendedStatus));
    }
    if (ptp) {
      EXPECT_TRUE(client.write(reg::kPtpEnable, 1));
    }
    EXPECT_TRUE(client.start());
    (void)run(milliseconds(200));
  }
  static GigeCameraConfig config(bool ptp) {
    GigeCameraConfig c;
    c.ptp = {.present = ptp, .settle = milliseconds(100), .offset = {}};
    return c;
  }
  /// Instants at which exposures began, as ticks.
  std::vector<std::uint64_t> run(Duration span) {
    std::vector<std::uint64_t> began;
    for (const auto end = now + span; now < end; now = now + milliseconds(1)) {
      link.advance(now);
      AssembledFrame f;
      while (client.poll(now, f)) began.push_back(f.leader.timestamp_ticks);
    }
    return began;
  }
  [[nodiscard]] std::uint64_t in(Duration d) const { return static_cast<std::uint64_t>((now + d).ns()); }
  GvStatus act(std::optional<std::uint64_t> t) {
    const auto s = client.action({kDevice, kGroup, kMask, t});
    EXPECT_TRUE(s) << s.error().text();
    return s.value_or(GvStatus::local_problem);
  }
  DeviceTime now{1'000'000'000};
  GigeDeviceModel model;
  GigeMemoryLink link{model, [](const FrameRequest&, MutableBytes out) {
                        std::fill(out.begin(), out.end(), std::uint8_t{7});
                        return true;
                      }};
  GigeClient client{link};
};

TEST(GigeAction, ACommandWithoutATimeExposesAtOnce) {
  ActionRig rig(false);
  EXPECT_TRUE(rig.run(milliseconds(50)).empty());
  const auto t = rig.in({});
  rig.link.advance(rig.now);
  EXPECT_EQ(rig.act({}), GvStatus::success);
  EXPECT_EQ(rig.run(milliseconds(50)), std::vector{t});
  EXPECT_FALSE(rig.client.trigger()) << "a software trigger while actions are the source";
}

TEST(GigeAction, AScheduledOneExposesAtItsInstantToTheNanosecond) {
  ActionRig rig;
  std::vector<std::uint64_t> wanted;
  for (const auto ahead : {31'234'567, 11'000'001, 20'000'000})  // not in order
    wanted.push_back(rig.in(nanoseconds(ahead)));
  for (const auto t : wanted) EXPECT_EQ(rig.act(t), GvStatus::success);
  std::sort(wanted.begin(), wanted.end());
  EXPECT_EQ(rig.run(milliseconds(80)), wanted);
  // With a delay between trigger and exposure.
  EXPECT_TRUE(rig.client.write_double(reg::kTriggerDelay, 1500));
  const auto t = rig.in(milliseconds(9));
  EXPECT_EQ(rig.act(t), GvStatus::success);
  EXPECT_EQ(rig.run(milliseconds(50)), std::vector{t + 1'500'000});
  EXPECT_EQ(rig.model.counters().actions, 4u);
}

TEST(GigeAction, OneThatComesTooLateIsExecutedAtOnceAndSaysSo) {
  ActionRig rig;
  rig.link.advance(rig.now);
  const auto t = rig.in({});
  EXPECT_EQ(rig.act(t), GvStatus::action_late);
  EXPECT_EQ(rig.run(milliseconds(50)), std::vector{t});
  EXPECT_EQ(rig.act(0), GvStatus::action_late);
  EXPECT_EQ(rig.model.counters().actions_late, 2u);
}

TEST(GigeAction, WithoutAMasterATimeMeansNothing) {
  ActionRig without(false);
  EXPECT_EQ(without.act(without.in(milliseconds(5))), GvStatus::no_reference_time);
  EXPECT_TRUE(without.run(milliseconds(50)).empty()) << "it is not executed";
  EXPECT_EQ(without.client.read(reg::kGvcpCapability).value() & reg::kScheduledAction, 0u);
  ActionRig rig;
  EXPECT_TRUE(rig.client.write(reg::kPtpEnable, 0));
  EXPECT_TRUE(rig.client.write(reg::kPtpEnable, 1));
  EXPECT_EQ(rig.act(rig.in(milliseconds(5))), GvStatus::no_reference_time) << "the clock listens";
  (void)rig.run(milliseconds(150));
  EXPECT_EQ(rig.act(rig.in(milliseconds(5))), GvStatus::success);
  EXPECT_EQ(rig.model.counters().actions_refused, 1u);
}

TEST(GigeAction, AFullQueueOverflows) {
  ActionRig rig;
  const auto size = rig.client.read(reg::kActionQueueSize).value();
  EXPECT_GE(size, 10u);
  const auto first = rig.in(milliseconds(10));
  for (std::uint32_t i = 0; i < size; ++i) EXPECT_EQ(rig.act(first + i * 10'000'000), GvStatus::success) << i;
  EXPECT_EQ(rig.act(first + size * 10'000'000), GvStatus::overflow);
  EXPECT_EQ(rig.run(milliseconds(10) * (size + 3)).size(), size);
  EXPECT_EQ(rig.act(rig.in(seconds(400'000'000))), GvStatus::invalid_parameter);
}

TEST(GigeAction, ClientsThatDoNotKnowTheNewCodesGetAPlainError) {
  ActionRig rig(true, false);
  EXPECT_EQ(rig.act(1), GvStatus::error);
  EXPECT_EQ(rig.run(milliseconds(50)).size(), 1u) << "executed all the same";
}

TEST(GigeAction, WhatIsForOthersIsNotAnsweredAndNotObeyed) {
  ActionRig rig;
  const auto t = rig.in(milliseconds(5));
  const ActionCmd others[] = {{kDevice + 1, kGroup, kMask, t},
                              {kDevice, kGroup + 1, kMask, t},
                              {kDevice, kGroup, 0x9, t},
                              {kDevice, kGroup, 0, t}};
  for (const ActionCmd& c : others) {
    const auto s = rig.client.action(c);
    ASSERT_FALSE(s);
    EXPECT_EQ(s.error().code, ErrorCode::timeout);
  }
  EXPECT_TRUE(rig.run(milliseconds(50)).empty());
  EXPECT_TRUE(rig.client.action({kDevice, kGroup, 0x4, {}})) << "one bit in common is enough";
  EXPECT_EQ(rig.run(milliseconds(50)).size(), 1u);
}

TEST(GigeAction, NobodysCameraObeysOnlyWhereItIsTold) {
  auto model = GigeDeviceModel::create({}).value();
  const Endpoint anyone{0x7F000001, 5000};
  const DeviceTime now(1'000'000'000);
  const auto silent = [&](std::uint16_t id) {
    return model.handle_gvcp(anyone, encode_action_cmd(id, {0, 0, 1, {}}), now).ack.empty();
  };
  const auto write = [&](std::uint16_t id, std::uint32_t address, std::uint32_t value) {
    const RegisterWrite w{address, value};
    GvcpAck a;
    EXPECT_EQ(decode_gvcp_ack(
                  model.handle_gvcp(anyone, encode_write_register_cmd(id, std::span(&w, 1)), now).ack, a),
              DecodeStatus::ok);
    EXPECT_EQ(a.status, GvStatus::success);
  };
  write(1, reg::kControlPrivilege, reg::kPrivilegeControl);
  write(2, reg::kActionGroupMask, 1);
  EXPECT_FALSE(silent(3));
  write(4, reg::kControlPrivilege, 0);
  EXPECT_TRUE(silent(5));
  write(6, reg::kControlPrivilege, reg::kPrivilegeControl);
  write(7, reg::kGvcpConfiguration, reg::kUnconditionalAction);
  write(8, reg::kControlPrivilege, 0);
  EXPECT_FALSE(silent(9));
}

TEST(GigeAction, TheSameDatagramTwiceIsOneAction) {
  ActionRig rig;
  const auto t = rig.in(milliseconds(5));
  const auto command = encode_action_cmd(900, {kDevice, kGroup, kMask, t});
  const Endpoint sender{0x7F000001, 7000};
  const auto first = rig.model.handle_gvcp(sender, command, rig.now).ack;
  EXPECT_TRUE(rig.client.write(reg::kStreamPacketDelay, 0)) << "and something else in between";
  EXPECT_EQ(rig.model.handle_gvcp(sender, command, rig.now).ack, first);
  EXPECT_EQ(rig.run(milliseconds(50)), std::vector{t});
  EXPECT_EQ(rig.model.counters().actions, 1u);
}

TEST(GigeAction, AnActionWhileTheSensorIsExposedIsMissed) {
  ActionRig rig;
  const auto t = rig.in(milliseconds(5));
  EXPECT_EQ(rig.act(t), GvStatus::success);
  EXPECT_EQ(rig.act(t + 2'000'000), GvStatus::success);
  EXPECT_EQ(rig.act(t + 6'000'000), GvStatus::success);
  EXPECT_EQ(rig.run(milliseconds(60)), (std::vector{t, t + 6'000'000}));
  EXPECT_EQ(rig.model.counters().actions_missed, 1u);
  EXPECT_EQ(rig.model.counters().line_missed, 0u);
}

TEST(GigeAction, WhatIsScheduledEndsWithControl) {
  ActionRig rig;
  EXPECT_EQ(rig.act(rig.in(milliseconds(40))), GvStatus::success);
  EXPECT_TRUE(rig.client.disconnect());
  EXPECT_TRUE(rig.client.connect());
  EXPECT_TRUE(rig.client.start());
  EXPECT_TRUE(rig.run(milliseconds(100)).empty());
  // And an action while another trigger is the source does nothing.
  EXPECT_TRUE(rig.client.write(reg::kTriggerSource, reg::kTriggerSourceSoftware));
  EXPECT_EQ(rig.act(rig.in(milliseconds(5))), GvStatus::success);
  EXPECT_TRUE(rig.run(milliseconds(50)).empty());
}

TEST(ActionGroup, GivesEveryMemberTheSameTimeForOneInstant) {
  const auto group = ActionGroup::join(1, 2);
  EXPECT_EQ(ActionGroup::join(1, 2), group);
  EXPECT_NE(ActionGroup::join(1, 3), group);
  EXPECT_NE(ActionGroup::join(2, 2), group);
  const BenchTime t(50'000'000'000);
  EXPECT_FALSE(group->time_of(t)) << "no clock yet";
  const int a = 0, b = 0;
  const Duration ahead = seconds(7);
  const auto latch = [&](const void* member, BenchTime at, Duration off) {
    group->add_latch(member, DeviceTime((at + ahead + off).ns()), at - microseconds(20),
                     at + microseconds(20));
  };
  for (int n = 0; n < 5; ++n) latch(&a, t + milliseconds(100) * n, {});
  const BenchTime due = t + seconds(1);
  const auto x = group->time_of(due);
  ASSERT_TRUE(x);
  EXPECT_LT(std::abs(x->ns() - (due + ahead).ns()), 50'000);
  for (int n = 5; n < 9; ++n) latch(&a, t + milliseconds(100) * n, microseconds(9));
  EXPECT_EQ(group->time_of(due), x) << "whoever asks later";
  EXPECT_NE(group->time_of(due + milliseconds(40)), x);
  // Another member's latches do not move the clock while the first one's come.
  const BenchTime later = t + seconds(2);
  EXPECT_EQ(group->distance(DeviceTime((later + ahead).ns()), later, later + microseconds(40)), Duration());
  EXPECT_GT(group->distance(DeviceTime((later + ahead + seconds(1)).ns()), later, later), milliseconds(900));
  EXPECT_GT(group->distance(DeviceTime((later + ahead - seconds(1)).ns()), later, later), milliseconds(900));
  for (int n = 0; n < 5; ++n) latch(&b, later + milliseconds(100) * n, seconds(1));
  EXPECT_LT(std::abs(group->time_of(later)->ns() - (later + ahead).ns()), 100'000);
  // When they come no longer, they do.
  const BenchTime much_later = t + seconds(20);
  for (int n = 0; n < 5; ++n) latch(&b, much_later + milliseconds(100) * n, seconds(1));
  EXPECT_LT(std::abs(group->time_of(much_later + seconds(1))->ns() - (much_later + ahead + seconds(2)).ns()),
            100'000);
}

TEST(ActionGroup, StatisticsAreGoodWhereAllIsInTime) {
  ActionStatistics s;
  EXPECT_TRUE(s.good());
  s.sent = 101, s.in_time = 100, s.exposed = 97;
  EXPECT_TRUE(s.good());
  for (auto field : {&ActionStatistics::late, &ActionStatistics::refused, &ActionStatistics::not_sent}) {
    ActionStatistics bad = s;
    bad.*field = 1;
    EXPECT_FALSE(bad.good());
  }
  ActionStatistics unanswered = s;
  unanswered.in_time = 90;
  EXPECT_FALSE(unanswered.good());
  ActionStatistics elsewhere = s;
  elsewhere.exposed = 3;
  EXPECT_FALSE(elsewhere.good());
  s.jitter_max = milliseconds(1);
  EXPECT_FALSE(s.good());
  EXPECT_NE(s.text().find("101 action commands, 100 in time"), std::string::npos);
}

}  // namespace
}  // namespace rigor::gige
