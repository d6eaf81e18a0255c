#include "bench/tune/tuner.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"

namespace rigor {
namespace {

/// Captures whose times are taken, after one that warms up: so many, or what two seconds hold, and three.
constexpr int kTimed = 20, kTimedAtLeast = 3;
constexpr Duration kTimedWithin = seconds(2);
constexpr int kReferenceSubRays = 61;
constexpr int kReferenceTofSamples = 16;
constexpr int kReferenceCameraSamples = 64;

/// What of a sensor is light and not noise.
std::vector<std::string> noiseless(SampleKind kind) {
  switch (kind) {
    case SampleKind::point_cloud:
      return {"footprint", "echoes", "detection", "remission_scale"};
    case SampleKind::range_image:
      return {"lens", "flying_pixels", "motion", "limits"};
    default:
      return {"lens", "chromatic", "depth_of_field", "motion_blur", "rolling_shutter"};
  }
}

struct RangeSum {
  double squares = 0;
  std::size_t near = 0, wrong = 0;
  void add(double difference_m, double limit_m) {
    if (std::abs(difference_m) > limit_m) {
      ++wrong;
      return;
    }
    squares += difference_m * difference_m;
    ++near;
  }
  [[nodiscard]] RangeError result() const {
    const std::size_t all = near + wrong;
    return {near ? std::sqrt(squares / static_cast<double>(near)) : 0.0,
            all ? static_cast<double>(wrong) / static_cast<double>(all) : 0.0};
  }
};

double range_of_point(const LidarPoint& p) { return std::hypot(double{p.x_m}, double{p.y_m}, double{p.z_m}); }

bool before(const LidarPoint& a, const LidarPoint& b) {
  if (a.t_offset_ns != b.t_offset_ns) return a.t_offset_ns < b.t_offset_ns;
  return a.ring != b.ring ? a.ring < b.ring : a.return_index < b.return_index;
}

std::vector<LidarPoint> sorted(std::span<const LidarPoint> points) {
  std::vector<LidarPoint> out(points.begin(), points.end());
  std::sort(out.begin(), out.end(), before);
  return out;
}

/// A channel's sensor of any kind, made with one choice.
class Sensor {
 public:
  static Result<Sensor> make(Simulation& simulation, const RigConfig& rig, const ChannelEntry& entry,
                             const EngineChoice& choice, bool quiet) {
    Sensor s;
    SensorOptions options;
    options.choice = choice;
    if (quiet) options.only = noiseless(entry.kind);
    const ConfigNode& params = *simulated_params(entry);
    if (entry.kind == SampleKind::image) {
      auto camera = simulation.sensed_camera(params, rig.seed, entry.name, options);
      if (!camera) return tl::unexpected<Error>(camera.error());
      s.camera_ = *camera;
      const auto g = s.camera_->geometry();
      s.pixels_.resize(image_bytes(g.format, g.width_px, g.height_px));
    } else {
      auto sampler = simulation.sampler(entry.kind, params, rig.seed, entry.name, options);
      if (!sampler) return tl::unexpected<Error>(sampler.error());
      s.sampler_ = *sampler;
      s.sample_ = std::make_unique<Sample>();
      s.sample_->reserve(s.sampler_->geometry().max_bytes);
    }
    s.motion_ = simulation.motion_at_rest();
    return s;
  }
  Status capture(std::uint64_t index, BenchTime t) {
    if (camera_) {
      ImageRequest r;
      const auto g = camera_->geometry();
      r.index = index;
      r.t_capture = t;
      r.motion = motion_;
      r.format = g.format;
      r.width_px = g.width_px;
      r.height_px = g.height_px;
      return camera_->capture(r, pixels_);
    }
    SampleProvider::Request r;
    r.index = index;
    r.t_capture = t;
    r.motion = motion_;
    return sampler_->capture(r, *sample_);
  }
  /// Numbers of the last capture: light, ranges, or points.
  [[nodiscard]] std::vector<float> light() const { return camera_->light().radiance; }
  [[nodiscard]] std::vector<float> ranges() const {
    const auto* info = sample_->as<RangeImageInfo>();
    std::vector<float> r(std::size_t{info->width_px} * info->height_px);
    std::memcpy(r.data(), sample_->bytes().data(), r.size() * sizeof(float));
    return r;
  }
  [[nodiscard]] std::vector<LidarPoint> points() const {
    std::vector<LidarPoint> p(sample_->as<PointCloudInfo>()->count);
    if (!p.empty()) std::memcpy(p.data(), sample_->bytes().data(), p.size() * sizeof(LidarPoint));
    return p;
  }

