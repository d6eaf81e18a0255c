// Simulator, pair and replay run through the suite; device backends do so in tests/conformance.
#include "sensor-hal/conformance/conformance.h"

#include "sensor-hal/channel/fault_source.h"
#include "sensor-hal/channel/simulated_sink.h"
#include "sensor-hal/record/recorder.h"
#include "sensor-hal/record/replay_source.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::conformance {
namespace {

using test::FormulaImages;
using test::image_config;

class Simulated : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    return std::make_unique<SimulatedSource>(std::make_shared<FormulaImages>(), &joint_, workers_);
  }
  ChannelConfig config() override { return image_config("{slots: 6, exposure_us: 1000}"); }
  ChannelConfig config_with_unknown_key() override { return image_config("{slots: 6, no_such_key: 1}"); }
  std::size_t slots() const override { return 6; }

 private:
  test::TurningJoint joint_;
  WorkerPool workers_{2};
};
class SimulatedWall : public Simulated {
 public:
  bool virtual_time() const override { return false; }
};

template <SampleKind kind, bool in_virtual_time>
class SimulatedSamples : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    return std::make_unique<SimulatedSource>(std::make_shared<test::FormulaSamples>(kind), &joint_, workers_);
  }
  ChannelConfig config() override { return test::sample_config(kind, "{slots: 6}"); }
  ChannelConfig config_with_unknown_key() override {
    return test::sample_config(kind, "{slots: 6, no_such_key: 1}");
  }
  std::size_t slots() const override { return 6; }
  bool virtual_time() const override { return in_virtual_time; }

 private:
  test::TurningJoint joint_;
  WorkerPool workers_{2};
};
using SimulatedPoints = SimulatedSamples<SampleKind::point_cloud, true>;
using SimulatedPointsWall = SimulatedSamples<SampleKind::point_cloud, false>;
using SimulatedRange = SimulatedSamples<SampleKind::range_image, true>;
using SimulatedRangeWall = SimulatedSamples<SampleKind::range_image, false>;

class Paired : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    return std::make_unique<PairSource>(
        std::make_unique<SimulatedSource>(std::make_shared<FormulaImages>(), &joint_, workers_),
        std::make_unique<SimulatedSource>(std::make_shared<FormulaImages>(64, 48, 3), &joint_, workers_),
        workers_);
  }
  ChannelConfig config() override { return image_config("{real: {slots: 8}, simulated: {slots: 8}}"); }
  ChannelConfig config_with_unknown_key() override {
    return image_config("{real: {slots: 8}, simulated: {slots: 8}, no_such_key: 1}");
  }
  // Of the real side; the pair itself keeps the newest sample of each side.
  std::size_t slots() const override { return 8; }
  bool gives_only_lease() const override { return false; }

 private:
  test::TurningJoint joint_;
  WorkerPool workers_{2};
};
class PairedWall : public Paired {
 public:
  bool virtual_time() const override { return false; }
};
class PairedSimulated final : public Paired {
 public:
  ChannelConfig config() override {
    return image_config("{active: simulated, real: {slots: 8}, simulated: {slots: 8}}");
  }
};

/// Records a second of a simulated channel first.
class Replayed : public SourceUnderTest {
 public:
  Replayed() {
    RecorderOptions options;
    options.virtual_time = true;
    WorkerPool workers(1);
    SimulatedSource source(std::make_shared<FormulaImages>(), nullptr, workers);
    ArmContext context;
    context.virtual_time = true;
    if (!source.configure(image_config("")) || !source.arm(context) || !source.start(BenchTime(0))) return;
    RecordedChannel channel;
    channel.name = "left";
    channel.description = source.describe();
    auto recorder = Recorder::create(directory_.file("run.mcap"), options, {channel}, {}, {});
    if (!recorder) return;
    (*recorder)->begin(BenchTime(0));
    for (int k = 0; k < 1000; ++k) {
      const BenchTime now = BenchTime(0) + milliseconds(k);
      source.complete_until(now);
      while (SampleLease s = source.poll(now)) (*recorder)->record(0, s);
      source.begin_cycle(now);
      (*recorder)->end_cycle(static_cast<std::uint64_t>(k), now);
    }
    if (!(*recorder)->stop()) return;
    if (auto opened = Recording::open(directory_.file("run.mcap"))) recording_ = *opened;
  }
  std::unique_ptr<Source> make() override {
    return recording_ ? std::make_unique<ReplaySource>(recording_) : nullptr;
  }
  ChannelConfig config() override { return image_config("{slots: 6}"); }
  ChannelConfig config_with_unknown_key() override { return image_config("{slots: 6, no_such_key: 1}"); }
  std::size_t slots() const override { return 6; }

 private:
  test::TemporaryDirectory directory_;
  std::shared_ptr<const Recording> recording_;
};
class ReplayedLater final : public Replayed {
 public:
  BenchTime virtual_t0() const override { return BenchTime(0) + seconds(1000); }
};

/// Any of the above behind a decorator: without faults it is as if it was not there.
template <class Inner>
class Faulty : public Inner {
 public:
  std::unique_ptr<Source> make() override {
    return std::make_unique<FaultySource>(Inner::make(), &fault_workers_);
  }

