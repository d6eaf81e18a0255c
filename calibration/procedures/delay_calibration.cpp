#include "calibration/procedures/delay_calibration.h"

#include <fmt/format.h>
#include <Eigen/Dense>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <optional>

#include "bench/console/progress.h"
#include "bench/files/picture.h"
#include "calibration/pair/board_pose.h"
#include "calibration/pair/time_offset.h"
#include "calibration/procedures/input_files.h"
#include "calibration/procedures/recorded_stamps.h"
#include "calibration/procedures/recording_input.h"
#include "sensor-hal/models/camera_yaml.h"

namespace rigor {
namespace {

using namespace calibration;

/// Several numbers a sample; one series is made of them by the direction in which they vary most.
struct Track {
  std::vector<std::int64_t> t_ns;
  std::vector<Eigen::VectorXd> value;
  std::string what;
};

TimeSeries strongest(const Track& track) {
  TimeSeries s;
  s.t_ns = track.t_ns;
  const auto n = static_cast<double>(track.value.size());
  Eigen::VectorXd mean = Eigen::VectorXd::Zero(track.value.front().size());
  for (const auto& v : track.value) mean += v / n;
  Eigen::MatrixXd scatter = Eigen::MatrixXd::Zero(mean.size(), mean.size());
  for (const auto& v : track.value) scatter += (v - mean) * (v - mean).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scatter);
  Eigen::VectorXd along = eigen.eigenvectors().col(mean.size() - 1);
  // The sign is nobody's: the largest part counts up.
  Eigen::Index largest = 0;
  along.cwiseAbs().maxCoeff(&largest);
  if (along[largest] < 0) along = -along;
  for (const auto& v : track.value) s.value.push_back(along.dot(v - mean));
  return s;
}

/// Mean range of each of eight sectors: what moves before the scanner moves some of them.
Eigen::VectorXd sector_ranges(const Sample& s) {
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(8), n = Eigen::VectorXd::Constant(8, 1e-9);
  const auto bytes = s.bytes();
  for (std::size_t i = 0; i + sizeof(LidarPoint) <= bytes.size(); i += sizeof(LidarPoint)) {
    LidarPoint p;
    std::memcpy(&p, bytes.data() + i, sizeof p);
    const auto k = static_cast<Eigen::Index>(std::floor((std::atan2(p.y_m, p.x_m) + M_PI) / M_PI_4)) % 8;
    sum[k] += std::sqrt(p.x_m * p.x_m + p.y_m * p.y_m + p.z_m * p.z_m), n[k] += 1;
  }
  return sum.cwiseQuotient(n);
}

Eigen::VectorXd mean_range(const Sample& s) {
  const auto* info = s.as<RangeImageInfo>();
  double sum = 0, n = 1e-9;
  for (std::size_t i = 0; i < std::size_t{info->width_px} * info->height_px; ++i) {
    float r = 0;
    std::memcpy(&r, s.bytes().data() + 4 * i, 4);
    if (std::isfinite(r)) sum += double{r}, n += 1;
  }
  return Eigen::VectorXd::Constant(1, sum / n);
}

/// What a series was made of.
struct SeriesFacts {
  std::string what;
  std::size_t samples = 0, unsure = 0;  ///< unsure: stamped by the arrival, less the rig's latency_ms
  std::int64_t latency_ns = 0;          ///< of the rig: capture to release; of a sink: command to effect
  bool sink = false;
  std::vector<std::int64_t> effect_ns{};  ///< of a sink's commands
  std::int64_t hold_ns = 0;               ///< median, from one to the next
};

/// Commands as the device gets them: each value is held until the next one. A spline cannot follow edges; it
/// goes through the middle of each hold, and of pieces of holds that are long, so that an edge becomes a
/// slope whose middle is the edge.
Result<TimeSeries> held_commands(const std::filesystem::path& file, const std::string& sink,
                                 const std::string& value, const StopToken& stop, SeriesFacts& facts) {
  const auto commands = read_commands(file, sink, value, stop);
  if (!commands) return tl::unexpected<Error>(commands.error());
  facts = {.what = "commanded " + value,
           .samples = commands->size(),
           .latency_ns = commands->front().effect_ns - commands->front().issue_ns,
           .sink = true};
  std::vector<std::int64_t> holds;
  for (std::size_t i = 1; i < commands->size(); ++i)
    holds.push_back((*commands)[i].effect_ns - (*commands)[i - 1].effect_ns);
  if (holds.empty()) return TimeSeries{};  // one command: the fit says how many it needs
  const auto middle = holds.begin() + static_cast<std::ptrdiff_t>(holds.size() / 2);
  std::nth_element(holds.begin(), middle, holds.end());
  facts.hold_ns = *middle;
  for (const RecordedCommand& c : *commands) facts.effect_ns.push_back(c.effect_ns);
  const std::int64_t longest_ns = std::clamp<std::int64_t>(facts.hold_ns, 1000, 20'000'000);
  TimeSeries series;
  for (std::size_t i = 0; i + 1 < commands->size(); ++i) {
    const std::int64_t from = (*commands)[i].effect_ns, hold = (*commands)[i + 1].effect_ns - from;
    const std::int64_t pieces = std::max<std::int64_t>(1, (hold + longest_ns - 1) / longest_ns);
    for (std::int64_t k = 0; k < pieces && hold > 0; ++k) {
      series.t_ns.push_back(from + hold * (2 * k + 1) / (2 * pieces));
      series.value.push_back((*commands)[i].value);
    }
  }
  return series;
}

/// `channel`; of registers `channel:index`; of commands `sink:value`.
Result<TimeSeries> series_of(const DelayCalibrationOptions& o, const std::filesystem::path& file,
                             const std::string& name, const StopToken& stop, SeriesFacts& facts,
                             std::vector<std::string>& warnings) {
  const auto colon = name.rfind(':');
  const std::string channel = name.substr(0, colon),
                    after = colon == std::string::npos ? "0" : name.substr(colon + 1);
  if (!channel.empty() && !after.empty() && after.find_first_not_of("-0123456789") != std::string::npos)
    return held_commands(file, channel, after, stop, facts);
  int index = 0;
  if (std::sscanf(after.c_str(), "%d", &index) != 1)
    return fail(ErrorCode::bad_input, name,
                "expected CHANNEL, CHANNEL:INDEX of a register, counted from 0, or SINK:VALUE of commands");
  if (channel.empty())
    return fail(ErrorCode::bad_input, name.empty() ? "--first, --second" : name,
                "expected CHANNEL, CHANNEL:INDEX of a register, counted from 0, or SINK:VALUE of commands");
  Track track;
  Status bad;
  const auto add = [&](const Sample& s, Eigen::VectorXd v) {
    const std::int64_t t = s.stamp.t_capture.ns();
    if (!v.allFinite() || (!track.t_ns.empty() && t <= track.t_ns.back())) return;
    track.t_ns.push_back(t);
    track.value.push_back(std::move(v));
  };
  const auto add_pose = [&](const Sample& s) {
    const auto* p = s.as<Pose>();
    Eigen::VectorXd v(7);
    v << p->position_m[0], p->position_m[1], p->position_m[2], p->orientation_wxyz[0], p->orientation_wxyz[1],
        p->orientation_wxyz[2], p->orientation_wxyz[3];
    if (!track.value.empty() && track.value.back().tail<4>().dot(v.tail<4>()) < 0) v.tail<4>() *= -1;
    add(s, v);
  };
  constexpr std::array kKinds{SampleKind::register_block, SampleKind::pose, SampleKind::point_cloud,
                              SampleKind::range_image, SampleKind::image};
  const auto kind = kind_of_channel(file, channel, kKinds);
  if (!kind) return tl::unexpected<Error>(kind.error());
  std::optional<Board> board;
  std::optional<CameraModel> camera;
  if (*kind == SampleKind::image) {
    if (o.target.empty() || o.camera_model_file.empty())
      return fail(ErrorCode::bad_input, channel,
                  "is a camera: expected --target and --camera-model with it, whose board's pose is then "
                  "followed");
    const auto parsed = parse_board(o.target);
    if (!parsed) return tl::unexpected<Error>(parsed.error());
    const auto sensor_model = load_camera(o.camera_model_file);
    if (!sensor_model) return tl::unexpected<Error>(sensor_model.error());
    board = *parsed, camera = sensor_model->model;
  }
  Eigen::Isometry3d first = Eigen::Isometry3d::Identity(), before = first;
  ProgressTask reading("read " + channel, 0, "samples");
  std::uint64_t taken = 0;
  const auto read = read_samples(file, channel, *kind, [&](const Sample& s) {
    reading.set(static_cast<double>(++taken));
    facts.unsure += (s.stamp.validity & kClockUnsure) != 0;
    facts.latency_ns = (s.stamp.t_release - s.stamp.t_capture).ns();
    switch (*kind) {
      case SampleKind::register_block: {
        const auto* block = s.as<RegisterBlock>();
        if (index < 0 || static_cast<std::uint32_t>(index) >= block->count) {
          bad = fail(ErrorCode::bad_input, name,
                     fmt::format("expected an index below {}, got {}", block->count, index));
          return false;
        }
        add(s, Eigen::VectorXd::Constant(1, block->value[static_cast<std::size_t>(index)]));
        break;
      }
      case SampleKind::pose:
        add_pose(s);
        break;
      case SampleKind::point_cloud:
        add(s, sector_ranges(s));
        break;
      case SampleKind::range_image:
        add(s, mean_range(s));
        break;
      default: {
        const auto* info = s.as<ImageInfo>();
        const auto grey = grey_picture(*info, s.bytes());
        if (!grey) {
          bad = tl::unexpected<Error>(grey.error());
          return false;
        }
        const auto view = find_board(channel, grey->data(), static_cast<int>(info->width_px),
                                     static_cast<int>(info->height_px), *board);
        if (!view) break;
        const auto pose = pose_of_board(*view, *camera);
        if (!pose) {
          bad = tl::unexpected<Error>(pose.error());
          return false;
        }
        // Half a turn in the board's plane is the same pattern to the finder: what is nearer to the picture
        // before is meant.
        Eigen::Isometry3d T = pose->T_camera_board;
        if (!track.value.empty()) {
          const Eigen::Isometry3d turned = T * Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ());
          const auto apart = [&](const Eigen::Isometry3d& x) {
            return Eigen::AngleAxisd((before.inverse() * x).linear()).angle();
          };
          if (apart(turned) < apart(T)) T = turned;
        } else {
          first = T;
        }
        before = T;
        const Eigen::AngleAxisd turn((first.inverse() * T).linear());
        add(s, turn.axis() * turn.angle());
      }
    }
    return !stop.stop_requested();
  });
  reading.finish();
  if (!bad) return tl::unexpected<Error>(bad.error());
  if (!read) return tl::unexpected<Error>(read.error());
  warnings.insert(warnings.end(), read->warnings.begin(), read->warnings.end());
  facts.samples = read->samples;
  facts.what = *kind == SampleKind::register_block ? "register " + std::to_string(index)
               : *kind == SampleKind::pose         ? "pose along its main direction"
               : *kind == SampleKind::point_cloud  ? "mean ranges of sectors along their main direction"
               : *kind == SampleKind::range_image  ? "mean range"
                                                   : "turn of the board along its main direction [rad]";
  if (track.value.size() < 8)
    return fail(ErrorCode::bad_input, file.string(),
                fmt::format("expected at least 8 values of {}, got {} of {} samples", name,
                            track.value.size(), read->samples));
  return strongest(track);
}

