#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/usb/scan_keeper.h"

namespace rigor::usb {
namespace {

DeviceTime ms(std::int64_t n) { return DeviceTime(n * 1'000'000); }

/// Scan k has k + step as its ranges.
bool counted(std::uint64_t scan, DeviceTime, std::span<std::uint32_t> range,
             std::span<std::uint32_t> intensity) {
  for (std::size_t s = 0; s < range.size(); ++s) {
    range[s] = static_cast<std::uint32_t>(100 + scan + s);
    intensity[s] = static_cast<std::uint32_t>(s);
  }
  return true;
}

struct Rig {
  explicit Rig(const ScannerModel& model = urg_04lx(), ScipDevice::Options options = {})
      : device(model, counted, options) {}
  std::string ask(std::string_view line, DeviceTime t) {
    device.receive(std::string(line) + "\n", t);
    return std::exchange(device.output(), {});
  }
  std::vector<ScipScan> scans(DeviceTime until) {
    device.advance(until);
    reader.push(std::exchange(device.output(), {}), 0);
    std::vector<ScipScan> out;
    ScipReply reply;
    ScipScan scan;
    while (reader.next(reply))
      if (decode_scan(reply, scan) == ScanDecode::scan) out.push_back(scan);
    return out;
  }
  ScipDevice device;
  ScipReplyReader reader;
};

TEST(ScipDevice, AnswersInTheDocumentedForm) {
  Rig r;
  EXPECT_EQ(r.ask("BM", ms(1)), "BM\n00P\n\n");
  EXPECT_EQ(r.ask("BM;x", ms(2)), "BM;x\n02R\n\n");
  EXPECT_EQ(r.ask("QT", ms(3)), "QT\n00P\n\n");
  EXPECT_EQ(r.ask("GD0044072501", ms(4)), "GD0044072501\n10Q\n\n");
  EXPECT_EQ(r.ask("MD0044076901000", ms(4)), "MD0044076901000\n04T\n\n");
  EXPECT_EQ(r.ask("ME0044072501000", ms(4)), "ME0044072501000\n0Ee\n\n") << "a URG-04LX has no intensity";
  EXPECT_THAT(r.ask("PP", ms(5)), testing::HasSubstr("\nDMAX:5600;_\nARES:1024;\\\nAMIN:44;7\nAMAX:725;o\n"));
  EXPECT_EQ(r.ask("CR05", ms(6)), "CR05\n00P\n\n");
  EXPECT_EQ(r.ask("CR05", ms(6)), "CR05\n03S\n\n");
}

TEST(ScipDevice, InTheClocksModeOnlyTheClockAnswers) {
  Rig r;
  EXPECT_EQ(r.ask("TM1", ms(1)), "TM1\n04T\n\n");
  EXPECT_EQ(r.ask("TM0", ms(2)), "TM0\n00P\n\n");
  EXPECT_EQ(r.ask("TM0", ms(2)), "TM0\n02R\n\n");
  EXPECT_EQ(r.ask("QT", ms(2)), "QT\n0Ee\n\n");
  std::string time;
  scip_encode(1234, 4, time);
  EXPECT_EQ(r.ask("TM1", ms(1234)), "TM1\n00P\n" + time + scip_sum(time) + "\n\n");
  EXPECT_EQ(r.ask("TM2", ms(1235)), "TM2\n00P\n\n");
  EXPECT_EQ(r.ask("TM2", ms(1235)), "TM2\n03S\n\n");
}

TEST(ScipDevice, SendsEachTurnOnceAndCountsDown) {
  Rig r;
  EXPECT_EQ(r.ask("MD0044072501005", ms(10)), "MD0044072501005\n00P\n\n");
  EXPECT_TRUE(r.device.laser());
  // The turn that had begun before the command is not measured: step 0 of the next one passes at 100 ms.
  EXPECT_TRUE(r.scans(ms(170)).empty());
  auto scans = r.scans(ms(2000));
  ASSERT_EQ(scans.size(), 5u);
  for (std::uint32_t i = 0; i < 5; ++i) {
    EXPECT_EQ(scans[i].request.scans, 4 - i);
    EXPECT_EQ(scans[i].stamp_ms, 100 + 100 * i);
    EXPECT_EQ(scans[i].range_mm.front(), 100 + 44 + 1 + i);
  }
  EXPECT_FALSE(r.device.laser()) << "the laser goes off after the last one";
  // With two left out between: every third turn.
  (void)r.ask("MD0044072501200", ms(2000));
  scans = r.scans(ms(3000));
  ASSERT_GE(scans.size(), 3u);
  EXPECT_EQ(scans[1].stamp_ms - scans[0].stamp_ms, 300u);
}

TEST(ScipDevice, GivesTheLatestScanOrTheFirstThatComes) {
  Rig r;
  (void)r.ask("BM", ms(1010));
  EXPECT_EQ(r.ask("GD0044072501", ms(1050)), "") << "none is measured yet";
  auto scans = r.scans(ms(1300));
  ASSERT_EQ(scans.size(), 1u);
  EXPECT_EQ(scans[0].stamp_ms, 1100u);
  r.device.receive("GS0044072503\n", ms(1490));
  scans = r.scans(ms(1490));
  ASSERT_EQ(scans.size(), 1u);
  EXPECT_EQ(scans[0].stamp_ms, 1400u);
  EXPECT_EQ(scans[0].range_mm.size(), 228u);
}

TEST(ScipDevice, MergesAClusterToItsSmallestRangeThatIsNoCode) {
  ScipDevice device(urg_04lx(),
                    [](std::uint64_t, DeviceTime, std::span<std::uint32_t> range, std::span<std::uint32_t>) {
                      for (std::size_t s = 0; s < range.size(); ++s)
                        range[s] = s % 3 == 0 ? 1 : static_cast<std::uint32_t>(3000 - s);
                      return true;
                    },
                    {});
  device.receive("MD0044004903001\n", ms(0));
  device.advance(ms(1000));
  ScipReplyReader reader;
  reader.push(device.output(), 0);
  ScipReply reply;
  ScipScan scan;
  while (reader.next(reply)) (void)decode_scan(reply, scan);
  EXPECT_THAT(scan.range_mm, testing::ElementsAre(3000u - 46, 3000u - 49));
}

TEST(ScipDevice, DropsWholeScansWhenNobodyReads) {
  Rig r(urg_04lx(), {.backlog_bytes = 10000});
  (void)r.ask("MD0044072501000", ms(0));
  r.device.advance(ms(10000));
  EXPECT_LT(r.device.output().size(), 15000u);
  EXPECT_GT(r.device.counters().scans_dropped, 80u);
  const auto sent = r.device.counters().scans_sent;
  EXPECT_EQ(r.scans(ms(10000)).size(), sent);
}

// ------------------------------------------------------------------ both ends

/// A session over a wire that takes `delay` each way.
struct Session {
  explicit Session(const ScannerModel& model, ScipClient::Options options,
                   ScipDevice::Options device_options = {}, std::int64_t delay_ns = 300'000)
      : device(model, counted, device_options), client(options), delay(delay_ns) {}

  void run(std::int64_t until_ns) {
    while (now < until_ns) {
      if (!client.output().empty()) {
        const std::string bytes = client.output();
        client.sent(now);
        device.receive(bytes, DeviceTime(now + delay));
      }
      device.advance(DeviceTime(now));
      if (!device.output().empty()) {
        std::string bytes = std::exchange(device.output(), {});
        client.receive(bytes, now + 2 * delay);
      }
      client.tick(now);
      now += 1'000'000;
    }
  }
  ScipDevice device;
  ScipClient client;
  std::int64_t delay, now = 0;
};

TEST(ScipClient, OpensASessionReadsTheClockAndMeasures) {
  Session s(utm_30lx(), {.scan = {.intensity = true}});
  s.client.begin(0);
  s.run(200'000'000);
  ASSERT_EQ(s.client.phase(), ScipClient::Phase::ready) << s.client.failure();
  EXPECT_EQ(s.client.parameters().last_step, 1080u);
  EXPECT_EQ(s.client.identity().product, "SOKUIKI Sensor UTM-30LX");
  ScipClient::Reading reading;
  int readings = 0;
  while (s.client.next_reading(reading)) {
    ++readings;
    EXPECT_LE(reading.before_ns, static_cast<std::int64_t>(reading.ms + 1) * 1'000'000);
    EXPECT_GE(reading.after_ns, static_cast<std::int64_t>(reading.ms) * 1'000'000);
  }
  EXPECT_EQ(readings, 16);
  s.client.start(s.now);
  s.run(s.now + 3'000'000'000);
  ScipScan scan;
  std::int64_t arrival = 0;
  std::uint32_t last = 0, n = 0;
  while (s.client.next_scan(scan, arrival)) {
    EXPECT_EQ(scan.range_mm.size(), 1081u);
    EXPECT_EQ(scan.intensity.size(), 1081u);
    if (n++ > 0) {
      EXPECT_EQ(scan.stamp_ms - last, 25u);
    }
    last = scan.stamp_ms;
  }
  EXPECT_GE(n, 60u);
  readings = 0;
  while (s.client.next_reading(reading)) ++readings;
  EXPECT_GE(readings, 2) << "the clock is read while the laser is on";
  s.client.stop(s.now);
  s.run(s.now + 100'000'000);
  EXPECT_EQ(s.client.phase(), ScipClient::Phase::idle);
  EXPECT_FALSE(s.device.laser());
}

TEST(ScipClient, TakesOverAScannerThatIsInTheMiddleOfSomething) {
  for (const char* before : {"MD0044072501000\n", "TM0\n", "MD00440725", "BM\nGD0044072501\n"}) {
    Session s(urg_04lx(), {});
    s.device.receive(before, ms(0));
    s.run(950'000'000);
    s.client.begin(s.now);
    s.run(s.now + 500'000'000);
    EXPECT_EQ(s.client.phase(), ScipClient::Phase::ready) << before << s.client.failure();
  }
}

TEST(ScipClient, SaysWhyItGaveUp) {
  ScipClient client({});
  client.begin(0);
  for (std::int64_t t = 0; t < 10'000'000'000; t += 10'000'000) client.tick(t);
  EXPECT_EQ(client.phase(), ScipClient::Phase::failed);
  EXPECT_THAT(client.failure(), testing::HasSubstr("SCIP 2.0"));
  // A URG-04LX refuses ME.
  Session s(urg_04lx(), {.scan = {.intensity = true}});
  s.client.begin(0);
  s.run(300'000'000);
  s.client.start(s.now);
  s.run(s.now + 300'000'000);
  EXPECT_EQ(s.client.phase(), ScipClient::Phase::failed);
  EXPECT_THAT(s.client.failure(), testing::HasSubstr("does not know"));
}

TEST(ScipClient, ChecksStepsAgainstWhatTheScannerSays) {
  Session s(urg_04lx(), {.scan = {.first_step = 10}});
  s.client.begin(0);
  s.run(300'000'000);
  ASSERT_TRUE(s.client.check());
  EXPECT_EQ(s.client.check()->key, "start_step");
  EXPECT_THAT(s.client.check()->message, testing::HasSubstr("44 … 725"));
  Session two(urg_04lx(), {.scan = {.two_characters = true}});
  two.client.begin(0);
  two.run(300'000'000);
  ASSERT_TRUE(two.client.check());
  EXPECT_EQ(two.client.check()->key, "characters");
}

TEST(ScanKeeper, PutsScansOnTheBenchClockWithinTheirSigma) {
  // A clock that runs 80 ppm fast and started 4.6 h ago, so that it wraps meanwhile.
  Session s(utm_30lx(), {}, {.phase = nanoseconds(7'300'000), .clock_start_ms = 16'770'000, .clock_ppm = 80});
  s.client.begin(0);
  s.run(300'000'000);
  ScanKeeper keeper;
  RunOrigin origin;
  origin.publish(BenchTime(0));
  keeper.begin(milliseconds(60), s.client.request(), s.client.parameters());
  const auto read = [&] {
    ScipClient::Reading reading;
    while (s.client.next_reading(reading)) keeper.reading(reading);
  };
  read();
  s.client.start(s.now);
  std::uint64_t lost = 0, n = 0, sequence = 0;
  for (int i = 0; i < 400; ++i) {
    s.run(s.now + 50'000'000);
    read();
    ScipScan scan;
    std::int64_t arrival = 0;
    Sample sample;
    sample.reserve(1081 * sizeof(LidarPoint));
    while (s.client.next_scan(scan, arrival)) {
      const auto kept = keeper.place(scan, BenchTime(arrival), origin);
      ASSERT_TRUE(kept.in_run && kept.in_order);
      lost += kept.lost;
      keeper.fill(scan, sample);
      const std::uint64_t k = scan.range_mm[0] - 100;  // its own number
      const BenchTime truth(s.device.step_zero(k).ns());
      const double error_ms = static_cast<double>((sample.stamp.t_capture - truth).ns()) * 1e-6;
      const double sigma_ms = static_cast<double>(sample.stamp.sigma_capture.ns()) * 1e-6;
      EXPECT_LT(std::abs(error_ms), 4 * sigma_ms) << "scan " << n;
      EXPECT_LT(sigma_ms, 2.0);
      if (n++ > 0) {
        EXPECT_EQ(sample.stamp.sequence, sequence + 1);
      }
      sequence = sample.stamp.sequence;
      EXPECT_EQ(sample.as<PointCloudInfo>()->count, 1081u);
    }
  }
  EXPECT_GT(n, 750u);
  EXPECT_EQ(lost, 0u);
}

TEST(ScipPoints, RoundTripThroughThePlaneKeepsEveryMillimetre) {
  for (const ScannerModel* model : {&urg_04lx(), &utm_30lx()}) {
    const ScannerParameters& p = model->parameters;
    ScipScan scan;
    scan.request.first_step = p.first_step;
    scan.request.last_step = p.last_step;
    for (std::uint32_t s = p.first_step; s <= p.last_step; ++s)
      scan.range_mm.push_back(s % 5 == 0 ? model->no_return_code : p.min_range_mm + (s * 37) % 5000);
    std::vector<LidarPoint> points(scan.range_mm.size());
    points.resize(scan_points(scan, p, points));
    std::vector<std::uint32_t> range(model->end_step + 1), intensity(model->end_step + 1);
    measure_points(points, *model, range, intensity);
    for (std::uint32_t s = p.first_step; s <= p.last_step; ++s)
      ASSERT_EQ(range[s], scan.range_mm[s - p.first_step]) << model->name << " step " << s;
  }
}

}  // namespace
}  // namespace rigor::usb
