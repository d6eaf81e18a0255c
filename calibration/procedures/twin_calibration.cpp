#include "calibration/procedures/twin_calibration.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "bench/files/picture.h"
#include "calibration/pair/twin_difference.h"
#include "calibration/procedures/input_files.h"
#include "calibration/procedures/recording_input.h"

namespace rigor {
namespace {

using namespace calibration;

struct Elements {
  std::int64_t t_ns;
  std::vector<TwinElement> value;
};

Result<std::vector<TwinElement>> elements_of(const Sample& sample) {
  std::vector<TwinElement> out;
  const auto bytes = sample.bytes();
  if (const auto* image = sample.as<ImageInfo>()) {
    const auto values = pixel_values(*image, bytes);
    if (!values) return tl::unexpected<Error>(values.error());
    for (std::size_t i = 0; i < values->size(); ++i) out.push_back({i, (*values)[i]});
  } else if (const auto* range = sample.as<RangeImageInfo>()) {
    const std::size_t n = std::size_t{range->width_px} * range->height_px;
    for (std::size_t i = 0; i < n && 4 * i + 4 <= bytes.size(); ++i) {
      float r = 0;
      std::memcpy(&r, bytes.data() + 4 * i, 4);
      out.push_back({i, double{r}});
    }
  } else {
    // A firing: which beam, and when in the scan, to a microsecond.
    std::map<std::uint64_t, double> of;
    for (std::size_t i = 0; i + sizeof(LidarPoint) <= bytes.size(); i += sizeof(LidarPoint)) {
      LidarPoint p;
      std::memcpy(&p, bytes.data() + i, sizeof p);
      const auto us =
          static_cast<std::uint64_t>(static_cast<std::int64_t>(p.t_offset_ns) / 1000 + (1LL << 31));
      of[us << 24 | std::uint64_t{p.ring} << 8 | p.return_index] =
          std::sqrt(double{p.x_m} * p.x_m + double{p.y_m} * p.y_m + double{p.z_m} * p.z_m);
    }
    for (const auto& [key, value] : of) out.push_back({key, value});
  }
  return out;
}

}  // namespace

Result<CalibrationResult> calibrate_twin(const TwinCalibrationOptions& o, const StopToken& stop) {
  if (o.channel.empty() == (o.real.empty() || o.simulated.empty()))
    return fail(ErrorCode::bad_input, "--channel",
                "expected the channel of a pair (--channel left), or --real A --simulated B");
  const std::string real = o.channel.empty() ? o.real : o.channel + "/real";
  const std::string simulated = o.channel.empty() ? o.simulated : o.channel + "/simulated";
  const auto files = input_files(o.inputs, {".mcap"});
  if (!files) return tl::unexpected<Error>(files.error());

  constexpr std::array kKinds{SampleKind::image, SampleKind::range_image, SampleKind::point_cloud};
  const auto first_kind = kind_of_channel(files->front(), real, kKinds);
  if (!first_kind) return tl::unexpected<Error>(first_kind.error());
  const SampleKind kind = *first_kind;
  const std::string unit = kind == SampleKind::image ? "DN" : "m";
  // Grey values are whole numbers; ranges are finer than their noise.
  TwinComparer comparer(kind == SampleKind::image ? 1 : 0);
  std::vector<std::string> warnings;
  std::uint64_t without = 0;
  for (const auto& file : *files) {
    if (stop.stop_requested()) break;
    std::uint64_t compared = 0;
    std::map<std::int64_t, std::vector<TwinElement>> reals;
    Status bad;
    std::optional<ProgressTask> progress(std::in_place, "read " + real, 0, "samples");
    const auto found = read_samples(file, real, kind, [&](const Sample& s) {
      auto e = elements_of(s);
      if (!e) {
        bad = tl::unexpected<Error>(e.error());
        return false;
      }
      reals.emplace(s.stamp.t_capture.ns(), std::move(*e));
      progress->set(static_cast<double>(reals.size()));
      return !stop.stop_requested();
    });
    if (!bad) return tl::unexpected<Error>(bad.error());
    if (!found) return tl::unexpected<Error>(found.error());
    warnings.insert(warnings.end(), found->warnings.begin(), found->warnings.end());
    // Ctrl-C while the real side was read: what was read is still compared.
    const bool was_stopped = stop.stop_requested();
    progress.emplace("compare", static_cast<double>(reals.size()), "samples");
    const auto read = read_samples(file, simulated, kind, [&](const Sample& s) {
      const std::int64_t t = s.stamp.t_capture.ns();
      auto next = reals.lower_bound(t);
      if (next == reals.end() || (next != reals.begin() && t - std::prev(next)->first < next->first - t))
        next = next == reals.begin() ? next : std::prev(next);
      if (next == reals.end() || static_cast<double>(std::abs(next->first - t)) > o.tolerance_ms * 1e6) {
        ++without;
        return was_stopped || !stop.stop_requested();
      }
      const auto e = elements_of(s);
      if (!e) {
        bad = tl::unexpected<Error>(e.error());
        return false;
      }
      comparer.add(next->second, *e);
      progress->set(static_cast<double>(++compared));
      return was_stopped || !stop.stop_requested();
    });
    if (!bad) return tl::unexpected<Error>(bad.error());
    if (!read) return tl::unexpected<Error>(read.error());
  }
  const TwinDifference t = comparer.result();
  if (t.samples == 0)
    return fail(ErrorCode::bad_input, files->front().string(),
                fmt::format("expected samples of {} and {} within {} ms of each other, found none of {}",
                            real, simulated, o.tolerance_ms, without));
  if (without > 0)
    warnings.push_back(fmt::format("{} simulated samples have no real one of their instant", without));

  CalibrationResult result;
  result.title = "A channel and its twin";
  result.inputs = *files;
  FitResult& f = result.fit;
  f.model = "difference, simulated less real";
  f.warnings = warnings;
  f.interrupted = stop.stop_requested();
  const std::string suffix = unit == "DN" ? "_dn" : "_m";
  const std::array<std::pair<std::string, double>, 4> numbers{
      {{"bias" + suffix, t.bias},
       {"real_noise" + suffix, t.real_noise},
       {"simulated_noise" + suffix, t.simulated_noise},
       {"noise_ratio", t.real_noise > 0 ? t.simulated_noise / t.real_noise : NAN}}};
  f.covariance = t.covariance;
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    const double sigma = std::sqrt(t.covariance(k, k));
    if (std::isfinite(numbers[i].second))
      f.parameters.push_back({.name = numbers[i].first, .value = numbers[i].second, .sigma = sigma});
    else
      f.not_identifiable.emplace_back(numbers[i].first,
                                      "noise is told from sample to sample; record two of a scene at rest");
  }
  if (f.parameters.size() < numbers.size())
    f.covariance = Eigen::MatrixXd(t.covariance.topLeftCorner(
        static_cast<Eigen::Index>(f.parameters.size()), static_cast<Eigen::Index>(f.parameters.size())));
  if (t.samples < 9)
    f.warnings.push_back(fmt::format(
        "{} samples are too few to say how far to trust these numbers: expected 9 and more", t.samples));
  f.residuals.unit = unit;
  f.residuals.count = t.elements;
  f.residuals.rms = t.rms;
  std::vector<double> sizes = t.differences;
  const auto statistics = statistics_of(sizes, unit);
  f.residuals.median_absolute = statistics.median_absolute;
  f.residuals.p95_absolute = statistics.p95_absolute;
  f.residuals.largest = statistics.largest;
  const auto number = [](double x) { return std::isfinite(x) ? nlohmann::json(x) : nlohmann::json(nullptr); };
  result.details.json() = {{"samples", t.samples},
                           {"only_real", t.only_real},
                           {"only_simulated", t.only_simulated},
                           {"bias", number(t.bias)},
                           {"quantile_05", number(t.q05)},
                           {"quantile_25", number(t.q25)},
                           {"median", number(t.median)},
                           {"quantile_75", number(t.q75)},
                           {"quantile_95", number(t.q95)},
                           {"real_noise", number(t.real_noise)},
                           {"simulated_noise", number(t.simulated_noise)},
                           {"noise_distance", number(t.noise_distance)}};
  result.recipe.kind = "twin";
  Figure difference{.kind = Figure::Kind::histogram,
                    .title = "Simulated less real",
                    .caption = "Of pixels or beams that both measured.",
                    .x_label = unit,
                    .y_label = "number"};
  difference.series = {Series{"", {}, t.differences, false}};
  result.figures.push_back(difference);
  if (!t.real_noise_sorted.empty() && !t.simulated_noise_sorted.empty()) {
    Figure noise{
        .kind = Figure::Kind::series,
        .title = "Noise from sample to sample, quantile against quantile",
        .caption = "On the diagonal the twin is as noisy as the device, in every part of the distribution.",
        .x_label = "real [" + unit + "]",
        .y_label = "simulated [" + unit + "]"};
    Series points, diagonal{"alike", {}, {}, true};
    const std::size_t n = 512;
    for (std::size_t i = 0; i < n; ++i) {
      points.x.push_back(t.real_noise_sorted[i * (t.real_noise_sorted.size() - 1) / (n - 1)]);
      points.y.push_back(t.simulated_noise_sorted[i * (t.simulated_noise_sorted.size() - 1) / (n - 1)]);
    }
    diagonal.x = diagonal.y = {points.x.front(), points.x.back()};
    noise.series = {points, diagonal};
    result.figures.push_back(noise);
  }
  result.base = o.base;
  return result;
}

}  // namespace rigor
