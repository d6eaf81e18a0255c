// Recorder and replay together: what was seen is in the file, is seen again, and is the same file again.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>

#include <fstream>
#include <map>

#include "rt-core/sanitizers.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/recorder.h"
#include "sensor-hal/record/replay_source.h"
#include "sensor-hal/record/ros2_messages.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor {
namespace {

using test::FormulaImages;
using test::image_config;

/// Gives register blocks that are released as they are taken; every 1 ms.
SampleSlot block(SamplePool& pool, std::uint64_t k, BenchTime t) {
  SampleSlot s = pool.try_acquire();
  if (!s) return s;
  Sample& sample = *s;
  sample.stamp = Stamp{};
  sample.stamp.sequence = k;
  sample.stamp.t_capture = t - milliseconds(1);
  sample.stamp.t_release = sample.stamp.t_arrival = t;
  RegisterBlock b;
  b.count = 2;
  b.value[0] = static_cast<double>(k) * 0.5;
  b.value[1] = -1;
  sample.info = b;
  sample.size_bytes = 0;
  return s;
}

/// What an application saw of a port in a cycle.
struct Saw {
  std::uint64_t cycle;
  PortStatus status;
  std::uint64_t sequence;
  std::vector<std::byte> bytes;
  bool operator==(const Saw&) const = default;
};

using Fates = std::map<int, int>;  // cycle → side to switch to

/// A small rig in virtual time: a pair `left`, a simulated `right`, registers; recorded into memory.
struct Rig {
  explicit Rig(std::size_t threads) : workers(threads) {}

  /// Null recording: a run; else a replay of it.
  void run(int cycles, const std::string& path, std::shared_ptr<const Recording> recording = {},
           const Fates& fates = {}) {
    std::unique_ptr<Source> left, right;
    PairSource* pair = nullptr;
    if (recording) {
      left = std::make_unique<ReplaySource>(recording);
      right = std::make_unique<ReplaySource>(recording);
      ASSERT_TRUE(left->configure(image_config("")));
    } else {
      auto slow = std::make_shared<FormulaImages>(64, 48, 3);
      slow->delay_us = delay_us;
      auto p = std::make_unique<PairSource>(
          std::make_unique<SimulatedSource>(std::make_shared<FormulaImages>(), &joint, workers),
          std::make_unique<SimulatedSource>(slow, &joint, workers), workers);
      pair = p.get();
      left = std::move(p);
      right = std::make_unique<SimulatedSource>(std::make_shared<FormulaImages>(32, 24), &joint, workers);
      ASSERT_TRUE(left->configure(image_config("real: {phase_us: 400}")));
    }
    ASSERT_TRUE(right->configure(image_config("", milliseconds(7), milliseconds(3), "right")));
    for (Source* s : {left.get(), right.get()}) {
      ASSERT_TRUE(s->arm({.virtual_time = true}));
      ASSERT_TRUE(s->start(BenchTime(0)));
    }
    RecorderOptions options;
    options.virtual_time = true;
    options.writer.compression = record::Compression::lz4;
    RecordedChannel channels[3];
    channels[0].name = "left";
    channels[0].description = left->describe();
    channels[0].is_pair = pair != nullptr;
    channels[1].name = "right";
    channels[1].description = right->describe();
    record::msg::CameraInfo camera;
    camera.width = 32;
    camera.height = 24;
    camera.distortion_model = "plumb_bob";
    channels[1].camera = camera;
    channels[2].name = "table";
    channels[2].description.kind = SampleKind::register_block;
    channels[2].description.names = {"position", "rate"};
    channels[2].description.units = {"deg", "deg/s"};
    auto recorder = Recorder::create(path, options, {channels[0], channels[1], channels[2]},
                                     {{"motor", {"target"}}}, {{"rig", "name: test"}, {"seed", "1"}});
    ASSERT_TRUE(recorder) << recorder.error().text();
    (*recorder)->begin(BenchTime(0));
    if (pair) pair->observe((*recorder)->observer(0));
    auto blocks = make_sample_pool(8, 0);

    Port<Sample> ports[2];
    PortStatus last[2] = {PortStatus::never, PortStatus::never};
    for (int k = 0; k < cycles; ++k) {
      const BenchTime now = BenchTime(0) + milliseconds(k);
      const auto cycle = static_cast<std::uint64_t>(k);
      if (const auto fate = fates.find(k); fate != fates.end() && pair)
        pair->switch_to(static_cast<PairSide>(fate->second));
      Source* sources[2] = {left.get(), right.get()};
      for (std::uint32_t i = 0; i < 2; ++i) {
        sources[i]->complete_until(now);
        while (SampleLease s = sources[i]->poll(now)) {
          if (i == 1 || !pair) (*recorder)->record(i, s);
          ports[i].push(std::move(s));
        }
        while (SampleLease e = sources[i]->poll_event()) (*recorder)->record_event(i, e);
        if (recording) {
          const auto v = recording->visibility(i == 0 ? "left" : "right")->at(cycle);
          ports[i].obey(v.status, v.sequence, now);
        } else {
          ports[i].advance(now, true);
        }
        const PortStatus status = ports[i].status();
        if (status == PortStatus::fresh || status != last[i])
          (*recorder)->record_visibility(i, cycle, now, status, ports[i].sample());
        last[i] = status;
        Saw saw{cycle, status, 0, {}};
        if (const auto& s = ports[i].sample()) {
          saw.sequence = s->stamp.sequence;
          saw.bytes.assign(s->bytes().begin(), s->bytes().end());
        }
        seen.push_back(std::move(saw));
      }
      (*recorder)->record(2, block(*blocks, cycle, now));
      if (k % 10 == 0) {
        Command c;
        c.sequence = cycle / 10;
        c.t_issue = now;
        c.t_effect = now + milliseconds(5);
        c.count = 1;
        c.value[0] = k;
        (*recorder)->record_command(0, c);
      }
      for (Source* s : sources) s->begin_cycle(now);
      (*recorder)->end_cycle(cycle, now);
    }
    for (auto& p : ports) p = Port<Sample>();
    const auto stopped = (*recorder)->stop();
    ASSERT_TRUE(stopped) << stopped.error().text();
    statistics = (*recorder)->statistics();
    ASSERT_TRUE(left->stop());
    ASSERT_TRUE(right->stop());
  }

