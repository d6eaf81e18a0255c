// The demo with a detector in this process: as an application of its own, and cycle by cycle.
#include <bench/bench.h>
#include <builtin/registry.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <iostream>

namespace {

/// Where the rigs are that came with Rigor; RIGOR_CONFIGS names the folder.
rigor::Result<rigor::RigConfig> demo(const std::vector<std::string>& settings) {
  std::vector<rigor::ConfigOverride> overrides;
  for (const std::string& s : settings) overrides.push_back(*rigor::ConfigOverride::parse(s));
  auto rig = rigor::load_rig(std::string(std::getenv("RIGOR_CONFIGS")) + "/demo.yaml", overrides);
  if (rig) {
    rig->clock = rigor::ClockKind::virtual_time;
    rig->duration = rigor::milliseconds(400);
    rig->record.file = "embedded.mcap";
    rig->report.clear();
  }
  return rig;
}

/// Turns the table towards the brightest column of the picture.
double rate_for(const rigor::Sample& picture) {
  const std::uint32_t width = picture.as<rigor::ImageInfo>()->width_px;
  const auto pixels = picture.bytes();
  std::vector<std::uint64_t> columns(width);
  for (std::size_t i = 0; i < pixels.size(); ++i) columns[i % width] += std::to_integer<unsigned>(pixels[i]);
  const auto brightest = std::max_element(columns.begin(), columns.end()) - columns.begin();
  return 0.1 * (static_cast<double>(brightest) - width / 2.0);
}

class Detector : public rigor::Application {
 public:
  rigor::Status configure(rigor::ConfigNode, const rigor::ApplicationPorts& ports, rigor::Period) override {
    camera_ = ports.inputs.at("right").port;
    table_ = ports.outputs.at("table_command");
    return {};
  }
  /// 50 times a second. (A vector in a loop that runs by the clock would be taken at configure.)
  void step(std::uint64_t cycle, rigor::BenchTime t) noexcept override {
    if (camera_->status() == rigor::PortStatus::fresh) rate_degps_ = rate_for(*camera_->sample());
    if (cycle % 20 == 0) table_->send(t, std::array{1.0, rate_degps_});
  }

 private:
  const rigor::SamplePort* camera_ = nullptr;
  rigor::CommandPort* table_ = nullptr;
  double rate_degps_ = 0;
};

TEST(Detector, TurnsTheTable) {
  rigor::Registry registry = rigor::make_registry();
  registry.add(rigor::NamedApplication{"detector", [] { return std::make_unique<Detector>(); }});
  auto rig = demo({"application={name: detector}",
                   "expect=[{of: table_command.target_rate, value: {min: -40, max: 40}}]"});
  ASSERT_TRUE(rig) << rig.error().text();
  // The recording replaces that of an earlier run.
  auto bench = rigor::Bench::create(std::move(*rig), registry, {.replace = true});
  ASSERT_TRUE(bench) << bench.error().text();
  const rigor::Status ready = (*bench)->prepare();
  ASSERT_TRUE(ready) << ready.error().text();
  const auto report = (*bench)->run();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_TRUE(report->passed()) << report->text();
  EXPECT_EQ(report->facts.sinks.at(0).accepted, 20u);
  std::cout << "digest " << report->outcome.input_sha256 << '\n';
}

TEST(Bench, IsSteppedAndLookedAt) {
  auto rig = demo({});
  ASSERT_TRUE(rig) << rig.error().text();
  rig->application.clear();  // the commands come from here
  rig->record.file.clear();
  auto bench = rigor::Bench::create(std::move(*rig), rigor::make_registry());
  ASSERT_TRUE(bench) << bench.error().text();
  ASSERT_TRUE((*bench)->prepare());
  ASSERT_TRUE((*bench)->start());
  const rigor::Status injected = (*bench)->inject_fault("right", {.kind = rigor::FaultKind::drop});
  EXPECT_TRUE(injected) << injected.error().text();
  const rigor::SamplePort& table = *(*bench)->ports().inputs.at("turntable").port;
  const rigor::SamplePort& camera = *(*bench)->ports().inputs.at("right").port;
  double position_deg = 0;
  for (auto more = (*bench)->step(10); more && *more; more = (*bench)->step(10)) {
    if (table.sample()) position_deg = table.sample()->as<rigor::RegisterBlock>()->value[0];
    ASSERT_TRUE((*bench)->command("table_command", std::array{1.0, 20.0}));
    EXPECT_FALSE(camera.sample()) << "every picture is dropped";
  }
  EXPECT_GT(position_deg, 1) << "the table was told to turn";
  const auto report = (*bench)->finish();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_EQ(report->outcome.loop.cycles_run, 400u);
}

}  // namespace
