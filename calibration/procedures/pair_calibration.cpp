#include "calibration/procedures/pair_calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "calibration/procedures/pair_changes.h"
#include "calibration/procedures/pair_input.h"
#include "calibration/procedures/pair_sensor_model.h"
#include "sensor-hal/channel/pair_values.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"

namespace rigor {
namespace {

using namespace calibration;

constexpr std::uint64_t kLeastPairs = 8;

/// What all kinds hand on.
struct Solved {
  PairProposal proposal;
  std::uint64_t pairs = 0, unlike = 0;
  int passes = 0;
  bool converged = true;
  std::vector<std::pair<std::string, double>> one_step{};
  std::vector<Figure> figures{};
  double rms_before = 0, mean_before = 0, mean_after = 0;
};

Figure residual_figure(const ResidualSample& before, const ResidualSample& after, const std::string& unit) {
  Figure f{.kind = Figure::Kind::series,
           .title = "Residuals before and after",
           .caption =
               "Real less simulated, sorted. Before: of the recorded simulation; after: of the simulation "
               "carried over "
               "to the proposal. What stays is noise of both, and what the model cannot express.",
           .x_label = "share of the numbers",
           .y_label = unit};
  for (const auto& [name, sample] : {std::pair{"before", &before}, {"after", &after}}) {
    std::vector<double> sorted = sample->values();
    std::sort(sorted.begin(), sorted.end());
    Series s{name, {}, {}, true};
    constexpr std::size_t kPoints = 201;
    for (std::size_t i = 0; i < kPoints && !sorted.empty(); ++i) {
      // The farthest hundredth of each side would leave nothing of the rest to be seen.
      const double share = 0.01 + 0.98 * double(i) / (kPoints - 1);
      s.x.push_back(share);
      s.y.push_back(sorted[std::size_t(share * double(sorted.size() - 1))]);
    }
    f.series.push_back(std::move(s));
  }
  return f;
}

Figure noise_figure(const std::vector<NoiseLevel>& levels, const std::string& level, const std::string& unit,
                    bool level_is_variance) {
  Figure f{.kind = Figure::Kind::series,
           .title = "Noise of both sides",
           .caption = "Standard deviations, by what neighbouring elements differ by.",
           .x_label = level,
           .y_label = unit};
  Series real{"real", {}, {}, false}, simulated{"simulated", {}, {}, true};
  for (const NoiseLevel& l : levels) {
    const double x = level_is_variance ? std::sqrt(l.level) : l.level;
    real.x.push_back(x), real.y.push_back(std::sqrt(std::max(0.0, l.real)));
    simulated.x.push_back(x), simulated.y.push_back(std::sqrt(std::max(0.0, l.simulated)));
  }
  f.series = {real, simulated};
  return f;
}

template <class Fit>
void take_over(Solved& solved, const Fit& fit) {
  solved.pairs = fit.pairs, solved.unlike = fit.unlike, solved.passes = fit.passes;
  solved.converged = fit.converged;
  for (std::size_t i = 0; i < fit.one_step.size() && i < fit.change.parameters.size(); ++i)
    solved.one_step.emplace_back(fit.change.parameters[i].name, fit.one_step[i]);
  solved.rms_before = fit.before.rms(), solved.mean_before = fit.before.mean();
  solved.mean_after = fit.after.mean();
  solved.figures.push_back(residual_figure(fit.before, fit.after, fit.change.residuals.unit));
}

Status enough(const RecordedPair& pair, std::uint64_t pairs, std::uint64_t unlike, std::uint64_t alone) {
  if (pairs >= kLeastPairs) return {};
  return fail(
      ErrorCode::bad_input, pair.recording.string(),
      fmt::format("expected {} samples of {} that both sides have and more, found {}{}{}", kLeastPairs,
                  pair.channel, pairs,
                  unlike > 0 ? fmt::format(" ({} cannot be compared: formats or sizes differ)", unlike) : "",
                  alone > 0 ? fmt::format("; {} have no partner of their instant", alone) : ""));
}

Status need_sensor_model_file(const RecordedPair& pair) {
  if (!pair.sensor_model_file.empty()) return {};
  return fail(
      ErrorCode::bad_input, pair.rig_file,
      "expected `sensor` (the sensor model) of the simulated side of " + pair.channel + ", found none");
}

template <class Options>
Options common_of(const StopToken& stop, ProgressTask& task) {
  Options options;
  options.stop = stop;
  options.progress = [&task](int pass) { task.note(fmt::format("pass {} over the recording", pass)); };
  return options;
}

Result<Solved> solve_camera(const RecordedPair& pair, const PairCalibrationOptions& o,
                            const ForEachPair& pairs, const std::uint64_t& alone, const StopToken& stop,
                            ProgressTask& task) {
  const auto sensor_model = load_camera(pair.sensor_model_file);
  if (!sensor_model) return tl::unexpected<Error>(sensor_model.error());
  auto options = common_of<ImagePairOptions>(stop, task);
  options.principal_point = o.model == "principal-point" || o.model == "lens";
  options.mount = o.model != "principal-point";
  options.distortion = o.model == "lens";
  const auto fit = fit_image_pair(pairs, sensor_model->model, options);
  if (!fit) return tl::unexpected<Error>(fit.error());
  if (auto s = enough(pair, fit->pairs, fit->unlike, alone); !s) return tl::unexpected<Error>(s.error());
  auto proposal = propose_camera(pair, *fit, sensor_model->model);
  if (!proposal) return tl::unexpected<Error>(proposal.error());
  Solved solved{.proposal = std::move(*proposal)};
  take_over(solved, *fit);
  solved.figures.push_back(noise_figure(fit->noise, "light above black [DN]", "DN", false));
  return solved;
}

Result<Solved> solve_lidar(const RecordedPair& pair, const PairCalibrationOptions& o,
                           const ForEachPair& pairs, const std::uint64_t& alone, const StopToken& stop,
                           ProgressTask& task) {
  const auto model = load_lidar_model(pair.sensor_model_file);
  if (!model) return tl::unexpected<Error>(model.error());
  auto options = common_of<CloudPairOptions>(stop, task);
  options.mount = o.model != "ranges";
  options.rings = std::uint32_t(model->scan.beams.size());
  options.points = std::clamp<std::size_t>(model->firings(), 64, 400000);
  options.remission_max = model->remission.maximum;
  options.model_sigma_m = [&](double remission, double range_m) {
    return model_sigma_m(*model, remission, range_m);
  };
  options.sigma_m =
      std::max(1e-3, model_sigma_m(*model, 0.5 * model->remission.scale, 0.3 * model->range.max_m));
  const auto fit = fit_cloud_pair(pairs, options);
  if (!fit) return tl::unexpected<Error>(fit.error());
  if (auto s = enough(pair, fit->pairs, fit->unlike, alone); !s) return tl::unexpected<Error>(s.error());
  auto proposal = propose_lidar(pair, *fit);
  if (!proposal) return tl::unexpected<Error>(proposal.error());
  Solved solved{.proposal = std::move(*proposal)};
  take_over(solved, *fit);
  solved.figures.push_back(noise_figure(fit->noise, "standard deviation of the sensor model [m]", "m", true));
  return solved;
}

Result<Solved> solve_tof(const RecordedPair& pair, const PairCalibrationOptions&, const ForEachPair& pairs,
                         const std::uint64_t& alone, const StopToken& stop, ProgressTask& task) {
  const auto fit = fit_range_pair(pairs, common_of<RangePairOptions>(stop, task));
  if (!fit) return tl::unexpected<Error>(fit.error());
  if (auto s = enough(pair, fit->pairs, fit->unlike, alone); !s) return tl::unexpected<Error>(s.error());
  auto proposal = propose_tof(pair, *fit);
  if (!proposal) return tl::unexpected<Error>(proposal.error());
  Solved solved{.proposal = std::move(*proposal)};
  take_over(solved, *fit);
  solved.figures.push_back(noise_figure(fit->noise, "amplitude [e]", "m", false));
  return solved;
}

Result<Solved> solve_values(const RecordedPair& pair, const ForEachPair& pairs, const std::uint64_t& alone) {
  std::vector<ValueSeries> series;
  std::uint64_t count = 0, unlike = 0;
  const auto take = [&](double t_s, std::span<const double> real, std::span<const double> simulated) {
    if (real.size() != simulated.size() || (!series.empty() && series.size() != real.size())) {
      ++unlike;
      return;
    }
    if (series.empty()) series.resize(real.size());
    if (!series.front().t_s.empty() && t_s <= series.front().t_s.back()) return;
    ++count;
    for (std::size_t k = 0; k < real.size(); ++k) {
      series[k].t_s.push_back(t_s);
      series[k].real.push_back(real[k]), series[k].simulated.push_back(simulated[k]);
    }
  };
  const auto read = pairs([&](const Sample& a, const Sample& b) {
    const double t_s = double(a.stamp.t_capture.ns()) * 1e-9;
    if (const auto* x = a.as<RegisterBlock>(), *y = b.as<RegisterBlock>(); x && y) {
      take(t_s, {x->value.data(), x->count}, {y->value.data(), y->count});
    } else if (const auto* p = a.as<ImuSample>(), *q = b.as<ImuSample>(); p && q) {
      std::array<double, 6> u{}, v{};
      std::copy(p->specific_force_mps2.begin(), p->specific_force_mps2.end(), u.begin());
      std::copy(p->angular_rate_radps.begin(), p->angular_rate_radps.end(), u.begin() + 3);
      std::copy(q->specific_force_mps2.begin(), q->specific_force_mps2.end(), v.begin());
      std::copy(q->angular_rate_radps.begin(), q->angular_rate_radps.end(), v.begin() + 3);
      take(t_s, u, v);
    } else {
      ++unlike;
    }
  });
  if (!read) return tl::unexpected<Error>(read.error());
  if (auto s = enough(pair, count, unlike, alone); !s) return tl::unexpected<Error>(s.error());
  static constexpr std::array<const char*, 6> kImu{"force_x", "force_y", "force_z",
                                                   "rate_x",  "rate_y",  "rate_z"};
  std::vector<ValueFit> fits;
  for (std::size_t k = 0; k < series.size(); ++k) {
    const bool imu = pair.kind == SampleKind::imu;
    series[k].name = imu && k < kImu.size() ? kImu[k] : fmt::format("number {}", k);
    series[k].unit = imu ? (k < 3 ? "m/s²" : "rad/s") : "";
    auto fit = fit_value_pair(series[k]);
    if (!fit) {
      Error e = fit.error();
      e.where = pair.recording.string() + ": " + e.where;
      return tl::unexpected<Error>(e);
    }
    fits.push_back(std::move(*fit));
  }
  auto proposal = propose_values(pair, fits);
  if (!proposal) return tl::unexpected<Error>(proposal.error());
  Solved solved{.proposal = std::move(*proposal), .pairs = count, .unlike = unlike};
  for (const ValueFit& f : fits) {
    solved.passes = std::max(solved.passes, f.passes);
    solved.figures.push_back(residual_figure(f.before, f.after, f.unit));
    solved.figures.back().title = f.name + ": residuals before and after";
  }
  return solved;
}

}  // namespace

Result<CalibrationResult> calibrate_pair(const PairCalibrationOptions& o, const StopToken& stop) {
  std::filesystem::path rig;
  std::vector<std::filesystem::path> recordings;
  for (const auto& input : o.inputs)
    if (input.extension() == ".yaml" || input.extension() == ".yml")
      rig = input;
    else
      recordings.push_back(input);
  if (recordings.size() != 1)
    return fail(
        ErrorCode::bad_input, "INPUT",
        fmt::format("expected one recording (.mcap) of a pair, and its rig (.yaml) if it is another one "
                    "than the recording holds, got {} recordings",
                    recordings.size()));
  const auto pair = find_recorded_pair(recordings.front(), rig, o.channel);
  if (!pair) return tl::unexpected<Error>(pair.error());
  const std::vector<std::string> models =
      pair->kind == SampleKind::image         ? std::vector<std::string>{"auto", "principal-point", "lens"}
      : pair->kind == SampleKind::point_cloud ? std::vector<std::string>{"auto", "ranges"}
                                              : std::vector<std::string>{"auto"};
  if (std::find(models.begin(), models.end(), o.model) == models.end())
    return fail(
        ErrorCode::bad_input, "--model",
        fmt::format("expected one of {} for this kind of channel, got {}", fmt::join(models, ", "), o.model));
  const bool has_model = pair->kind != SampleKind::register_block;
  if (has_model)
    if (auto s = need_sensor_model_file(*pair); !s) return tl::unexpected<Error>(s.error());
  RecordedPair recorded = *pair;
  if (!(o.from_s < o.until_s))
    return fail(ErrorCode::bad_input, "--from, --until",
                fmt::format("expected --from before --until, got {:g} and {:g}", o.from_s, o.until_s));
  recorded.from_s = o.from_s, recorded.until_s = o.until_s;
  if (!o.base.empty())
    recorded.sensor_model_file =
        o.base;  // the sensor model that the simulated side had, where the rig's has changed since

  std::optional<ProgressTask> searching(std::in_place, "look for changes of the device");
  std::uint64_t alone = 0;
  const ForEachPair pairs = [&](const TakePair& take) { return read_pairs(recorded, take, alone); };
  const auto search = find_change(recorded, pairs, stop);
  searching.reset();
  if (!search) return tl::unexpected<Error>(search.error());
  if (search->change && !std::isfinite(o.from_s) && !std::isfinite(o.until_s)) {
    const RecordedChange& c = *search->change;
    return fail(ErrorCode::bad_input, recorded.recording.string(),
                fmt::format("expected a device that stays as it is, found a change: {}; a model of all of it "
                            "would be that of neither device. Give --until {:.2f} for the device before, "
                            "--from {:.2f} for the device after",
                            c.text(), std::max(0.0, c.at_s - c.window_s), c.at_s + c.window_s));
  }
  std::optional<ProgressTask> fitting(std::in_place, "fit");
  ProgressTask& task = *fitting;
  auto solved = [&]() -> Result<Solved> {
    switch (recorded.kind) {
      case SampleKind::image:
        return solve_camera(recorded, o, pairs, alone, stop, task);
      case SampleKind::point_cloud:
        return solve_lidar(recorded, o, pairs, alone, stop, task);
      case SampleKind::range_image:
        return solve_tof(recorded, o, pairs, alone, stop, task);
      default:
        return solve_values(recorded, pairs, alone);
    }
  }();
  fitting.reset();
  if (!solved) return tl::unexpected<Error>(solved.error());

  CalibrationResult result;
  result.title = "Model of a pair";
  nlohmann::json& details = result.details.json();
  result.inputs = {recorded.recording};
  result.fit = solved->proposal.result();
  if (search->change)
    result.fit.warnings.push_back(
        fmt::format("within --from and --until the device changes: {}; the model averages across it",
                    search->change->text()));
  if (!search->enough)
    result.notes.emplace_back("too few pairs to look for changes of the device while it was recorded");
  if (alone > 0)
    result.fit.warnings.push_back(fmt::format("{} samples have no partner of their instant", alone));
  if (solved->unlike > 0)
    result.fit.warnings.push_back(fmt::format("{} pairs could not be compared", solved->unlike));
  if (!solved->converged && !result.fit.interrupted)
    result.fit.warnings.push_back(fmt::format(
        "after {} passes the steps are not small against their uncertainty: the change is large, or "
        "the simulated world is not what the device sees",
        solved->passes));
  result.recipe = solved->proposal.recipe();
  result.recipe.kind = recorded.kind == SampleKind::image         ? "camera"
                       : recorded.kind == SampleKind::point_cloud ? "lidar"
                       : recorded.kind == SampleKind::range_image ? "tof"
                       : recorded.kind == SampleKind::imu         ? "imu"
                                                                  : "registers";
  result.figures = std::move(solved->figures);
  for (const std::string& note : solved->proposal.notes()) result.notes.push_back(note);
  details = std::move(solved->proposal.more);
  details["channel"] = recorded.channel;
  details["pairs"] = solved->pairs;
  details["passes"] = solved->passes;
  for (const auto& [name, value] : solved->one_step) details["one_step"][name] = value;
  if (solved->rms_before > 0) {
    details["rms_before"] = solved->rms_before;
    details["mean_before"] = solved->mean_before;
    details["mean_after"] = solved->mean_after;
  }
  result.base = has_model ? recorded.sensor_model_file : o.base;
  return result;
}

}  // namespace rigor
