// The pair: same instants, switches without a gap, statistics that are known beforehand.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <deque>
#include <map>
#include <numbers>
#include <set>

#include "sensor-hal/channel/fault_source.h"
#include "sensor-hal/channel/pair_values.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor {
namespace {

using test::FormulaImages;
using test::image_config;

/// A device whose samples the test places: instant, arrival, content.
class ScriptedDevice final : public Source {
 public:
  struct Shot {
    BenchTime t_capture, t_arrival;
  };
  std::deque<Shot> shots;
  Duration latency;

  SampleLease poll(BenchTime now) noexcept override {
    if (shots.empty() || shots.front().t_arrival > now) return {};
    const Shot shot = shots.front();
    shots.pop_front();
    SampleSlot s = pool_->try_acquire();
    if (!s) return {};
    Sample& sample = *s;
    sample.stamp = Stamp{};
    sample.stamp.sequence = 1000 + count_++;  // a device's own count: the pair must not use it
    sample.stamp.t_capture = shot.t_capture;
    sample.stamp.t_release = shot.t_capture + latency;
    sample.stamp.t_arrival = shot.t_arrival;
    ImageRequest r;
    r.t_capture = shot.t_capture;
    ImageInfo info;
    info.width_px = 64;
    info.height_px = 48;
    sample.info = info;
    sample.size_bytes = 64 * 48;
    FormulaImages::fill(r, sample.memory().first(sample.size_bytes), 0);
    health_.received.fetch_add(1);
    return s;
  }
  void set_connected(bool c) { health_.connected = c; }
  void count_loss(std::uint64_t n) { health_.lost += n, health_.reconnects += 1, health_.retries += 2; }

  struct Told {
    std::uint32_t code;
    double value;
    std::string text;
    BenchTime t;
  };
  std::deque<Told> told;
  SampleLease poll_event() noexcept override {
    if (told.empty()) return {};
    SampleSlot s = event_pool_->try_acquire();
    if (!s) return {};
    EventInfo info{.code = told.front().code, .value = told.front().value};
    std::strncpy(info.text.data(), told.front().text.c_str(), info.text.size() - 1);
    s->info = info;
    s->stamp.t_release = told.front().t;
    told.pop_front();
    return s;
  }
  [[nodiscard]] std::vector<std::string> warnings() const override {
    return {config().name + ": runs on its spare battery"};
  }

 private:
  Status do_configure(const ChannelConfig& c) override {
    latency = c.latency;
    description_.kind = SampleKind::image;
    description_.max_bytes = 64 * 48;
    description_.width_px = 64;
    description_.height_px = 48;
    return {};
  }
  Status do_arm(const ArmContext&) override {
    pool_ = make_sample_pool(16, 64 * 48);
    event_pool_ = make_sample_pool(2, 0);
    return {};
  }
  Status do_start(BenchTime) override {
    health_.connected = true;
    return {};
  }
  Status do_stop() override {
    health_.connected = false;
    return {};
  }
  std::unique_ptr<SamplePool> pool_, event_pool_;
  std::uint64_t count_ = 0;
};

class Log final : public PairObserver {
 public:
  void on_side_sample(PairSide side, const SampleLease& s) noexcept override {
    seen[static_cast<std::size_t>(side)].push_back(s->stamp);
    order.push_back(s->stamp.t_release);
  }
  std::array<std::vector<Stamp>, 2> seen;
  std::vector<BenchTime> order;
};

/// 10 ms period, 12 ms latency, 3 ms from capture to arrival. The simulated side's picture is the real one's
/// plus 3, if it is rendered for the same instant.
class PairTest : public testing::Test {
 protected:
  void make(const std::string& params = "", bool virtual_time = true, Period period = milliseconds(10)) {
    auto device = std::make_unique<ScriptedDevice>();
    device_ = device.get();
    make(std::move(device), params, virtual_time, period);
  }
  void make(std::unique_ptr<Source> device, const std::string& params, bool virtual_time = true,
            Period period = milliseconds(10)) {
    auto images = std::make_shared<FormulaImagesOfInstant>();
    pair_ = std::make_unique<PairSource>(
        std::move(device), std::make_unique<SimulatedSource>(images, nullptr, workers_), workers_);
    const auto s = pair_->configure(image_config(params, period));
    ASSERT_TRUE(s) << s.error().text();
    pair_->observe(&log_);
    ASSERT_TRUE(pair_->arm({.virtual_time = virtual_time}));
    ASSERT_TRUE(pair_->start(t0_));
  }
  /// Ignores the index, as the formula of a real device would.
  class FormulaImagesOfInstant final : public ImageProvider {
   public:
    Geometry geometry() const override { return {64, 48, PixelFormat::mono8, milliseconds(2), "t"}; }
    Status capture(const ImageRequest& r, std::span<std::byte> pixels) override {
      ImageRequest same = r;
      same.index = 0;
      FormulaImages::fill(same, pixels, 3);
      return {};
    }
  };
  void shot(std::int64_t capture_us, Duration transport = milliseconds(3)) {
    const BenchTime t = t0_ + microseconds(capture_us);
    device_->shots.push_back({t, t + transport});
  }
  /// Cycles `from` to `to` (excluded) of 1 ms.
  void run(int from, int to) {
    for (int k = from; k < to; ++k) {
      const BenchTime now = t0_ + milliseconds(k);
      pair_->complete_until(now);
      poll(now);
      pair_->begin_cycle(now);
    }
  }
  void poll(BenchTime now) {
    while (SampleLease s = pair_->poll(now)) {
      EXPECT_LE(s->stamp.t_release, now) << "handed on before its release";
      handed_.push_back(s->stamp);
      sides_.push_back(pair_->handed_side());
    }
    while (SampleLease e = pair_->poll_event()) events_.push_back(e);
  }
  void expect_gapless() {
    for (std::size_t i = 1; i < handed_.size(); ++i) {
      EXPECT_EQ(handed_[i].sequence, handed_[i - 1].sequence + 1) << "at " << i;
      EXPECT_GT(handed_[i].t_capture, handed_[i - 1].t_capture) << "at " << i;
    }
  }
  void TearDown() override {
    events_.clear();
    if (pair_ && pair_->state() == ChannelState::running) {
      EXPECT_TRUE(pair_->stop());
    }
  }