 private:
  std::shared_ptr<SensedCamera> camera_;
  std::shared_ptr<TruthfulSampler> sampler_;
  std::unique_ptr<Sample> sample_;
  std::vector<std::byte> pixels_;
  WorldMotion motion_;
};

struct Shot {
  std::vector<float> numbers;
  std::vector<LidarPoint> points;
};

class Tuner {
 public:
  Tuner(Simulation& simulation, const RigConfig& rig, const ChannelEntry& entry, const Tolerance& tolerance,
        const std::function<void(const std::string&)>& progress)
      : simulation_(simulation), rig_(rig), entry_(entry), tolerance_(tolerance), progress_(progress) {
    const int instants = entry.kind == SampleKind::image ? 2 : 3;
    const std::int64_t step = std::max<std::int64_t>(1, milliseconds(400) / entry.period);
    for (int k = 0; k < instants; ++k)
      instants_.push_back(BenchTime(0) + entry.period * (step * std::int64_t{k}));
  }

  Result<TunedChannel> run() {
    TunedChannel tuned;
    tuned.channel = entry_.name;
    tuned.tolerance = tolerance_;
    auto candidates = candidates_of();
    if (!candidates) return tl::unexpected<Error>(candidates.error());
    progress_(entry_.name + ": the reference, " + reference_choice().text());
    auto reference = shots(reference_choice());
    if (!reference) return tl::unexpected<Error>(reference.error());
    reference_ = std::move(*reference);
    if (entry_.kind == SampleKind::image && !any_light())
      return fail(ErrorCode::bad_input, entry_.node.place(),
                  entry_.name +
                      ": expected a view with light in it, got a black one: there is nothing that a "
                      "`tolerance` could be a share of");
    std::size_t at = 0;
    for (const EngineChoice& choice : *candidates) {
      progress_(fmt::format("{}: {} of {}, {}", entry_.name, ++at, candidates->size(), choice.text()));
      auto trial = measure(choice);
      // A machine without a Vulkan device has one engine.
      if (!trial && choice.engine == "raster" && trial.error().code == ErrorCode::unavailable) continue;
      if (!trial) return tl::unexpected<Error>(trial.error());
      tuned.trials.push_back(*trial);
    }
    for (std::size_t i = 0; i < tuned.trials.size(); ++i)
      if (tuned.trials[i].meets && (!tuned.best() || tuned.trials[i].p50_ms < tuned.best()->p50_ms))
        tuned.best_index = i;
    return tuned;
  }

 private:
  [[nodiscard]] EngineChoice reference_choice() const {
    EngineChoice c;
    c.engine = "rays";
    if (entry_.kind == SampleKind::point_cloud) c.sub_rays = kReferenceSubRays;
    if (entry_.kind == SampleKind::range_image) c.samples_per_pixel = kReferenceTofSamples;
    if (entry_.kind == SampleKind::image) c.samples_per_pixel = kReferenceCameraSamples;
    return c;
  }