  test::TurningJoint joint;
  WorkerPool workers;
  int delay_us = 0;
  std::vector<Saw> seen;
  Recorder::Statistics statistics;
};

std::string content(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

std::map<std::string, std::vector<record::MessageInfo>> by_topic(const std::string& path) {
  std::map<std::string, std::vector<record::MessageInfo>> found;
  auto reader = record::McapReader::open(path);
  EXPECT_TRUE(reader) << (reader ? "" : reader.error().text());
  if (!reader) return found;
  EXPECT_TRUE((*reader)->health().good());
  auto cursor = (*reader)->messages({.order = record::MessageOrder::file});
  record::MessageView m;
  std::uint64_t last = 0;
  while (true) {
    const auto more = cursor.next(m);
    EXPECT_TRUE(more);
    if (!more || !*more) break;
    EXPECT_GE(m.log_time_ns, last) << m.channel->topic << " goes back in log time";
    last = m.log_time_ns;
    found[m.channel->topic].push_back({m.channel->id, m.sequence, m.log_time_ns, m.publish_time_ns});
  }
  return found;
}

TEST(Recorder, WritesTheSameBytesOnAnyNumberOfThreads) {
  test::TemporaryDirectory directory;
  std::string first;
  const Fates fates{{101, 1}, {200, 0}};
  int run = 0;
  for (std::size_t threads : {1u, 2u, 2u, 3u}) {
    Rig rig(threads);
    rig.delay_us = run * 150;
    const std::string path = directory.file("run" + std::to_string(run++) + ".mcap");
    rig.run(300, path, {}, fates);
    if (HasFatalFailure()) return;
    EXPECT_EQ(rig.statistics.dropped, 0u);
    const std::string bytes = content(path);
    ASSERT_GT(bytes.size(), 10'000u);
    if (first.empty()) first = bytes;
    EXPECT_TRUE(bytes == first) << "run " << run << " on " << threads << " threads differs";
  }
}

TEST(Recorder, PutsEverythingWhereToolsLookForIt) {
  test::TemporaryDirectory directory;
  Rig rig(2);
  rig.run(300, directory.file("run.mcap"), {}, {{101, 1}});
  if (HasFatalFailure()) return;
  const auto topics = by_topic(directory.file("run.mcap"));
  const auto count = [&](const std::string& topic) {
    return topics.contains(topic) ? topics.at(topic).size() : 0;
  };
  // Captures at 0.4 + 10 k ms, latency 12: released by 299 ms are 0 … 28; right: 7 k + 3, so 0 … 42.
  EXPECT_EQ(count("/left/real/image"), 29u);
  EXPECT_EQ(count("/left/real/image/stamp"), 29u);
  EXPECT_EQ(count("/left/real/image/settings"), 29u);
  EXPECT_EQ(count("/left/simulated/image"), 29u);
  EXPECT_EQ(count("/left/image"), 0u);
  EXPECT_EQ(count("/right/image"), 43u);
  EXPECT_EQ(count("/right/camera_info"), 43u);
  EXPECT_EQ(count("/table/registers"), 300u);
  EXPECT_EQ(count("/rigor/commands"), 30u);
  EXPECT_EQ(count("/rigor/events"), 1u);
  const auto& image = topics.at("/right/image")[5];
  EXPECT_EQ(image.sequence, 5u);
  const auto utc0 = static_cast<std::uint64_t>(kVirtualEpoch.utc.ns());
  EXPECT_EQ(image.log_time_ns, utc0 + 38'000'000);      // release
  EXPECT_EQ(image.publish_time_ns, utc0 + 35'000'000);  // capture

  auto recording = Recording::open(directory.file("run.mcap"));
  ASSERT_TRUE(recording) << recording.error().text();
  EXPECT_EQ((*recording)->metadata().at("rig"), "name: test");
  EXPECT_EQ((*recording)->cycles(), 300u);
  const auto* script = (*recording)->visibility("left");
  ASSERT_NE(script, nullptr);
  EXPECT_FALSE(script->at(100).simulated);
  EXPECT_EQ(script->at(103).status, PortStatus::fresh);
  EXPECT_TRUE(script->at(103).simulated) << "the side that was handed on is not recorded";
  EXPECT_EQ(script->at(103).sequence, 9u);
  EXPECT_EQ(script->at(104).status, PortStatus::held);
  EXPECT_EQ(script->at(5).status, PortStatus::never);
}

TEST(Replay, ShowsWhatWasSeenInTheSameCyclesAndRepeatsAsAFile) {
  test::TemporaryDirectory directory;
  Rig rig(2);
  rig.run(300, directory.file("run.mcap"), {}, {{101, 1}, {204, 0}});
  if (HasFatalFailure()) return;
  auto recording = Recording::open(directory.file("run.mcap"));
  ASSERT_TRUE(recording) << recording.error().text();
  std::string first;
  for (const char* name : {"a.mcap", "b.mcap"}) {
    Rig again(1);
    again.run(300, directory.file(name), *recording);
    if (HasFatalFailure()) return;
    ASSERT_EQ(again.seen.size(), rig.seen.size());
    for (std::size_t i = 0; i < rig.seen.size(); ++i)
      ASSERT_EQ(again.seen[i], rig.seen[i]) << "cycle " << rig.seen[i].cycle << ", port " << i % 2;
    const std::string bytes = content(directory.file(name));
    if (first.empty()) first = bytes;
    EXPECT_TRUE(bytes == first);
  }
}

// A run that is shorter than a channel's latency.
TEST(Replay, OfAChannelOfWhichNothingWasSeenShowsNothing) {
  test::TemporaryDirectory directory;
  Rig rig(1);
  rig.run(4, directory.file("run.mcap"));
  if (HasFatalFailure()) return;
  for (std::size_t i = 0; i < rig.seen.size(); i += 2) ASSERT_EQ(rig.seen[i].status, PortStatus::never);
  ASSERT_EQ(rig.seen.back().status, PortStatus::fresh);
  auto recording = Recording::open(directory.file("run.mcap"));
  ASSERT_TRUE(recording) << recording.error().text();
  for (const char* name : {"left", "right"}) ASSERT_NE((*recording)->visibility(name), nullptr) << name;
  EXPECT_EQ((*recording)->visibility("rigor"), nullptr);
  EXPECT_EQ((*recording)->visibility("other"), nullptr);
  Rig again(1);
  again.run(4, directory.file("again.mcap"), *recording);
  EXPECT_EQ(again.seen, rig.seen);
}

TEST(Replay, FollowsWhatCameLateAndWhatWasSkipped) {
  // A wall-clock run, by hand: sample 1 (due in cycle 20) was seen in cycle 24; cycles 30 to 32 were skipped.
  test::TemporaryDirectory directory;
  const std::string path = directory.file("wall.mcap");
  {
    auto recorder = Recorder::create(path, {},
                                     {{"table",
                                       [] {
                                         ChannelDescription d;
                                         d.kind = SampleKind::register_block;
                                         d.names = {"a", "b"};
                                         d.units = {"", ""};
                                         return d;
                                       }()}},
                                     {}, {});
    ASSERT_TRUE(recorder);
    (*recorder)->begin(BenchTime(0));
    auto pool = make_sample_pool(8, 0);
    SampleLease visible;
    for (std::uint64_t k = 0; k < 50; ++k) {
      if (k >= 30 && k < 33) continue;
      const BenchTime now = BenchTime(0) + milliseconds(static_cast<std::int64_t>(k));
      if (k == 33) (*recorder)->record_skipped(30, 3, now);
      PortStatus status = k == 20 ? PortStatus::overdue : PortStatus::held;
      if (k == 10 || k == 24 || k == 40) {
        const std::uint64_t n = k == 10 ? 0 : k == 24 ? 1 : 2;
        SampleSlot late =
            block(*pool, n, BenchTime(0) + milliseconds(static_cast<std::int64_t>(n) * 10 + 10));
        late->stamp.t_arrival = now;
        visible = std::move(late);
        (*recorder)->record(0, visible);
        status = PortStatus::fresh;
      }
      if (status != PortStatus::held) (*recorder)->record_visibility(0, k, now, status, visible);
      (*recorder)->end_cycle(k, now);
    }
    visible.reset();
    ASSERT_TRUE((*recorder)->stop());
  }
  auto recording = Recording::open(path);
  ASSERT_TRUE(recording) << recording.error().text();
  for (std::uint64_t k = 0; k < 50; ++k) EXPECT_EQ((*recording)->ran(k), k < 30 || k > 32) << k;
  ReplaySource source(*recording);
  ChannelConfig config = image_config("", milliseconds(10), milliseconds(1), "table");
  config.kind = SampleKind::register_block;
  ASSERT_TRUE(source.configure(config));
  EXPECT_EQ(source.describe().names, (std::vector<std::string>{"a", "b"}));
  ASSERT_TRUE(source.arm({.virtual_time = true}));
  ASSERT_TRUE(source.start(BenchTime(0)));
  Port<Sample> port;
  std::map<std::uint64_t, std::uint64_t> fresh;
  for (std::uint64_t k = 0; k < 50; ++k) {
    if (!(*recording)->ran(k)) continue;
    const BenchTime now = BenchTime(0) + milliseconds(static_cast<std::int64_t>(k));
    source.complete_until(now);
    while (SampleLease s = source.poll(now)) port.push(std::move(s));
    const auto v = (*recording)->visibility("table")->at(k);
    port.obey(v.status, v.sequence, now);
    if (port.status() == PortStatus::fresh) fresh[k] = port.sample()->stamp.sequence;
    if (k == 20) {
      EXPECT_EQ(port.status(), PortStatus::overdue);
    }
    if (k == 23) {
      EXPECT_EQ(port.sample()->stamp.sequence, 0u) << "sample 1 was not seen yet";
    }
  }
  EXPECT_EQ(fresh, (std::map<std::uint64_t, std::uint64_t>{{10, 0}, {24, 1}, {40, 2}}));
  port = Port<Sample>();
  ASSERT_TRUE(source.stop());
}

TEST(Replay, ShowsThePairsSidesInTheOrderInWhichTheyWereSeenWhereOneWasLate) {
  // By hand: the real side's sample of cycle 21 waits for the switch in cycle 23; the simulated one that was
  // due in cycle 20 comes in cycle 22, and so after it in the file.
  struct Numbers {
    std::uint64_t simulated, real;
  };
  for (const Numbers first : {Numbers{0, 7}, Numbers{7, 0}}) {
    test::TemporaryDirectory directory;
    const std::string path = directory.file("pair.mcap");
    ChannelDescription table;
    table.kind = SampleKind::register_block;
    table.names = {"a", "b"};
    table.units = {"", ""};
    {
      RecordedChannel channel{"table", table};
      channel.is_pair = true;
      auto recorder = Recorder::create(path, {}, {channel}, {}, {});
      ASSERT_TRUE(recorder);
      (*recorder)->begin(BenchTime(0));
      auto pool = make_sample_pool(8, 0);
      SampleLease waiting;
      for (std::uint64_t k = 0; k < 50; ++k) {
        const BenchTime now = BenchTime(0) + milliseconds(static_cast<std::int64_t>(k));
        const auto come = [&](PairSide side, std::uint64_t n, std::uint64_t due) {
          SampleLease s = block(*pool, n, BenchTime(0) + milliseconds(static_cast<std::int64_t>(due)));
          (*recorder)->observer(0)->on_side_sample(side, s);
          return s;
        };
        SampleLease shown;
        if (k == 10) shown = come(PairSide::simulated, first.simulated, 10);
        if (k == 21) waiting = come(PairSide::real, first.real, 21);
        if (k == 22) shown = come(PairSide::simulated, first.simulated + 1, 20);
        if (k == 23) shown = waiting;
        if (k == 40) shown = come(PairSide::real, first.real + 1, 40);
        if (shown) (*recorder)->record_visibility(0, k, now, PortStatus::fresh, shown);
        (*recorder)->end_cycle(k, now);
      }
      waiting.reset();
      ASSERT_TRUE((*recorder)->stop());
    }
    auto recording = Recording::open(path);
    ASSERT_TRUE(recording) << recording.error().text();
    ReplaySource source(*recording);
    ChannelConfig config = image_config("", milliseconds(10), milliseconds(1), "table");
    config.kind = SampleKind::register_block;
    ASSERT_TRUE(source.configure(config));
    ASSERT_TRUE(source.arm({.virtual_time = true}));
    ASSERT_TRUE(source.start(BenchTime(0)));
    Port<Sample> port;
    std::map<std::uint64_t, std::uint64_t> fresh;
    for (std::uint64_t k = 0; k < 50; ++k) {
      const BenchTime now = BenchTime(0) + milliseconds(static_cast<std::int64_t>(k));
      source.complete_until(now);
      while (SampleLease s = source.poll(now)) port.push(std::move(s));
      const auto v = (*recording)->visibility("table")->at(k);
      if (port.obey(v.status, v.sequence, now) && v.status == PortStatus::fresh)
        fresh[k] = port.sample()->stamp.sequence;
    }
    EXPECT_EQ(fresh,
              (std::map<std::uint64_t, std::uint64_t>{
                  {10, first.simulated}, {22, first.simulated + 1}, {23, first.real}, {40, first.real + 1}}));
    port = Port<Sample>();
    ASSERT_TRUE(source.stop());
  }
}

TEST(Replay, SaysWhatARecordingLacks) {
  test::TemporaryDirectory directory;
  const auto none = Recording::open(directory.file("none.mcap"));
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::not_found);
  std::ofstream(directory.file("text.mcap")) << "no recording at all, only text that is long enough";
  EXPECT_FALSE(Recording::open(directory.file("text.mcap")));
  Rig rig(1);
  rig.run(30, directory.file("run.mcap"));
  if (HasFatalFailure()) return;
  auto recording = Recording::open(directory.file("run.mcap"));
  ASSERT_TRUE(recording);
  ReplaySource source(*recording);
  const auto s = source.configure(image_config("", milliseconds(10), milliseconds(1), "up"));
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_found);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("/up/image"));
}

