#include "bridges/ros2/ros2_source.h"

#include <fmt/format.h>

#include <cmath>
#include <cstring>

#include "bridges/ros2/names.h"
#include "bridges/ros2/payload.h"
#include "bridges/ros2/ros2_bridge.h"
#include "bridges/ros2/settings.h"
#include "rt-core/epoch.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/config/sample_size.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor::ros2 {
namespace {

namespace msg = record::msg;

std::string_view usual_type(SampleKind kind) {
  switch (kind) {
    case SampleKind::image:
    case SampleKind::range_image:
      return msg::Image::kType;
    case SampleKind::point_cloud:
      return msg::PointCloud2::kType;
    case SampleKind::imu:
      return msg::Imu::kType;
    case SampleKind::nav_fix:
      return msg::NavSatFix::kType;
    case SampleKind::odometry:
      return msg::Odometry::kType;
    case SampleKind::pose:
      return msg::PoseStamped::kType;
    case SampleKind::can_frame:
      return msg::Frame::kType;
    case SampleKind::event:
      return msg::Event::kType;
    case SampleKind::register_block:
    case SampleKind::none:
      break;
  }
  return {};
}

constexpr std::int64_t kSecond = 1'000'000'000;

/// The epoch is read again after so long: NTP moves CLOCK_REALTIME.
constexpr Duration kEpochAge = seconds(1);

}  // namespace

Ros2Source::~Ros2Source() { (void)do_stop(); }

