// The thread that sinks share which give each command at its instant.
#include "sensor-hal/channel/paced_sink.h"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "sensor-hal/config/yaml.h"

namespace rigor::test {
namespace {

/// Its device takes long just before a command is due, and the loop ends meanwhile.
class SlowSink final : public PacedSink {
 public:
  explicit SlowSink(Heartbeat& loop) : loop_(loop) {}
  ~SlowSink() override {
    if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
  }
  BenchTime due = BenchTime::never();
  std::atomic<int> applied{0}, after_the_loop{0};
  std::atomic<bool> safe{false};

 protected:
  Status do_configure(const ChannelConfig&) override {
    description_.kind = SampleKind::register_block;
    return {};
  }
  Status do_arm(const ArmContext& context) override {
    if (auto s = open_ring(context.loop_period); !s) return s;
    start_thread();
    return {};
  }
  Status do_stop() override {
    stop_thread();
    return {};
  }
  void tick() override {
    if (over_ || !origin().get() || bench_now() < due - milliseconds(20)) return;
    while (bench_now() <= due) std::this_thread::yield();
    loop_.declare_stopped(StopReason::requested);
    over_ = true;
  }
  void apply(const Command&) override { ++applied; }
  void keep_safe() override { safe = true; }
  void after() override {
    if (over_) ++after_the_loop;
  }

 private:
  Heartbeat& loop_;
  bool over_ = false;
};

TEST(PacedSink, GivesNothingMoreOnceTheLoopEndedWhileItsDeviceTookLong) {
  Heartbeat loop;
  loop.restart(false);
  SlowSink sink(loop);
  ChannelConfig config;
  config.name = "table";
  config.kind = SampleKind::register_block;
  config.params = *ConfigDocument::parse("{}", "rig.yaml");
  ASSERT_TRUE(sink.configure(config));
  sink.watch(&loop, seconds(100));
  Command c;
  c.t_effect = sink.due = bench_now() + milliseconds(100);
  ASSERT_TRUE(sink.arm({}));
  loop.beat(bench_now());
  ASSERT_TRUE(sink.start(bench_now()));
  EXPECT_TRUE(sink.command(c));
  while (!sink.safe) std::this_thread::yield();
  EXPECT_TRUE(sink.stop());
  EXPECT_EQ(sink.applied, 0);
  EXPECT_EQ(sink.after_the_loop, 0);
  EXPECT_EQ(sink.counters(), (SinkSnapshot{.accepted = 1, .dropped = 1, .made_safe = 1}));
}

}  // namespace
}  // namespace rigor::test