// -------------------------------------------------------------- trouble

/// A medium that is slow, full, or both.
class Medium final : public record::ByteSink {
 public:
  Status append(record::Pieces pieces) override {
    std::size_t n = 0;
    for (const auto& p : pieces) n += p.size();
    while (blocked_ && *blocked_) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    if (bytes_ + n > full_at_) return fail(ErrorCode::disk_full, "medium", "no space left");
    bytes_ += n;
    return memory_.append(pieces);
  }
  Status truncate(std::uint64_t size) override {
    bytes_ = size;
    return memory_.truncate(size);
  }
  Status sync() override { return {}; }
  std::string name() const override { return "medium"; }

  std::shared_ptr<std::atomic<bool>> blocked_;
  std::uint64_t full_at_ = ~std::uint64_t{0};

 private:
  record::MemorySink memory_;
  std::uint64_t bytes_ = 0;
};

ChannelDescription images_of(std::uint32_t w, std::uint32_t h) {
  ChannelDescription d;
  d.kind = SampleKind::image;
  d.width_px = w;
  d.height_px = h;
  d.max_bytes = std::size_t{w} * h;
  return d;
}

SampleLease image(SamplePool& pool, std::uint64_t k, BenchTime t, std::uint32_t w, std::uint32_t h) {
  SampleSlot s = pool.try_acquire();
  if (!s) return s;
  s->stamp = Stamp{};
  s->stamp.sequence = k;
  s->stamp.t_capture = s->stamp.t_release = s->stamp.t_arrival = t;
  ImageInfo info;
  info.width_px = w;
  info.height_px = h;
  s->info = info;
  s->size_bytes = std::size_t{w} * h;
  return s;
}