  /// Cheap ones first.
  Result<std::vector<EngineChoice>> candidates_of() const {
    const ConfigNode& params = *simulated_params(entry_);
    const auto file = catch_config([&] { return params.base_dir() / params.text("sensor"); });
    if (!file) return tl::unexpected<Error>(file.error());
    std::vector<EngineChoice> all;
    const auto add = [&](const char* engine, auto&& change) {
      EngineChoice c;
      c.engine = engine;
      change(c);
      all.push_back(c);
    };
    if (entry_.kind == SampleKind::image) {
      const auto sensor_model = load_camera(*file);
      if (!sensor_model) return tl::unexpected<Error>(sensor_model.error());
      // Meshes are in full, whatever error is allowed.
      // The sky's edges cost next to nothing where there is no sky.
      for (const PixelSamples n :
           {PixelSamples{1, 0, 0}, {1, 0, 16}, {1, 7, 16}, {1, 15, 16}, {4, 15, 64}, {16, 0, 0}})
        add("rays", [&](EngineChoice& c) {
          c.samples_per_pixel = n.every;
          if (n.uneven > 0) c.uneven_samples = n.uneven;
          if (n.sky > 0) c.sky_samples = n.sky;
        });
      // One view has neither blur nor rows that expose later than others; without either, more are the same.
      const Shutter& shutter = sensor_model->model.shutter;
      const bool takes_time = shutter.motion_blur || shutter.line_time_s > 0;
      for (const double error : {2e-3, 0.0})
        for (const double scale : {1.0, 2.0})
          for (const int instants : takes_time ? std::vector<int>{4, 8} : std::vector<int>{1})
            add("raster", [&](EngineChoice& c) {
              c.allowed_error_rad = error, c.supersampling = scale, c.instants = instants;
            });
      return all;
    }
    const bool lidar = entry_.kind == SampleKind::point_cloud;
    int own = 1;
    if (lidar) {
      const auto model = load_lidar_model(*file);
      if (!model) return tl::unexpected<Error>(model.error());
      own = model->footprint.sub_rays;
    } else {
      const auto model = load_tof_model(*file);
      if (!model) return tl::unexpected<Error>(model.error());
      own = model->sampling.samples;
    }
    // Fewer than the sensor model's lose what it has them for, flying pixels and mixed echoes: at places, so
    // that the root mean square hides it. Only for who says what share of the rays may be wrong.
    std::vector<int> samples;
    if (tolerance_.outliers_given)
      for (const int n : lidar ? std::vector<int>{1, 5, 7, 13, 19} : std::vector<int>{1, 4, 9})
        if (n < own) samples.push_back(n);
    samples.push_back(own);
    for (const int n : samples)
      for (const double error : {3e-3, 1e-3, 0.0})
        add("rays", [&](EngineChoice& c) {
          c.allowed_error_rad = error;
          (lidar ? c.sub_rays : c.samples_per_pixel) = n;
        });
    for (const int n : samples)
      for (const double pixels : {250.0, 500.0, 1000.0})
        add("raster", [&](EngineChoice& c) {
          c.allowed_error_rad = 1 / pixels / 2;
          c.pixels_per_rad = pixels;
          (lidar ? c.sub_rays : c.samples_per_pixel) = n;
        });
    return all;
  }

  Result<std::vector<Shot>> shots(const EngineChoice& choice) const {
    auto sensor = Sensor::make(simulation_, rig_, entry_, choice, true);
    if (!sensor) return tl::unexpected<Error>(sensor.error());
    std::vector<Shot> all;
    for (std::size_t k = 0; k < instants_.size(); ++k) {
      if (auto s = sensor->capture(k, instants_[k]); !s) return tl::unexpected<Error>(s.error());
      Shot shot;
      if (entry_.kind == SampleKind::image) shot.numbers = sensor->light();
      if (entry_.kind == SampleKind::range_image) shot.numbers = sensor->ranges();
      if (entry_.kind == SampleKind::point_cloud) shot.points = sensor->points();
      all.push_back(std::move(shot));
    }
    return all;
  }

  [[nodiscard]] bool any_light() const {
    for (const Shot& shot : reference_)
      for (std::size_t i = 0; i < shot.numbers.size(); ++i)
        if (i % 4 != 3 && shot.numbers[i] > 0) return true;
    return false;
  }