  BenchTime t0_{0};
  WorkerPool workers_{2};
  Log log_;
  std::unique_ptr<PairSource> pair_;
  ScriptedDevice* device_ = nullptr;
  std::vector<Stamp> handed_;
  std::vector<PairSide> sides_;
  std::vector<SampleLease> events_;
};

// What a fault keeps of the real side is not what the pair numbers.
TEST_F(PairTest, NumbersWhatAFaultOfTheRealSideKeeps) {
  for (const char* fault :
       {"{kind: stuck, from_s: 0.025}", "{kind: slow_consumer, mode: hold, leases: 3, from_s: 0.025}"}) {
    SCOPED_TRACE(fault);
    auto device = std::make_unique<ScriptedDevice>();
    device_ = device.get();
    auto faulty = std::make_unique<FaultySource>(std::move(device));
    const FaultySource& real = *faulty;
    make(std::move(faulty), std::string("real: {faults: [") + fault + "]}");
    for (int k = 0; k < 8; ++k) shot(k * 10'000);
    run(0, 92);
    EXPECT_EQ(real.accounts().taken, 8u);
    EXPECT_EQ(real.accounts().handed_on, 8u);
    EXPECT_EQ(handed_.size(), 8u);
    expect_gapless();
    EXPECT_EQ(pair_->health().lost, 0u);
    EXPECT_TRUE(pair_->stop());
    handed_.clear();
  }
}

TEST_F(PairTest, MeasuresBothSidesAtTheSameInstants) {
  make("phase_us: 1700");
  for (int k = 0; k < 10; ++k) shot(k * 10'000 + 1'700 + k * 13);  // its own phase, and a clock that drifts
  run(0, 113);
  ASSERT_EQ(handed_.size(), 10u);
  EXPECT_EQ(handed_[0].sequence, 0u);
  expect_gapless();
  ASSERT_EQ(log_.seen[0].size(), 10u);
  ASSERT_EQ(log_.seen[1].size(), 10u);
  for (std::size_t i = 0; i < 10; ++i) {
    EXPECT_EQ(log_.seen[0][i].t_capture, log_.seen[1][i].t_capture);
    EXPECT_EQ(log_.seen[0][i].sequence, log_.seen[1][i].sequence);
    EXPECT_EQ(log_.seen[0][i].t_capture, t0_ + microseconds(static_cast<int>(i) * 10'013 + 1'700));
  }
  pair_->complete_until(t0_ + milliseconds(113));
  const PairSnapshot s = pair_->statistics();
  EXPECT_EQ(s.compared, 10u);
  EXPECT_EQ(s.unlike, 0u);
  EXPECT_EQ(s.all.count, 10u * 64 * 48);
  EXPECT_DOUBLE_EQ(s.all.bias, -3) << "real − simulated";
  EXPECT_DOUBLE_EQ(s.all.sigma, 0);
  EXPECT_EQ(s.missing_of(PairSide::real), 0u);
  EXPECT_EQ(s.missing_of(PairSide::simulated), 0u);
}

TEST_F(PairTest, SwitchesAtAnyCycleWithoutGapInSequenceOrTime) {
  // Each possible place of the switch within a period, there and back again.
  for (int at = 30; at < 52; ++at) {
    handed_.clear();
    sides_.clear();
    events_.clear();
    make();
    for (int k = 0; k < 20; ++k) shot(k * 10'000 + 1'300);
    run(0, at);
    EXPECT_EQ(pair_->active(), PairSide::real);
    pair_->switch_to(PairSide::simulated);
    EXPECT_EQ(pair_->active(), PairSide::real) << "in force before the cycle's end";
    run(at, at + 1);
    EXPECT_EQ(pair_->active(), PairSide::simulated);
    run(at + 1, 101);
    pair_->switch_to(PairSide::real);
    run(101, 215);
    ASSERT_EQ(handed_.size(), 20u) << "switch at " << at;
    expect_gapless();
    for (std::size_t i = 0; i < 20; ++i) {
      const BenchTime release = handed_[i].t_release;
      const bool simulated = release > t0_ + milliseconds(at - 1) && release <= t0_ + milliseconds(100);
      EXPECT_EQ(sides_[i], simulated ? PairSide::simulated : PairSide::real)
          << "sample " << i << ", switch at " << at;
    }
    ASSERT_EQ(events_.size(), 2u);
    const auto* event = events_[0]->as<EventInfo>();
    ASSERT_NE(event, nullptr);
    EXPECT_EQ(event->code, kEventPairSwitch);
    EXPECT_EQ(event->value, 1);
    EXPECT_EQ(events_[0]->stamp.t_capture, t0_ + milliseconds(at));
    EXPECT_THAT(event->text.data(),
                testing::HasSubstr("left: simulated is handed on instead of real, from sequence "));
    EXPECT_EQ(pair_->switches(), 2u);
    events_.clear();
    ASSERT_TRUE(pair_->stop());
  }
}

TEST_F(PairTest, HandsOnWhatTheRealSideMissesOnlyWhenAskedTo) {
  make();
  for (int k = 0; k < 20; ++k)
    if (k != 5 && k < 12) shot(k * 10'000 + 1'300);  // 5 is lost, from 12 on the device is gone
  run(0, 140);
  // The real side is active: 5 is a gap, and the end is an end.
  std::vector<std::uint64_t> sequences;
  for (const auto& s : handed_) sequences.push_back(s.sequence);
  EXPECT_THAT(sequences, testing::ElementsAre(0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11));
  // Sample 12 was due at 133.3 ms; the simulated side has it. A switch hands it on at once, and goes on from
  // there.
  device_->set_connected(false);
  pair_->switch_to(PairSide::simulated);
  run(140, 141);
  ASSERT_EQ(handed_.back().sequence, 12u);
  EXPECT_TRUE(pair_->health().connected) << "the active side is there";
  run(141, 200);
  for (std::size_t i = 10; i < handed_.size(); ++i) EXPECT_EQ(handed_[i].sequence, i + 1);
  EXPECT_EQ(handed_.back().sequence, 18u);
  EXPECT_EQ(handed_.back().t_capture, t0_ + microseconds(181'300));
  // The simulated side left nothing out.
  std::set<std::uint64_t> simulated;
  for (const auto& s : log_.seen[1]) simulated.insert(s.sequence);
  EXPECT_EQ(simulated.size(), 19u);
  const PairSnapshot s = pair_->statistics();
  EXPECT_EQ(s.missing_of(PairSide::real), 8u);  // 5, and 12 to 18
  EXPECT_EQ(s.missing_of(PairSide::simulated), 0u);
  // Back to a device that is gone: the port will say lost.
  pair_->switch_to(PairSide::real);
  run(200, 202);
  EXPECT_FALSE(pair_->health().connected);
}

TEST_F(PairTest, ComesBackWithTheDeviceAtTheRightCount) {
  make("active: simulated");
  for (int k : {0, 1, 2, 30, 31, 32}) shot(k * 10'000 + 1'300 + (k >= 30 ? 2'100 : 0));
  run(0, 345);
  EXPECT_EQ(handed_.size(), 33u);
  expect_gapless();
  ASSERT_EQ(log_.seen[0].size(), 6u);
  EXPECT_EQ(log_.seen[0][3].sequence, 30u);
  EXPECT_EQ(log_.seen[0][5].sequence, 32u);
}

TEST_F(PairTest, PredictsTheInstantsOfAnyRateToTheNanosecond) {
  const Period period = Period::of_rate(30);
  make("", true, period);
  for (int k = 0; k < 90; ++k)
    if (k % 7 < 3) device_->shots.push_back({t0_ + period * k, t0_ + period * k + milliseconds(3)});
  run(0, 3020);
  const std::vector<Stamp>& simulated = log_.seen[1];
  ASSERT_GE(simulated.size(), 90u);
  for (std::size_t i = 0; i < simulated.size(); ++i) {
    EXPECT_EQ(simulated[i].sequence, i);
    EXPECT_EQ(simulated[i].t_capture, t0_ + period * static_cast<std::int64_t>(i)) << "at " << i;
  }
}

TEST_F(PairTest, TellsWhatTheDeviceTellsAndCountsWhatItCounts) {
  make("active: simulated");
  const auto name = std::string(image_config("").name) + ".real";
  // A code that is the pair's own for a switch must not be taken for one; and more than are kept at once.
  device_->told = {{kEventPairSwitch, 7, "the device refuses", BenchTime(100)},
                   {257, 0, "gone", BenchTime(200)}};
  device_->set_connected(false);
  device_->count_loss(5);
  run(0, 2);
  ASSERT_EQ(events_.size(), 2u);
  const auto* first = events_[0]->as<EventInfo>();
  ASSERT_NE(first, nullptr);
  EXPECT_EQ(first->code, kEventPairSwitch + kEventOfRealSide);
  EXPECT_EQ(first->value, 7);
  EXPECT_EQ(std::string(first->text.data()), name + ": the device refuses");
  EXPECT_EQ(events_[0]->stamp.t_release, BenchTime(100));
  EXPECT_EQ(events_[1]->as<EventInfo>()->code, 257 + kEventOfRealSide);
  EXPECT_EQ(events_[1]->stamp.sequence, events_[0]->stamp.sequence + 1);
  EXPECT_EQ(pair_->health().lost, 5u);
  EXPECT_EQ(pair_->health().reconnects, 1u);
  EXPECT_EQ(pair_->health().retries, 2u);
  EXPECT_TRUE(pair_->health().connected) << "the simulated side is handed on";
  EXPECT_FALSE(pair_->side(PairSide::real).health().connected);
  EXPECT_THAT(pair_->warnings(), testing::Contains(name + ": runs on its spare battery"));

  // Who keeps events (the recorder) does not keep the device's own from being told: it has two.
  for (int i = 0; i < 10; ++i) device_->told.push_back({3, double(i), "again", BenchTime(300 + i)});
  run(2, 4);
  ASSERT_EQ(events_.size(), 12u);
  for (int i = 0; i < 10; ++i) EXPECT_EQ(events_[2 + i]->as<EventInfo>()->value, i);
  pair_->switch_to(PairSide::real);
  run(4, 6);
  ASSERT_EQ(events_.size(), 13u);
  EXPECT_EQ(events_[12]->as<EventInfo>()->code, kEventPairSwitch);
  EXPECT_FALSE(pair_->health().connected) << "now the device's own counts";
}

TEST_F(PairTest, NeverRepeatsASampleThatComesLate) {
  make();
  shot(1'000);
  shot(11'000);
  shot(21'000, milliseconds(20));  // due at 33, there at 41
  shot(31'000, milliseconds(11));
  shot(41'000);
  run(0, 38);
  ASSERT_EQ(handed_.size(), 2u);
  pair_->switch_to(PairSide::simulated);
  run(38, 40);
  ASSERT_EQ(handed_.size(), 3u);  // the simulated side's 2
  pair_->switch_to(PairSide::real);
  run(40, 70);
  expect_gapless();
  EXPECT_EQ(handed_.size(), 5u);
}

TEST_F(PairTest, KeepsPaceInWallTimeWhenTheDeviceIsOverdue) {
  t0_ = bench_now();
  make("{active: simulated, overdue_ms: 5}", false);
  for (int k : {0, 1, 2, 3, 9, 10}) shot(k * 10'000 + 1'000);
  for (int k = 0; k < 160; ++k) {
    const BenchTime now = t0_ + milliseconds(k);
    // Five times slower than the clock on the wall: a busy machine keeps a worker from its CPU for
    // milliseconds, and a sample that is late is left out.
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    poll(now);
    pair_->begin_cycle(now);
  }
  ASSERT_GE(handed_.size(), 12u);
  expect_gapless();
  for (const auto& s : handed_) EXPECT_EQ((s.t_capture - t0_).ns() % 10'000'000, 1'000'000);
}

TEST_F(PairTest, TellsWhenASideIsRefused) {
  auto device = std::make_unique<ScriptedDevice>();
  PairSource pair(std::move(device),
                  std::make_unique<SimulatedSource>(std::make_shared<FormulaImages>(), nullptr, workers_),
                  workers_);
  auto s = pair.configure(image_config("simulated: {exposre_us: 3}"));
  ASSERT_FALSE(s);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("exposre_us"));
  EXPECT_FALSE(pair.configure(image_config("active: left")));
  EXPECT_FALSE(pair.configure(image_config("", Duration(0)))) << "a pair without a rate";
}

// -------------------------------------------------------------- statistics

TEST(PairStatistics, KnowsBiasAndSigmaOfEveryFormat) {
  for (const PixelFormat format : kPixelFormats) {
    constexpr std::uint32_t kWidth = 31, kHeight = 9;  // odd: rows of mono12p begin within a byte
    auto pool = make_sample_pool(2, image_bytes(PixelFormat::rgb8, kWidth, kHeight) + 8);
    SampleSlot a = pool->try_acquire(), b = pool->try_acquire();
    const std::size_t elements = kWidth * kHeight * (format == PixelFormat::rgb8 ? 3 : 1);
    double sum = 0, squares = 0;
    const auto put = [&](Sample& s, std::size_t i, unsigned v) {
      auto* p = reinterpret_cast<std::uint8_t*>(s.memory().data());
      if (has_words(format)) {
        p[2 * i] = static_cast<std::uint8_t>(v);
        p[2 * i + 1] = static_cast<std::uint8_t>(v >> 8);
      } else if (format == PixelFormat::mono12p) {
        for (unsigned bit = 0; bit < 12; ++bit) {  // bit by bit, as PFNC numbers them
          const std::size_t at = i * 12 + bit;
          p[at / 8] = static_cast<std::uint8_t>((p[at / 8] & ~(1u << at % 8)) | ((v >> bit & 1) << at % 8));
        }
      } else {
        p[i] = static_cast<std::uint8_t>(v);
      }
    };
    const unsigned top = (1u << significant_bits(format)) - 1;
    for (std::size_t i = 0; i < elements; ++i) {
      const unsigned x = static_cast<unsigned>(i * 7919 % (top + 1)),
                     y = static_cast<unsigned>(i * 104729 % (top + 1));
      put(*a, i, x);
      put(*b, i, y);
      const double d = static_cast<double>(x) - static_cast<double>(y);
      sum += d;
      squares += d * d;
    }
    ImageInfo info;
    info.format = format;
    info.width_px = kWidth;
    info.height_px = kHeight;
    for (auto* s : {&*a, &*b}) {
      s->info = info;
      s->size_bytes = image_bytes(format, kWidth, kHeight);
    }
    const auto d = difference_of_images(*a, *b);
    ASSERT_TRUE(d);
    const auto n = static_cast<double>(elements);
    EXPECT_EQ(d->count, elements);
    // Sums are exact, the quotients are not: a few ulp of the largest term, (2¹⁶)² · n.
    EXPECT_NEAR(d->bias, sum / n, 1e-9) << pfnc_name(format);
    EXPECT_NEAR(d->sigma, std::sqrt(squares / n - sum / n * sum / n), 1e-6) << pfnc_name(format);
    b->stamp.validity = kIncomplete;
    EXPECT_FALSE(difference_of_images(*a, *b));
    b->stamp.validity = kValid;
    info.width_px = kWidth - 1;
    b->info = info;
    EXPECT_FALSE(difference_of_images(*a, *b));
  }
}

TEST(PairStatistics, ComparesRangesWhereBothHaveAReturn) {
  auto pool = make_sample_pool(2, 4 * 2 * sizeof(float));
  SampleSlot a = pool->try_acquire(), b = pool->try_acquire();
  const auto put = [](SampleSlot& slot, std::array<float, 4> ranges) {
    Sample& s = *slot;
    s.info = RangeImageInfo{4, 1};
    s.size_bytes = 2 * sizeof ranges;
    std::memset(s.memory().data(), 0, s.size_bytes);
    std::memcpy(s.memory().data(), ranges.data(), sizeof ranges);
  };
  put(a, {1, 2, std::nanf(""), 4});
  put(b, {1.5F, 2.25F, 3, std::nanf("")});
  const auto d = difference_of_ranges(*a, *b);
  ASSERT_TRUE(d);
  EXPECT_EQ(d->count, 2u);
  EXPECT_DOUBLE_EQ(d->bias, -0.375);  // −0.5 and −0.25
  EXPECT_DOUBLE_EQ(d->sigma, 0.125);
  b->info = RangeImageInfo{2, 2};
  EXPECT_FALSE(difference_of_ranges(*a, *b)) << "pictures of other sizes";
}

TEST(PairStatistics, ComparesThePointsOfOneFiring) {
  auto pool = make_sample_pool(2, 8 * sizeof(LidarPoint));
  SampleSlot a = pool->try_acquire(), b = pool->try_acquire();
  const auto put = [](SampleSlot& slot, const std::vector<LidarPoint>& points) {
    Sample& s = *slot;
    s.info = PointCloudInfo{static_cast<std::uint32_t>(points.size())};
    s.size_bytes = points.size() * sizeof(LidarPoint);
    std::memcpy(s.memory().data(), points.data(), s.size_bytes);
  };
  const auto point = [](float range, int t_ns, int ring, int which = 0) {
    return LidarPoint{
        range, 0, 0, 0, t_ns, static_cast<std::uint16_t>(ring), static_cast<std::uint8_t>(which), 0};
  };
  put(a, {point(10, 0, 0), point(20, 0, 1), point(30, 5, 0), point(31, 5, 0, 1), point(40, 9, 2)});
  // The rings of an instant in another order, one firing that the real side lacks, one that this one lacks.
  put(b, {point(20.5F, 0, 1), point(10.25F, 0, 0), point(99, 3, 0), point(32, 5, 0, 1), point(50, 9, 3)});
  const auto d = difference_of_ranges(*a, *b);
  ASSERT_TRUE(d);
  EXPECT_EQ(d->count, 3u);
  EXPECT_NEAR(d->bias, -(0.25 + 0.5 + 1) / 3, 1e-12);
  put(b, {point(1, 100, 0)});
  EXPECT_FALSE(difference_of_ranges(*a, *b)) << "no firing in both";
}

Sample sample_with(decltype(Sample::info) info) {
  Sample s;
  s.info = info;
  return s;
}

TEST(PairValues, ComparePlacesOfReceiversInMetres) {
  NavFix real{FixStatus::fix, 9, 50.4, 6.5, 600, {}}, simulated = real;
  std::array<double, RegisterBlock::kMax> d{};
  // 30 m east, 40 m north and 5 m up of there, through Earth-centred coordinates; the ground curves 0.2 mm
  // away.
  simulated.latitude_deg = 50.400359558437;
  simulated.longitude_deg = 6.500421909268;
  simulated.height_m = 605.000196;
  ASSERT_EQ(value_differences(sample_with(real), sample_with(simulated), d), 3u);
  EXPECT_NEAR(d[0], -30, 1e-3);
  EXPECT_NEAR(d[1], -40, 1e-3);
  EXPECT_NEAR(d[2], -5, 1e-3);
  // Across the date line.
  real.longitude_deg = 179.9999;
  simulated.longitude_deg = -179.9999;
  ASSERT_EQ(value_differences(sample_with(real), sample_with(simulated), d), 3u);
  EXPECT_NEAR(d[0], -0.0002 * 71'106, 0.01);
  simulated.status = FixStatus::none;
  EXPECT_EQ(value_differences(sample_with(real), sample_with(simulated), d), 0u);
  EXPECT_EQ(value_differences(sample_with(real), sample_with(ImuSample{}), d), 0u);
}

TEST(PairValues, CompareInertialUnitsAndOdometryNumberByNumber) {
  std::array<double, RegisterBlock::kMax> d{};
  ASSERT_EQ(value_differences(sample_with(ImuSample{{1, 2, 3}, {4, 5, 6}}),
                              sample_with(ImuSample{{1.5, 2, 2}, {4, 7, 5.75}}), d),
            6u);
  EXPECT_EQ((std::vector<double>(d.begin(), d.begin() + 6)), (std::vector<double>{-0.5, 0, 1, 0, -2, 0.25}));
  Odometry a, b;
  const auto turned = [](double yaw_rad) {
    return std::array<double, 4>{std::cos(yaw_rad / 2), 0, 0, std::sin(yaw_rad / 2)};
  };
  a.T_odom_base = {{1, 2, 9}, turned(3.1)};
  b.T_odom_base = {{1.5, 1, 7}, turned(-3.1)};
  b.velocity_mps = {0.25, 3, 3};
  b.turn_rate_radps = {3, 3, -0.5};
  b.wheel_angle_rad = {10, -20};
  ASSERT_EQ(value_differences(sample_with(a), sample_with(b), d), 7u);
  EXPECT_EQ(d[0], -0.5);
  EXPECT_EQ(d[1], 1);
  EXPECT_NEAR(d[2], 6.2 - 2 * std::numbers::pi, 1e-12) << "the short way round";
  EXPECT_EQ((std::vector<double>(d.begin() + 3, d.begin() + 7)), (std::vector<double>{-0.25, 0.5, -10, 20}));
  EXPECT_EQ(compared_values(SampleKind::odometry).size(), 7u);
}

TEST(PairStatistics, LooksAtEveryNthRowOfLargePictures) {
  constexpr std::uint32_t kWidth = 1280, kHeight = 1024;
  auto pool = make_sample_pool(2, kWidth * kHeight);
  SampleSlot a = pool->try_acquire(), b = pool->try_acquire();
  ImageInfo info;
  info.width_px = kWidth;
  info.height_px = kHeight;
  for (auto* s : {&*a, &*b}) {
    s->info = info;
    s->size_bytes = kWidth * kHeight;
    std::fill(s->memory().begin(), s->memory().end(), std::byte{10});
  }
  std::fill(b->memory().begin(), b->memory().end(), std::byte{8});
  const auto d = difference_of_images(*a, *b);
  ASSERT_TRUE(d);
  EXPECT_EQ(d->bias, 2);
  EXPECT_LE(d->count, PairStatistics::kMaxElements);
  EXPECT_GE(d->count, PairStatistics::kMaxElements / 2);
}

TEST(PairStatistics, JudgesEachRegisterByItself) {
  WorkerPool workers(2);
  PairStatistics statistics(workers);
  ASSERT_TRUE(statistics.start(true));
  auto pool = make_sample_pool(2, 0);
  double sum = 0, squares = 0;
  constexpr int kPairs = 200;
  for (int i = 0; i < kPairs; ++i) {
    SampleSlot a = pool->try_acquire(), b = pool->try_acquire();
    ASSERT_TRUE(a && b) << "leases are kept";
    RegisterBlock x, y;
    x.count = y.count = 2;
    x.value[0] = i;
    const double d = std::sin(i) + 0.5;
    y.value[0] = i - d;
    x.value[1] = 4;
    y.value[1] = 1;
    sum += d;
    squares += d * d;
    a->info = x;
    b->info = y;
    statistics.compare(std::move(a), std::move(b));
    statistics.drain();
  }
  const PairSnapshot s = statistics.snapshot();
  EXPECT_EQ(s.compared, static_cast<std::uint64_t>(kPairs));
  EXPECT_EQ(s.values, 2u);
  const double mean = sum / kPairs;
  EXPECT_NEAR(s.value[0].bias, mean, 1e-12);
  EXPECT_NEAR(s.value[0].sigma, std::sqrt(squares / kPairs - mean * mean), 1e-12);
  EXPECT_NEAR(s.value[1].bias, 3, 1e-12);
  EXPECT_NEAR(s.value[1].sigma, 0, 1e-12);
  EXPECT_EQ(s.all.count, static_cast<std::uint64_t>(kPairs));
}

}  // namespace
}  // namespace rigor