TEST(Recorder, NeverStarvesTheLoopWhenTheMediumHangs) {
  auto blocked = std::make_shared<std::atomic<bool>>(false);
  auto medium = std::make_unique<Medium>();
  medium->blocked_ = blocked;
  RecorderOptions options;
  options.places = 64;
  auto recorder = Recorder::create(std::move(medium), options,
                                   {{"cam", images_of(640, 480)},
                                    {"table",
                                     [] {
                                       ChannelDescription d;
                                       d.kind = SampleKind::register_block;
                                       d.names = d.units = {"a", "b"};
                                       return d;
                                     }()}},
                                   {}, {});
  ASSERT_TRUE(recorder);
  (*recorder)->begin(BenchTime(0));
  *blocked = true;
  auto pool = make_sample_pool(16, 640 * 480);
  auto blocks = make_sample_pool(4, 0);
  std::int64_t slowest = 0;
  for (std::uint64_t k = 0; k < 400; ++k) {
    const BenchTime now = BenchTime(0) + milliseconds(static_cast<std::int64_t>(k));
    SampleLease s = image(*pool, k, now, 640, 480);
    ASSERT_TRUE(s) << "the recorder holds all slots at " << k;
    const auto before = monotonic_now();
    (*recorder)->record(0, s);
    (*recorder)->record(1, block(*blocks, k, now));
    (*recorder)->end_cycle(k, now);
    slowest = std::max(slowest, (monotonic_now() - before).ns());
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  }
  EXPECT_LE(pool->in_use(), RecordedChannel{}.lease_budget);
  EXPECT_LT(slowest, 50'000'000) << "ns: a call waited for the medium";
  const auto dropped = (*recorder)->statistics();
  EXPECT_GT(dropped.dropped_by_channel[0], 300u);
  EXPECT_GT(dropped.dropped_by_channel[1], 0u);
  *blocked = false;
  EXPECT_FALSE((*recorder)->failed());
  ASSERT_TRUE((*recorder)->stop());
  const auto s = (*recorder)->statistics();
  EXPECT_EQ(s.samples + s.dropped_by_channel[0] + s.dropped_by_channel[1] + s.after_end, 800u);
  EXPECT_EQ(pool->in_use(), 0u);
}