/// The widest part of a command's hold in which no sample of the second channel was taken, hold after hold:
/// when in it the effect came, the samples do not see.
std::int64_t unseen_ns(const SeriesFacts& commands, const TimeSeries& second) {
  constexpr std::size_t kBins = 40;
  std::array<std::size_t, kBins> count{};
  std::size_t all = 0;
  for (const std::int64_t t : second.t_ns) {
    const auto next = std::upper_bound(commands.effect_ns.begin(), commands.effect_ns.end(), t);
    if (next == commands.effect_ns.begin() || t - *(next - 1) >= commands.hold_ns) continue;
    ++count[static_cast<std::size_t>((t - *(next - 1)) * static_cast<std::int64_t>(kBins) /
                                     commands.hold_ns)];
    ++all;
  }
  std::size_t widest = 0, run = 0;
  for (std::size_t i = 0; i < 2 * kBins; ++i) {  // twice round: a hold begins where one ends
    run = count[i % kBins] * kBins * 10 < all ? run + 1 : 0;
    widest = std::max(widest, std::min(run, kBins));
  }
  return commands.hold_ns * static_cast<std::int64_t>(widest) / static_cast<std::int64_t>(kBins);
}

/// What the delay means for the rig's latency_ms.
void add_latency(const DelayCalibrationOptions& o, const SeriesFacts& first, const SeriesFacts& second,
                 const TimeSeries& second_series, const Parameter& delay, CalibrationResult& result) {
  const auto ms = [](std::int64_t ns) { return static_cast<double>(ns) / 1e6; };
  const double after_ms = -delay.value * 1e3;
  if (first.sink) {
    result.notes.push_back(fmt::format(
        "from command to effect {:.3f} ms: latency_ms {:g} of the sink, and {:.3f} that the device takes",
        ms(first.latency_ns) + after_ms, ms(first.latency_ns), after_ms));
    if (const double unseen_ms = ms(unseen_ns(first, second_series)); unseen_ms > 6e3 * delay.sigma)
      result.fit.warnings.push_back(fmt::format(
          "the samples of {} fall on the same instants after each command, {:.1f} ms apart, so that the "
          "delay is known "
          "to ± {:.1f} ms only: record with a rate_hz that the commands' does not divide (97 for 100)",
          o.second, unseen_ms, unseen_ms / 2));
  }
  if (second.unsure * 2 > second.samples)
    result.notes.push_back(
        fmt::format("{}: the device's clock is not known, and its stamps are the arrival less latency_ms "
                    "{:g}: latency_ms "
                    "{:.1f} corrects them",
                    o.second, ms(second.latency_ns), ms(second.latency_ns) + after_ms));
}

}  // namespace