 private:
  WorkerPool fault_workers_{1};
};
/// With faults that leave what the suite asks for: order, times, counts.
template <class Inner>
class Noisy final : public Faulty<Inner> {
 public:
  ChannelConfig config() override {
    return image_config(
        "{slots: 6, faults: [{kind: noise, sigma_dn: 3}, {kind: corrupt, flips: 4, probability: 0.5}, "
        "{kind: drop, every_s: 10, for_s: 1, from_s: 5}]}");
  }
  // The decorator's own, which hold what was changed.
  std::size_t slots() const override { return 32; }
};

INSTANTIATE_TEST_SUITE_P(Faulty, SourceConformance,
                         testing::Values(under_test<Faulty<Simulated>>("simulated"),
                                         under_test<Faulty<SimulatedWall>>("simulated_wall"),
                                         under_test<Faulty<SimulatedRangeWall>>("simulated_range_image_wall"),
                                         under_test<Faulty<Paired>>("pair"),
                                         under_test<Faulty<PairedWall>>("pair_wall"),
                                         under_test<Faulty<Replayed>>("replay"),
                                         under_test<Noisy<Simulated>>("noisy_simulated"),
                                         under_test<Noisy<SimulatedWall>>("noisy_simulated_wall"),
                                         under_test<Noisy<Replayed>>("noisy_replay")),
                         name_of_case);

/// A pair whose real side has faults of its own.
class PairedFaulty final : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    auto real = std::make_unique<SimulatedSource>(std::make_shared<FormulaImages>(), &joint_, workers_);
    std::unique_ptr<FollowerSource> simulated =
        std::make_unique<SimulatedSource>(std::make_shared<FormulaImages>(64, 48, 3), &joint_, workers_);
    return std::make_unique<PairSource>(
        std::make_unique<FaultySource>(std::unique_ptr<Source>(std::move(real)), &workers_),
        std::make_unique<FaultySource>(std::move(simulated), &workers_, FrameSignalFinder{}), workers_);
  }
  ChannelConfig config() override {
    return image_config(
        "{active: simulated, real: {slots: 12, faults: [{kind: drop, probability: 0.1}]}, "
        "simulated: {slots: 12, faults: [{kind: noise, sigma_dn: 2}]}}");
  }
  ChannelConfig config_with_unknown_key() override {
    return image_config("{real: {no_such_key: 1}, simulated: {slots: 8}}");
  }
  std::size_t slots() const override { return 32; }
  bool gives_only_lease() const override { return false; }

 private:
  test::TurningJoint joint_;
  WorkerPool workers_{2};
};
INSTANTIATE_TEST_SUITE_P(FaultyPair, SourceConformance,
                         testing::Values(under_test<PairedFaulty>("pair_with_faulty_sides")), name_of_case);

INSTANTIATE_TEST_SUITE_P(Hal, SourceConformance,
                         testing::Values(under_test<Simulated>("simulated"),
                                         under_test<SimulatedWall>("simulated_wall"),
                                         under_test<SimulatedPoints>("simulated_point_cloud"),
                                         under_test<SimulatedPointsWall>("simulated_point_cloud_wall"),
                                         under_test<SimulatedRange>("simulated_range_image"),
                                         under_test<SimulatedRangeWall>("simulated_range_image_wall"),
                                         under_test<Paired>("pair"), under_test<PairedWall>("pair_wall"),
                                         under_test<PairedSimulated>("pair_hands_on_simulated"),
                                         under_test<Replayed>("replay"),
                                         under_test<ReplayedLater>("replay_shifted")),
                         name_of_case);

/// Speed and turn rate of something that keeps what it was given.
class Wheels final : public SignalModel {
 public:
  const std::vector<Signal>& signals() const override { return signals_; }
  double read(std::size_t signal, BenchTime) override {
    const std::lock_guard lock(mutex_);
    return value_.at(signal);
  }
  bool write(std::size_t signal, double value, BenchTime) override {
    const std::lock_guard lock(mutex_);
    value_.at(signal) = value;
    return true;
  }

 private:
  std::vector<Signal> signals_{{"v", "m/s", true}, {"w", "rad/s", true}};
  std::mutex mutex_;
  std::array<double, 2> value_{};
};

class SimulatedCommands final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    return std::make_unique<SimulatedSink>(std::make_shared<Wheels>());
  }
  ChannelConfig config() override { return of("{signals: [v, w], safe: {v: 0, w: 0}}"); }
  ChannelConfig config_with_unknown_key() override { return of("{signals: [v], no_such_key: 1}"); }

 private:
  static ChannelConfig of(const std::string& keys) {
    ChannelConfig c = image_config(keys);
    c.kind = SampleKind::none;
    return c;
  }
};
INSTANTIATE_TEST_SUITE_P(Hal, LifecycleConformance,
                         testing::Values(channel_under_test<SimulatedCommands>("simulated_sink")),
                         name_of_channel_case);
INSTANTIATE_TEST_SUITE_P(Hal, SinkConformance,
                         testing::Values(channel_under_test<SimulatedCommands>("simulated_sink")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