  Result<Trial> measure(const EngineChoice& choice) const {
    Trial trial;
    trial.choice = choice;
    auto mine = shots(choice);
    if (!mine) return tl::unexpected<Error>(mine.error());
    judge(*mine, trial);
    auto sensor = Sensor::make(simulation_, rig_, entry_, choice, false);
    if (!sensor) return tl::unexpected<Error>(sensor.error());
    std::vector<double> ms;
    const auto start = monotonic_now();
    for (int k = 0; k <= kTimed; ++k) {
      if (k > kTimedAtLeast && monotonic_now() - start > kTimedWithin) break;
      const auto t = BenchTime(0) + entry_.period * std::int64_t{k};
      const auto begin = monotonic_now();
      if (auto s = sensor->capture(static_cast<std::uint64_t>(k), t); !s)
        return tl::unexpected<Error>(s.error());
      if (k > 0) ms.push_back((monotonic_now() - begin).seconds() * 1e3);
    }
    std::sort(ms.begin(), ms.end());
    trial.p50_ms = ms[ms.size() / 2];
    trial.max_ms = ms.back();
    trial.timed = static_cast<int>(ms.size());
    return trial;
  }

  void judge(const std::vector<Shot>& mine, Trial& trial) const {
    if (entry_.kind == SampleKind::image) {
      double squares = 0, sum = 0;
      std::size_t n = 0;
      for (std::size_t k = 0; k < mine.size(); ++k)
        for (std::size_t i = 0; i < reference_[k].numbers.size(); ++i) {
          const double r = reference_[k].numbers[i], m = mine[k].numbers[i];
          if (i % 4 == 3 || !std::isfinite(r)) continue;  // near infrared; no number to compare with
          const double d = std::isfinite(m) ? m - r : r;
          squares += d * d;
          sum += r;
          ++n;
        }
      trial.radiance = std::sqrt(squares * static_cast<double>(n)) / sum;
      trial.meets = trial.radiance <= tolerance_.radiance;
      return;
    }
    const double limit_m = std::max(0.1, 5 * tolerance_.range_m);
    for (std::size_t k = 0; k < mine.size(); ++k) {
      const RangeError e = entry_.kind == SampleKind::point_cloud
                               ? difference_of(reference_[k].points, mine[k].points, limit_m)
                               : difference_of(reference_[k].numbers, mine[k].numbers, limit_m);
      // The worst instant counts.
      trial.range_rmse_m = std::max(trial.range_rmse_m, e.rmse_m);
      trial.outliers = std::max(trial.outliers, e.outliers);
    }
    trial.meets = trial.range_rmse_m <= tolerance_.range_m && trial.outliers <= tolerance_.outliers;
  }

  Simulation& simulation_;
  const RigConfig& rig_;
  const ChannelEntry& entry_;
  Tolerance tolerance_;
  const std::function<void(const std::string&)>& progress_;
  std::vector<BenchTime> instants_;
  std::vector<Shot> reference_;
};

}  // namespace

RangeError difference_of(std::span<const LidarPoint> reference, std::span<const LidarPoint> points,
                         double limit_m) {
  const auto a = sorted(reference), b = sorted(points);
  RangeSum sum;
  std::size_t i = 0, j = 0;
  while (i < a.size() || j < b.size()) {
    if (j == b.size() || (i < a.size() && before(a[i], b[j]))) {
      ++sum.wrong, ++i;  // missed
    } else if (i == a.size() || before(b[j], a[i])) {
      ++sum.wrong, ++j;  // false
    } else {
      sum.add(range_of_point(b[j++]) - range_of_point(a[i++]), limit_m);
    }
  }
  return sum.result();
}

RangeError difference_of(std::span<const float> reference_m, std::span<const float> range_m, double limit_m) {
  RangeSum sum;
  for (std::size_t i = 0; i < std::min(reference_m.size(), range_m.size()); ++i) {
    const bool a = std::isfinite(reference_m[i]), b = std::isfinite(range_m[i]);
    if (a && b) sum.add(double{range_m[i]} - double{reference_m[i]}, limit_m);
    if (a != b) ++sum.wrong;
  }
  return sum.result();
}

const ConfigNode* simulated_params(const ChannelEntry& entry) {
  const BackendChoice& choice = entry.is_pair ? entry.simulated : entry.source;
  return choice.backend == "simulated" ? &choice.params : nullptr;
}

Result<TunedChannel> tune_channel(Simulation& simulation, const RigConfig& rig, const ChannelEntry& entry,
                                  const Tolerance& tolerance,
                                  const std::function<void(const std::string&)>& progress) {
  return Tuner(simulation, rig, entry, tolerance, progress).run();
}

}  // namespace rigor