Result<CalibrationResult> calibrate_delay(const DelayCalibrationOptions& o, const StopToken& stop) {
  const auto files = input_files(o.inputs, {".mcap"});
  if (!files) return tl::unexpected<Error>(files.error());
  if (files->size() != 1)
    return fail(ErrorCode::bad_input, "INPUT",
                "expected one recording, got " + std::to_string(files->size()));
  SeriesFacts facts_first, facts_second;
  std::vector<std::string> warnings;
  const auto first = series_of(o, files->front(), o.first, stop, facts_first, warnings);
  if (!first) return tl::unexpected<Error>(first.error());
  const auto second = series_of(o, files->front(), o.second, stop, facts_second, warnings);
  if (!second) return tl::unexpected<Error>(second.error());
  const auto fit = fit_time_offset(
      *first, *second,
      {.largest_s = o.largest_s, .same_quantity = o.same_quantity, .first_exact = facts_first.sink});
  if (!fit) return tl::unexpected<Error>(fit.error());

  CalibrationResult result;
  result.title = "Time between two channels";
  result.inputs = *files;
  result.fit = fit->result;
  result.fit.warnings.insert(result.fit.warnings.end(), warnings.begin(), warnings.end());
  result.fit.interrupted = result.fit.interrupted || stop.stop_requested();
  result.recipe.kind = "delay";
  result.recipe.set = {{"first", o.first}, {"second", o.second}};
  if (const Parameter* d = result.fit.find("delay_s"); d != nullptr && result.fit.not_identifiable.empty()) {
    result.recipe.set.emplace_back("delay_s", exact_text(d->value));
    if (std::abs(d->value) <= o.largest_s) add_latency(o, facts_first, facts_second, *second, *d, result);
  }
  result.details.json() = {
      {"first", facts_first.what}, {"second", facts_second.what}, {"first_noise_sigma", fit->first_sigma}};
  Figure over{.kind = Figure::Kind::series,
              .title = "Residual over time",
              .caption = "Second channel less the first, shifted and scaled.",
              .x_label = "time [s]",
              .y_label = "residual"};
  Series points;
  for (std::size_t i = 0; i < fit->residual.size(); ++i) {
    points.x.push_back(static_cast<double>(fit->residual_t_ns[i] - fit->residual_t_ns[0]) * 1e-9);
    points.y.push_back(fit->residual[i]);
  }
  over.series = {points};
  result.figures.push_back(over);
  result.base = o.base;
  return result;
}

}  // namespace rigor
