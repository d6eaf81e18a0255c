// `rigor host NAME`: an application that was written for the loop, in a process of its own.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <bit>
#include <cmath>
#include <cstdlib>
#include <deque>

#include "bench/console/terminal.h"
#include "builtin/registry.h"
#include "cli/commands.h"
#include "clients/cpp/rigor_client.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {
namespace {

static_assert(sizeof(rigor_client::Point) == sizeof(LidarPoint));

SampleKind kind_of(const std::string& name) {
  for (int k = 1; k <= static_cast<int>(kLastSampleKind); ++k)
    if (kind_name(static_cast<SampleKind>(k)) == name) return static_cast<SampleKind>(k);
  throw std::runtime_error("the bench names a kind of samples that this program does not know: " + name);
}

PortStatus status_of(rigor_client::Status status) {
  switch (status) {
    case rigor_client::Status::fresh:
      return PortStatus::fresh;
    case rigor_client::Status::held:
      return PortStatus::held;
    case rigor_client::Status::overdue:
      return PortStatus::overdue;
    case rigor_client::Status::disconnected:
      return PortStatus::disconnected;
    case rigor_client::Status::never:
      break;
  }
  return PortStatus::never;
}

decltype(Sample::info) info_of(const rigor_client::Sample& s, PixelFormat format) {
  switch (static_cast<SampleKind>(s.kind)) {
    case SampleKind::image: {
      const auto i = s.info<rigor_client::ImageInfo>();
      ImageInfo info;
      info.format = pixel_format_from(i.format).value_or(format);
      info.width_px = i.width_px, info.height_px = i.height_px;
      info.offset_x_px = i.offset_x_px, info.offset_y_px = i.offset_y_px;
      info.exposure = Duration(i.exposure_ns);
      info.gain_db = i.gain_db;
      return info;
    }
    case SampleKind::range_image: {
      const auto i = s.info<rigor_client::RangeImageInfo>();
      return RangeImageInfo{i.width_px, i.height_px};
    }
    case SampleKind::point_cloud:
      return PointCloudInfo{s.info<rigor_client::PointCloudInfo>().count};
    case SampleKind::can_frame: {
      const auto f = s.info<rigor_client::CanFrame>();
      CanFrame frame;
      frame.id = f.id;
      frame.extended = f.flags & 1U, frame.remote = f.flags & 2U, frame.error = f.flags & 4U;
      frame.fd = f.flags & 8U, frame.bit_rate_switch = f.flags & 16U;
      frame.length = std::min<std::uint8_t>(f.length, sizeof f.data);
      std::copy_n(f.data, frame.length, frame.data.begin());
      return frame;
    }
    case SampleKind::register_block: {
      const auto values = s.values();
      RegisterBlock block;
      block.count = static_cast<std::uint32_t>(std::min(values.size(), RegisterBlock::kMax));
      std::copy_n(values.begin(), block.count, block.value.begin());
      return block;
    }
    case SampleKind::pose:
      return std::bit_cast<Pose>(s.info<rigor_client::Pose>());
    case SampleKind::event: {
      const auto e = s.info<rigor_client::Event>();
      EventInfo info;
      info.code = e.code, info.value = e.value;
      std::copy_n(e.text, info.text.size() - 1, info.text.begin());
      return info;
    }
    case SampleKind::imu:
      return std::bit_cast<ImuSample>(s.info<rigor_client::Imu>());
    case SampleKind::nav_fix: {
      const auto f = s.info<rigor_client::NavFix>();
      NavFix fix;
      fix.status = static_cast<FixStatus>(f.status);
      fix.satellites = static_cast<std::uint16_t>(f.satellites);
      fix.latitude_deg = f.latitude_deg, fix.longitude_deg = f.longitude_deg, fix.height_m = f.height_m;
      std::copy_n(f.covariance_enu_m2, 9, fix.covariance_enu_m2.begin());
      return fix;
    }
    case SampleKind::odometry:
      return std::bit_cast<Odometry>(s.info<rigor_client::Odometry>());
    case SampleKind::none:
      break;
  }
  throw std::runtime_error("the bench sent a sample of an unknown kind");
}

/// An input as the application sees it in the loop.
class HostedInput {
 public:
  explicit HostedInput(const rigor_client::Port& told) : pool_(SamplePort::kPending + 2) {
    description.kind = kind_of(told.kind);
    description.frame_id = told.frame_id;
    description.width_px = told.width_px, description.height_px = told.height_px;
    description.format = pixel_format_from(told.format).value_or(PixelFormat::mono8);
    description.names = told.names, description.units = told.units;
  }
  void show(const rigor_client::Port& now, BenchTime t) {
    std::uint64_t newest = 0;
    for (const rigor_client::Sample& s : now.samples) {
      SampleSlot slot = pool_.try_acquire();
      if (!slot) throw std::runtime_error(now.name + ": more samples in a turn than there is room for");
      Sample& sample = *slot;
      sample.stamp = {};
      sample.stamp.sequence = newest = s.sequence;
      sample.stamp.t_capture = BenchTime(s.t_capture_ns);
      sample.stamp.t_release = BenchTime(s.t_release_ns);
      sample.stamp.t_arrival = BenchTime(s.t_arrival_ns);
      sample.stamp.sigma_capture = Duration(s.sigma_capture_ns);
      sample.stamp.lost_before = s.lost_before;
      sample.stamp.validity = s.validity;
      sample.info = info_of(s, description.format);
      if (sample.memory().size() < s.bytes.size()) sample.reserve(s.bytes.size());
      std::copy(s.bytes.begin(), s.bytes.end(), sample.memory().begin());
      sample.size_bytes = s.bytes.size();
      port.push(std::move(slot));
    }
    port.obey(status_of(now.status), newest, t);
  }
  ChannelDescription description;
  SamplePort port;