TEST(Recorder, FailsTheRunForADropWhereThatIsAsked) {
  auto blocked = std::make_shared<std::atomic<bool>>(false);
  auto medium = std::make_unique<Medium>();
  medium->blocked_ = blocked;
  RecorderOptions options;
  options.fail_on_drop = true;
  auto recorder = Recorder::create(std::move(medium), options, {{"cam", images_of(640, 480)}}, {}, {});
  ASSERT_TRUE(recorder);
  (*recorder)->begin(BenchTime(0));
  *blocked = true;
  auto pool = make_sample_pool(16, 640 * 480);
  for (std::uint64_t k = 0; k < 12; ++k) (*recorder)->record(0, image(*pool, k, BenchTime(0), 640, 480));
  EXPECT_TRUE((*recorder)->failed());
  *blocked = false;
  const auto s = (*recorder)->stop();
  ASSERT_FALSE(s);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("could not keep up"));
  EXPECT_EQ(s.error().exit_status(), 1);
}

#if !defined(RIGOR_THREAD_SANITIZER)  // it cannot follow threads of a forked process
TEST(Recorder, SaysAtOnceWhenTheDiskIsFullAndKeepsWhatIsThere) {
  test::TemporaryDirectory directory;
  const std::string path = directory.file("full.mcap");
  const pid_t child = fork();
  if (child == 0) {  // a file size limit acts as a full disk; in a process of its own, because it cannot be
                     // raised again
    signal(SIGXFSZ, SIG_IGN);
    rlimit limit{2'000'000, 2'000'000};
    setrlimit(RLIMIT_FSIZE, &limit);
    auto recorder = Recorder::create(path, {}, {{"cam", images_of(640, 480)}}, {}, {});
    if (!recorder) _exit(10);
    (*recorder)->begin(BenchTime(0));
    auto pool = make_sample_pool(16, 640 * 480);
    for (std::uint64_t k = 0; k < 400 && !(*recorder)->failed(); ++k) {
      const BenchTime now = BenchTime(0) + milliseconds(static_cast<std::int64_t>(k));
      (*recorder)->record(0, image(*pool, k, now, 640, 480));
      (*recorder)->end_cycle(k, now);
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    if (!(*recorder)->failed()) _exit(11);
    if ((*recorder)->stop()) _exit(12);
    if (pool->in_use() != 0) _exit(13);
    _exit((*recorder)->error().exit_status());
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 1);
  auto reader = record::McapReader::open(path);
  ASSERT_TRUE(reader) << reader.error().text();
  EXPECT_GE((*reader)->message_count(), 3u * 4);
}

TEST(Recorder, LosesAtMostASecondWhenItIsKilled) {
  test::TemporaryDirectory directory;
  const std::string path = directory.file("killed.mcap");
  const pid_t child = fork();
  if (child == 0) {
    RecorderOptions options;
    options.writer.compression = record::Compression::zstd;
    ChannelDescription d;
    d.kind = SampleKind::register_block;
    d.names = d.units = {"a", "b"};
    auto recorder = Recorder::create(path, options, {{"table", d}}, {}, {});
    if (!recorder) _exit(10);
    auto pool = make_sample_pool(4, 0);
    const BenchTime t0(monotonic_now().ns());
    (*recorder)->begin(t0);
    for (std::uint64_t k = 0;; ++k) {
      const BenchTime now = t0 + milliseconds(static_cast<std::int64_t>(k));
      (*recorder)->record(0, block(*pool, k, now));
      (*recorder)->end_cycle(k, now);
      if (k == 2500) raise(SIGKILL);
      while (bench_now() < now) std::this_thread::sleep_for(std::chrono::microseconds(300));
    }
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFSIGNALED(status));
  auto reader = record::McapReader::open(path);
  ASSERT_TRUE(reader) << reader.error().text();
  EXPECT_TRUE((*reader)->health().truncated);
  EXPECT_GE((*reader)->message_count(), 2u * 1500) << "of 2500 samples with their stamps";
}
#endif

TEST(Recorder, RefusesWhatIsRecordedBeforeItIsToldWhenTheRunBegins) {
  auto recorder =
      Recorder::create(std::make_unique<record::MemorySink>(), {}, {{"cam", images_of(4, 4)}}, {}, {});
  ASSERT_TRUE(recorder) << recorder.error().text();
  auto pool = make_sample_pool(2, 16);
  (*recorder)->record(0, image(*pool, 0, BenchTime(0), 4, 4));
  (*recorder)->end_cycle(0, BenchTime(0));
  const auto s = (*recorder)->stop();
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::wrong_state);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("begin()"));
}

TEST(Recorder, RefusesTwoChannelsOfOneNameAndAnOutputThatCannotBe) {
  auto s = Recorder::create("/nonexistent/dir/x.mcap", {}, {}, {}, {});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_writable);
  s = Recorder::create(std::make_unique<record::MemorySink>(), {},
                       {{"a", images_of(1, 1)}, {"a", images_of(1, 1)}}, {}, {});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::bad_input);
}

}  // namespace
}  // namespace rigor