void Ros2Source::read_size(const ConfigNode& n, SampleKind kind) {
  if (kind == SampleKind::image || kind == SampleKind::range_image) {
    description_.width_px = static_cast<std::uint32_t>(n.integer("width_px", {.min = 1, .max = 65536}));
    description_.height_px = static_cast<std::uint32_t>(n.integer("height_px", {.min = 1, .max = 65536}));
    check_picture_size(n, description_.width_px, description_.height_px);
  }
  if (kind == SampleKind::image) {
    const std::string format = n.text_or("pixel_format", "Mono8");
    const auto known = pixel_format_from(format);
    if (!known)
      throw n.error(
          "pixel_format",
          "expected a pixel format such as Mono8, Mono16, BayerRG8 or RGB8, got \"" + format + "\"");
    description_.format = *known;
    description_.max_bytes = image_bytes(*known, description_.width_px, description_.height_px);
  } else if (kind == SampleKind::range_image) {
    description_.max_bytes = std::size_t{2} * description_.width_px * description_.height_px * sizeof(float);
  } else if (kind == SampleKind::point_cloud) {
    const auto most = n.integer_or("max_points", 200'000, {.min = 1, .max = 20'000'000});
    description_.max_bytes = static_cast<std::size_t>(most) * sizeof(LidarPoint);
  }
  check_buffer_memory(n, "slots", slots_, description_.max_bytes);
}

void Ros2Source::read_registers(const ConfigNode& n) {
  auto definition = read_definition(type_.name, type_.definition);
  if (!definition) throw ConfigError(definition.error());
  const ConfigNode map = n.map("values");
  std::vector<std::string> paths;
  for (const std::string& name : map.keys()) {
    const std::string path = map.text(name);
    if (auto one = ValueReader::make(*definition, {path}); !one) throw map.error(name, one.error().message);
    description_.names.push_back(name);
    description_.units.emplace_back();
    paths.push_back(path);
  }
  map.finish();
  if (paths.empty() || paths.size() > RegisterBlock::kMax)
    throw n.error("values",
                  fmt::format("expected 1 to {} values, got {}", RegisterBlock::kMax, paths.size()));
  std::vector<std::string> stamped = paths;
  stamped.insert(stamped.end(), {"header.stamp.sec", "header.stamp.nanosec"});
  auto reader = ValueReader::make(*definition, std::move(stamped));
  values_have_stamp_ = reader.has_value();
  if (!reader) reader = ValueReader::make(std::move(*definition), std::move(paths));
  if (!reader) throw ConfigError(reader.error());
  numbers_.resize(reader->paths().size());
  values_.emplace(std::move(*reader));
}

Status Ros2Source::do_configure(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  description_ = {};
  values_.reset();
  description_.kind = config.kind;
  description_.frame_id = n.text_or("frame_id", config.name);
  domain_ = read_domain(n);
  qos_ = read_qos(n, {Qos::Profile::sensor_data, 0});
  topic_ = n.text("topic");
  check_topic(n, "topic", topic_);
  by_arrival_ = n.choice_or("stamp", {"header", "arrival"}, "header") == "arrival";
  slots_ = static_cast<std::size_t>(n.integer_or("slots", 16, {.min = 2, .max = 4096}));
  const std::string usual(usual_type(config.kind));
  const std::string type = usual.empty() ? n.text("type") : n.text_or("type", usual);
  type_ = {full_type(type), definition_text(type)};
  const bool scan = config.kind == SampleKind::point_cloud && type_.name == msg::LaserScan::kType;
  if (type_.definition.empty() || (!usual.empty() && type_.name != usual && !scan))
    throw n.error(
        "type",
        usual.empty()
            ? fmt::format("expected a type of messages with numbers, such as {}, got \"{}\"{}",
                          joined_or_none(command_types()), type, did_you_mean(type, command_types()))
            : fmt::format("expected {}{} for a channel of this kind, got \"{}\"", usual,
                          config.kind == SampleKind::point_cloud ? " or sensor_msgs/LaserScan" : "", type));
  read_size(n, config.kind);
  if (config.kind == SampleKind::register_block) read_registers(n);
  return {};
}

Status Ros2Source::do_arm(const ArmContext&) {
  auto participant = Participant::open(domain_);
  if (!participant) return tl::unexpected<Error>(participant.error());
  participant_ = std::move(*participant);
  auto reader = participant_->read(topic_, type_, qos_);
  if (!reader) return tl::unexpected<Error>(reader.error());
  reader_ = std::move(*reader);
  open_stream(slots_, description_.max_bytes, false);
  channel_ = {1, 1, topic_, "cdr", {}};
  schema_ = {1, type_.name, "ros2msg", {}};
  epoch_read_ = {};
  lost_ = 0;
  count_ = 0;
  sequence_ = 0;
  stopping_ = false;
  waiter_ = std::make_unique<Waiter>();
  waiter_->add(*reader_);
  thread_ = std::thread([this] { work(); });
  return {};
}

Status Ros2Source::do_start(BenchTime) {
  sequence_.store(0, std::memory_order_relaxed);
  return {};
}

Status Ros2Source::do_stop() {
  if (thread_.joinable()) {
    stopping_ = true;
    waiter_->stop();
    thread_.join();
  }
  waiter_.reset();
  if (reader_) {
    if (const Mismatch m = reader_->mismatch(); m.count > 0)
      complain(fmt::format("{} publishers of {} offer another {} than the channel asks for ({}); set `qos`",
                           m.count, topic_, m.policy.empty() ? "quality of service" : m.policy,
                           name_of(qos_)));
  }
  reader_.reset();
  participant_.reset();
  health_.connected.store(false, std::memory_order_release);
  close_stream();
  return {};
}

std::vector<std::string> Ros2Source::warnings() const {
  const std::lock_guard lock(mutex_);
  if (complaint_.empty()) return {};
  return {config().name + ": " + complaint_};
}

void Ros2Source::complain(const std::string& what) {
  const std::lock_guard lock(mutex_);
  if (complaint_.empty()) complaint_ = what;
}

void Ros2Source::work() {
  std::vector<std::byte> joined;
  while (!stopping_) {
    waiter_->wait(milliseconds(50));
    health_.connected.store(reader_->peers() > 0, std::memory_order_release);
    while (ddsi_serdata* message = reader_->take()) {
      take(bytes_of(message, joined));
      Reader::release(message);
    }
  }
}

void Ros2Source::take(record::Bytes message) {
  arrival_ = bench_now();
  if (epoch_read_ == MonotonicTime{} || monotonic_now() - epoch_read_ > kEpochAge) {
    const EpochPair epoch = read_epoch();
    to_utc_ = epoch.utc - RealtimeTime(epoch.bench.ns());
    epoch_read_ = monotonic_now();
    decoder_.emplace(topic_, to_utc_);
  }
  if (auto s = take_apart(message); !s) {
    health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    complain(fmt::format("a message on {} cannot be a sample: {}", topic_, s.error().message));
    return;
  }
  // What came before the run is not of it.
  if (!origin().covers(stamp_.t_capture, config().period)) return;
  if (const std::uint64_t lost = reader_->lost(); lost > lost_) {
    count_lost(lost - lost_);
    sequence_.fetch_add(lost - lost_, std::memory_order_relaxed);
    lost_ = lost;
  }
  stamp_.sequence = sequence_.fetch_add(1, std::memory_order_relaxed);
  SampleSlot slot = take_slot();
  if (slot)
    if (auto s = make_sample(message, slot); !s) {
      health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      complain(fmt::format("a message on {} cannot be a sample: {}", topic_, s.error().message));
      return;
    }
  hand_over(std::move(slot));
}

void Ros2Source::stamp_by(std::int64_t header_utc_ns) {
  stamp_ = {};
  stamp_.t_arrival = arrival_;
  stamp_.t_capture = arrival_ - config().latency;
  const BenchTime header(header_utc_ns - to_utc_.ns());
  const Duration age = arrival_ - header;
  if (by_arrival_) {
  } else if (age < kMostAge && age > Duration(0) - kMostAge) {
    stamp_.t_capture = header;
  } else {
    stamp_.validity |= kClockUnsure;
  }
  stamp_.t_release = stamp_.t_capture + config().latency;
}

/// Reads the message as far as its stamp needs.
Status Ros2Source::take_apart(record::Bytes message) {
  if (values_) {
    if (auto s = values_->read(message, numbers_); !s) return s;
    std::int64_t utc_ns = std::numeric_limits<std::int32_t>::min();
    if (values_have_stamp_) {
      const std::size_t n = numbers_.size();
      utc_ns =
          static_cast<std::int64_t>(numbers_[n - 2]) * kSecond + static_cast<std::int64_t>(numbers_[n - 1]);
    }
    stamp_by(utc_ns);
    // A type without a header has nothing to be believed.
    if (!values_have_stamp_) stamp_.validity &= ~static_cast<std::uint32_t>(kClockUnsure);
    return {};
  }
  if (type_.name == msg::LaserScan::kType) return read_scan(message);
  record::MessageView view;
  view.channel = &channel_;
  view.schema = &schema_;
  view.sequence = count_++;
  view.log_time_ns = static_cast<std::uint64_t>(std::max<std::int64_t>(0, arrival_.ns() + to_utc_.ns()));
  view.data = message;
  const auto whole = decoder_->take(view);
  if (!whole) return tl::unexpected<Error>(whole.error());
  stamp_by(decoder_->stamp().t_capture.ns() + to_utc_.ns());
  return {};
}

Status Ros2Source::read_scan(record::Bytes message) {
  msg::LaserScan scan;
  if (auto s = record::CdrReader::read(message, scan); !s) return s;
  points_.clear();
  for (std::size_t i = 0; i < scan.ranges.size(); ++i) {
    const float range = scan.ranges[i];
    if (!std::isfinite(range) || range < scan.range_min || range > scan.range_max) continue;
    const double angle = double{scan.angle_min} + static_cast<double>(i) * double{scan.angle_increment};
    LidarPoint p{};
    p.x_m = static_cast<float>(range * std::cos(angle));
    p.y_m = static_cast<float>(range * std::sin(angle));
    p.remission = i < scan.intensities.size() ? scan.intensities[i] : 0;
    p.t_offset_ns =
        static_cast<std::int32_t>(std::lround(static_cast<double>(i) * double{scan.time_increment} * 1e9));
    points_.push_back(p);
  }
  stamp_by(std::int64_t{scan.header.stamp.sec} * kSecond + scan.header.stamp.nanosec);
  return {};
}

Status Ros2Source::check(const Sample& sample) const {
  if (sample.kind() != config().kind)
    return fail(ErrorCode::protocol, "", "it is of another kind than the channel");
  std::uint32_t width = description_.width_px, height = description_.height_px;
  PixelFormat format = description_.format;
  if (const auto* image = sample.as<ImageInfo>())
    width = image->width_px, height = image->height_px, format = image->format;
  if (const auto* range = sample.as<RangeImageInfo>()) width = range->width_px, height = range->height_px;
  if (width == description_.width_px && height == description_.height_px && format == description_.format)
    return {};
  return fail(ErrorCode::protocol, "",
              fmt::format("expected {}x{} {}, got {}x{} {}", description_.width_px, description_.height_px,
                          pfnc_name(description_.format), width, height, pfnc_name(format)));
}

Status Ros2Source::make_sample(record::Bytes, SampleSlot& slot) {
  Sample& sample = *slot;
  if (values_) {
    RegisterBlock block;
    block.count = static_cast<std::uint32_t>(description_.names.size());
    std::copy_n(numbers_.begin(), block.count, block.value.begin());
    sample.info = block;
    sample.size_bytes = 0;
  } else if (type_.name == msg::LaserScan::kType) {
    const std::size_t bytes = points_.size() * sizeof(LidarPoint);
    if (bytes > sample.memory().size())
      return fail(ErrorCode::protocol, "",
                  fmt::format("it has {} points, more than `max_points`", points_.size()));
    if (bytes > 0) std::memcpy(sample.memory().data(), points_.data(), bytes);
    sample.info = PointCloudInfo{static_cast<std::uint32_t>(points_.size())};
    sample.size_bytes = bytes;
  } else {
    if (auto s = decoder_->fill(sample); !s) return s;
    if (auto s = check(sample); !s) return s;
  }
  sample.stamp = stamp_;
  return {};
}

}  // namespace rigor::ros2

namespace rigor {

Backend ros2_backend() {
  Backend b;
  b.name = "ros2";
  b.summary = "topics of ROS 2 over DDS";
  b.make_source = [] { return std::make_unique<ros2::Ros2Source>(); };
  b.gives_typed_samples = true;
  return b;
}

}  // namespace rigor