 private:
  SamplePool pool_;
};

/// Keeps what the application commands in a cycle.
class HostedSink final : public Sink {
 public:
  explicit HostedSink(const rigor_client::Output& output) : name(output.name) {
    description_.kind = SampleKind::register_block;
    description_.names = output.names, description_.units = output.units;
  }
  bool command(const Command& command) noexcept override {
    if (count == commands.size()) return false;
    commands[count++] = command;
    return true;
  }
  void watch(const Heartbeat*, Duration) override {}
  std::string name;
  std::array<Command, 8> commands{};
  std::size_t count = 0;

 private:
  Status do_configure(const ChannelConfig&) override { return {}; }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_start(BenchTime) override { return {}; }
  Status do_stop() override { return {}; }
};

class Host final : public rigor_client::Application {
 public:
  explicit Host(std::unique_ptr<rigor::Application> application) : application_(std::move(application)) {}

  void start(const rigor_client::Rig& rig) override {
    ApplicationPorts ports;
    for (const auto& input : rig.inputs) {
      HostedInput& in = inputs_.emplace_back(input);
      ports.inputs[input.name] = {input.name, &in.description, &in.port};
    }
    for (const auto& output : rig.outputs) {
      HostedSink& sink = sinks_.emplace_back(output);
      outputs_.emplace_back(output.name, sink, seconds_from(output.latency_ms * 1e-3));
      ports.outputs[output.name] = &outputs_.back();
    }
    auto params = ConfigDocument::parse(rig.params.dump(), "application.params");
    if (!params) throw std::runtime_error(params.error().text());
    if (auto s = application_->configure(*params, ports,
                                         Period::of_rate(std::llround(rig.loop_rate_hz * 1e6), 1'000'000));
        !s)
      throw std::runtime_error(s.error().text());
    names_ = rig.inputs;
  }
  void step(rigor_client::Turn& turn) override {
    const BenchTime t(turn.t_ns);
    for (std::size_t i = 0; i < inputs_.size(); ++i) inputs_[i].show(turn[names_[i].name], t);
    application_->step(turn.cycle, t);
    for (HostedSink& sink : sinks_) {
      for (std::size_t i = 0; i < sink.count; ++i)
        turn.command(sink.name, std::span(sink.commands[i].value.data(), sink.commands[i].count));
      sink.count = 0;
    }
    if (application_->failed()) finish();
  }
  void finish() override {
    if (auto s = application_->finish(); !s) throw std::runtime_error(s.error().text());
  }

 private:
  std::unique_ptr<rigor::Application> application_;
  std::deque<HostedInput> inputs_;
  std::deque<HostedSink> sinks_;
  std::deque<CommandPort> outputs_;
  std::vector<rigor_client::Port> names_;
};

}  // namespace

int host_command(const HostOptions& options) {
  const auto registry = make_registry(options.plugins);
  if (!registry) return report_error(registry.error(), false);
  const NamedApplication* known = registry->find_application(options.application);
  if (!known) {
    const auto names = registry->application_names();
    return report_error({ErrorCode::bad_input, "APPLICATION",
                         fmt::format("expected one of {}, got \"{}\"{}", fmt::join(names, ", "),
                                     options.application, did_you_mean(options.application, names))},
                        false);
  }
  Host host(known->make());
  return rigor_client::run(host);
}

}  // namespace rigor
