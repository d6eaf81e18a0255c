#include "apps/forest-localization/forest_localization.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include "apps/forest-localization/drive_output.h"
#include "apps/forest-localization/estimate_output.h"
#include "apps/forest-localization/geodetic.h"
#include "apps/forest-localization/level_scan.h"
#include "apps/forest-localization/localizer.h"
#include "apps/forest-localization/marked_trees.h"
#include "apps/forest-localization/odometry_input.h"
#include "apps/forest-localization/path_follower.h"
#include "apps/forest-localization/rig_ports.h"
#include "apps/forest-localization/stem_detector.h"
#include "apps/forest-localization/stem_map.h"
#include "apps/forest-localization/tilt_filter.h"

namespace rigor {
namespace {

using namespace forest;

class ForestLocalization final : public Application {
 public:
  Status configure(ConfigNode params, const ApplicationPorts& ports, Period loop_period) override {
    auto read = catch_config([&]() -> Status {
      if (auto s = read_map(params.map("map")); !s) return s;
      if (params.has("scanners"))
        for (const ConfigNode& n : params.list("scanners")) read_scanner(n, ports);
      else
        read_scanner(params.map("scanner"), ports);
      odometry_.emplace(params.map("odometry"), ports);
      if (params.has("imu")) read_imu(params.map("imu"), ports);
      if (params.has("gnss")) read_gnss(params.map("gnss"), ports);
      read_start(params);
      if (auto s = read_guide(params, ports, loop_period); !s) return s;
      if (params.has("estimate")) estimate_.emplace(params.map("estimate"), ports, loop_period);
      search_poses_ = static_cast<std::uint32_t>(
          params.integer_or("search_poses_per_cycle", 100, {.min = 1, .max = 1e6}));
      params.finish();
      localizer_.emplace(localizer_config_, *map_, start_);
      return {};
    });
    if (!read) return tl::unexpected<Error>(read.error());
    return *read;
  }

  void step(std::uint64_t cycle, BenchTime t_cycle) noexcept override {
    take_odometry();
    take_imu();
    take_fix();
    for (Scanner& scanner : scanners_) take_scan(scanner);
    localizer_->work(search_poses_);
    const bool drives = drive_ && drive_->due(cycle);
    const bool tells = estimate_ && estimate_->due(cycle);
    if (!drives && !tells) return;
    const PoseGaussian pose = localizer_->at(t_cycle);
    if (drives) drive(pose, t_cycle);
    if (tells) tell(pose, t_cycle);
  }

 private:
  static constexpr std::size_t kMaxScanners = 4;
  struct Scanner {
    const SamplePort* port = nullptr;
    LevelScan level;
    StemDetector detector;
  };

  // ---- setup ----
  Status read_map(const ConfigNode& n) {
    const std::filesystem::path file = n.base_dir() / n.text("file");
    auto map = StemMap::load(file);
    if (!map) return tl::unexpected<Error>(map.error());
    map_ = std::make_unique<StemMap>(std::move(*map));
    const double sigma_m = n.number_or("sigma_m", 0.03, {.min = 0, .max = 5});
    const double radius_sigma_m =
        n.number_or("diameter_sigma_m", 0.04, {.min = 0, .max = 5, .exclusive_min = true}) / 2;
    n.finish();
    auto& c = localizer_config_;
    c.filter.map_sigma_m = c.matcher.map_sigma_m = c.relocalizer.map_sigma_m = sigma_m;
    c.filter.map_radius_sigma_m = c.matcher.map_radius_sigma_m = c.relocalizer.map_radius_sigma_m =
        radius_sigma_m;
    return {};
  }

  void read_scanner(const ConfigNode& n, const ApplicationPorts& ports) {
    const SamplePort* port = find_input(n, ports, {SampleKind::point_cloud}, "point_cloud").port;
    if (scanners_.size() == kMaxScanners) throw n.error("", "expected at most 4 scanners");
    const ConfigNode at = n.map_or_absent("T_base_sensor");
    const auto place = at.numbers_or("position_m", {0, 0});
    ScannerMount mount;
    mount.T_base_sensor = {place[0], place[1],
                           at.number_or("yaw_deg", 0, {.min = -360, .max = 360}) * kRadPerDeg};
    mount.height_m = at.number_or("height_m", 0, {.min = -10, .max = 20});
    mount.pitch_rad = at.number_or("pitch_deg", 0, {.min = -45, .max = 45}) * kRadPerDeg;
    mount.roll_rad = at.number_or("roll_deg", 0, {.min = -45, .max = 45}) * kRadPerDeg;
    at.finish();
    if (n.has("lowest_m")) mount.lowest_m = n.number("lowest_m", {.min = -10, .max = 20});
    std::vector<IgnoredSector> sectors;
    for (const ConfigNode& item : n.list_or_empty("ignore_sectors")) {
      sectors.push_back({item.number("from_deg", {.min = -180, .max = 180}) * kRadPerDeg,
                         item.number("to_deg", {.min = -180, .max = 180}) * kRadPerDeg,
                         item.number("within_m", {.min = 0, .max = 500})});
      item.finish();
    }
    StemDetectorConfig c;
    c.step_rad = n.number("step_deg", {.min = 0.001, .max = 5}) * kRadPerDeg;
    c.half_field_rad = n.number_or("field_of_view_deg", 270, {.min = 10, .max = 360}) * kRadPerDeg / 2;
    c.range_sigma_m = n.number("range_sigma_mm", {.min = 0.01, .max = 1000}) / 1000;
    c.edge_beyond_rad = n.number_or("edge_beyond_deg", 0, {.min = 0, .max = 5}) * kRadPerDeg;
    c.edge_sigma_rad = c.edge_beyond_rad / 2;
    const auto diameters = n.numbers_or("diameter_m", {0.05, 1.2});
    c.min_diameter_m = diameters[0];
    c.max_diameter_m = diameters[1];
    if (!(0 < c.min_diameter_m && c.min_diameter_m < c.max_diameter_m))
      throw n.error("diameter_m",
                    "expected the smallest and the greatest diameter of stems, over 0, in this order");
    c.max_range_m = n.number_or("max_range_m", 20, {.min = 1, .max = 500});
    c.misfit = n.number_or("misfit", 1, {.min = 1, .max = 100});
    n.finish();
    scanners_.push_back({port, LevelScan(mount, std::move(sectors)), StemDetector(c)});
  }

  void read_imu(const ConfigNode& n, const ApplicationPorts& ports) {
    imu_ = find_input(n, ports, {SampleKind::imu}, "imu").port;
    const auto rpy = n.numbers_or("roll_pitch_yaw_deg", {0, 0, 0});
    const Eigen::Matrix3d R = (Eigen::AngleAxisd(rpy[2] * kRadPerDeg, Eigen::Vector3d::UnitZ()) *
                               Eigen::AngleAxisd(rpy[1] * kRadPerDeg, Eigen::Vector3d::UnitY()) *
                               Eigen::AngleAxisd(rpy[0] * kRadPerDeg, Eigen::Vector3d::UnitX()))
                                  .toRotationMatrix();
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) R_base_imu_[i][j] = R(i, j);
    if (n.flag_or("levels", false)) tilt_.emplace();
    tilt_sigma_rad_ = n.number_or("tilt_sigma_deg", 1, {.min = 0, .max = 45}) * kRadPerDeg;
    n.finish();
  }

  void read_gnss(const ConfigNode& n, const ApplicationPorts& ports) {
    gnss_ = find_input(n, ports, {SampleKind::nav_fix}, "nav_fix").port;
    const ConfigNode o = n.map("origin");
    origin_ = {o.number("latitude_deg", {.min = -90, .max = 90}),
               o.number("longitude_deg", {.min = -360, .max = 360}), o.number_or("height_m", 0)};
    o.finish();
    const auto antenna = n.numbers_or("antenna_m", {0, 0});
    antenna_lever_m_ = std::hypot(antenna[0], antenna[1]);
    n.finish();
  }

  void read_start(const ConfigNode& params) {
    start_.reset();
    if (!params.has("start")) return;
    const ConfigNode n = params.map("start");
    const auto place = n.numbers("position_m", 2);
    PoseGaussian start;
    start.mean = {place[0], place[1], n.number("yaw_deg", {.min = -360, .max = 360}) * kRadPerDeg};
    const double sigma_m = n.number_or("sigma_m", 0.3, {.min = 1e-3, .max = 100});
    const double sigma_rad = n.number_or("sigma_deg", 5, {.min = 1e-3, .max = 180}) * kRadPerDeg;
    start.covariance =
        Eigen::Vector3d(sigma_m * sigma_m, sigma_m * sigma_m, sigma_rad * sigma_rad).asDiagonal();
    n.finish();
    start_ = start;
  }

  Status read_guide(const ConfigNode& params, const ApplicationPorts& ports, Period loop_period) {
    const std::string guide =
        params.choice_or("guide", {"path", "marked", "none"}, params.has("path") ? "path" : "none");
    // Keys of the other guides may stand there, so that a rig changes over by one word.
    (void)params.map_or_absent("path");
    (void)params.map_or_absent("marked");
    (void)params.map_or_absent("drive");
    (void)params.map_or_absent("crane");
    if (guide == "none") return {};
    drive_.emplace(params.map("drive"), ports, loop_period);
    if (guide == "path") return read_path(params.map("path"));
    marked_.emplace(params.map_or_absent("marked"), *map_);
    if (marked_->along_path()) {
      if (auto s = read_path(params.map("path")); !s) return s;
    } else {
      follower_.emplace(drive_->follower_config(), 2);
    }
    if (std::none_of(map_->stems().begin(), map_->stems().end(), [](const Stem& s) { return s.fell; }))
      return fail(ErrorCode::bad_input, params.place(),
                  "guide: marked needs stems with `fell: true` in the map; there is none");
    if (params.has("crane")) {
      if (!marked_->along_path())
        throw params.error("crane",
                           "expected `marked.along_path: true` with a crane: it works beside a path");
      marked_->add_crane(params.map("crane"), ports);
    }
    if (marked_->along_path()) marked_->plan_stops(*follower_);
    return {};
  }

  Status read_path(const ConfigNode& n) {
    std::vector<WayPoint> points;
    if (n.has("file")) {
      const std::filesystem::path file = n.base_dir() / n.text("file");
      std::ifstream in(file);
      if (!in) return fail(ErrorCode::not_found, file.string(), "expected a path, found no readable file");
      std::string line;
      for (std::size_t number = 1; std::getline(in, line); ++number) {
        if (line.empty() || line[0] == '#' || (points.empty() && line.find("x_m") != std::string::npos))
          continue;
        WayPoint p;
        char more = 0;
        if (std::sscanf(line.c_str(), "%lf , %lf %c", &p.x_m, &p.y_m, &more) != 2)
          return fail(ErrorCode::bad_input, file.string() + ":" + std::to_string(number),
                      "expected x_m,y_m, got \"" + line + "\"");
        points.push_back(p);
      }
    } else {
      for (const ConfigNode& item : n.list("points")) {
        points.push_back({item.number("x_m"), item.number("y_m")});
        item.finish();
      }
    }
    n.finish();
    if (points.empty() || points.size() > 100000)
      return fail(ErrorCode::bad_input, n.place(), "path: expected 1 to 100000 points");
    follower_.emplace(drive_->follower_config(), points.size());
    (void)follower_->set_path(points.data(), points.size());
    return {};
  }

  // ---- loop ----
  void take_odometry() noexcept {
    if (!odometry_->take()) return;
    localizer_->odometry(odometry_->t(), odometry_->way_m(), odometry_->turn_rad());
    if (tilt_) tilt_->odometry(odometry_->t(), odometry_->way_m());
  }

  void take_imu() noexcept {
    const Sample* sample = fresh_sample(imu_);
    const auto* s = sample ? sample->as<ImuSample>() : nullptr;
    if (!s) return;
    std::array<double, 3> force{}, rate{};
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < 3; ++j) {
        force[i] += R_base_imu_[i][j] * s->specific_force_mps2[j];
        rate[i] += R_base_imu_[i][j] * s->angular_rate_radps[j];
      }
    localizer_->gyro(sample->stamp.t_capture, rate[2]);
    if (tilt_) tilt_->imu(sample->stamp.t_capture, force, rate);
  }

  void take_fix() noexcept {
    const Sample* sample = fresh_sample(gnss_);
    const auto* s = sample ? sample->as<NavFix>() : nullptr;
    if (!s || s->status == FixStatus::none) return;
    const auto enu = east_north_m(origin_, {s->latitude_deg, s->longitude_deg, s->height_m});
    // Receivers claim too little under trees: three times, and never better than half a metre.
    const double claimed = std::sqrt(std::max(s->covariance_enu_m2[0], s->covariance_enu_m2[4]));
    localizer_->hint(sample->stamp.t_capture,
                     {enu[0], enu[1], std::max(3 * claimed, 0.5) + antenna_lever_m_});
  }

  void take_scan(Scanner& scanner) noexcept {
    const Sample* sample = fresh_sample(scanner.port);
    const auto* info = sample ? sample->as<PointCloudInfo>() : nullptr;
    if (!info) return;
    const auto bytes = sample->bytes();
    const std::size_t count = std::min<std::size_t>(info->count, bytes.size() / sizeof(LidarPoint));
    const auto* points = reinterpret_cast<const LidarPoint*>(bytes.data());
    const double v = localizer_->speed_mps(), w = localizer_->turn_radps();
    const PlanarPose& at = scanner.level.mount().T_base_sensor;
    const double c = std::cos(at.yaw_rad), s = std::sin(at.yaw_rad);
    const double vx = v - w * at.y_m, vy = w * at.x_m;
    const std::optional<IgnoredStrip> own = marked_ ? marked_->strip() : std::nullopt;
    const auto level = scanner.level.level({points, count}, own ? &*own : nullptr);
    const auto stems = scanner.detector.detect(level, {c * vx + s * vy, -s * vx + c * vy, w});
    const double height_m = scanner.level.mount().height_m;
    const Tilt tilt = tilt_ ? tilt_->at(sample->stamp.t_capture) : Tilt{};
    for (std::size_t i = 0; i < stems.size(); ++i) {
      in_base_[i] = moved(stems[i], at);
      if (tilt_) in_base_[i] = levelled(in_base_[i], height_m, tilt);
    }
    if (marked_) marked_->see({in_base_.data(), stems.size()}, localizer_->filter().pose(), *follower_);
    const std::uint64_t matched_before = localizer_->counters().matched;
    localizer_->scan(sample->stamp.t_capture, {in_base_.data(), stems.size()});
    last_stems_ = static_cast<double>(stems.size());
    last_matched_ = static_cast<double>(localizer_->counters().matched - matched_before);
  }

  void drive(const PoseGaussian& pose, BenchTime now) noexcept {
    const bool may_drive = localizer_->state() == LocalizerState::tracking;
    if (marked_) marked_->step(*follower_, pose, may_drive, now);
    const bool busy = marked_ && marked_->busy();
    drive_->send(follower_->step(pose.mean, drive_->period_s(), may_drive && !busy), now);
  }

  void tell(const PoseGaussian& pose, BenchTime now) noexcept {
    Estimate e;
    e.pose = pose;
    // Where the accelerometer is wrong about the level, the scanner is not where it is thought to be above
    // the base.
    if (tilt_ && !scanners_.empty()) e.lean_sigma_m = tilt_sigma_rad_ * scanners_[0].level.mount().height_m;
    e.state = static_cast<double>(localizer_->state());
    e.stems = last_stems_, e.matched = last_matched_;
    if (follower_) {
      e.progress_m = follower_->progress_m(), e.cross_track_m = follower_->cross_track_m();
      e.done = follower_->done();
    }
    if (marked_) {
      e.cut = marked_->cut(), e.out_of_reach = marked_->out_of_reach();
      if (marked_->target() != StemMap::kNone) {
        const Stem& s = (*map_)[marked_->target()];
        const Eigen::Vector2d p = seen_from(pose.mean, s.x_m, s.y_m).p_base;
        e.target_range_m = p.norm();
        e.target_bearing_rad = std::atan2(p.y(), p.x());
      }
    }
    estimate_->send(e, now);
  }

  std::unique_ptr<StemMap> map_;
  LocalizerConfig localizer_config_;
  std::optional<Localizer> localizer_;
  std::optional<PoseGaussian> start_;
  std::uint32_t search_poses_ = 100;

  std::vector<Scanner> scanners_;
  std::array<StemObservation, StemDetector::kMaxStems> in_base_{};
  double last_stems_ = 0, last_matched_ = 0;

  std::optional<OdometryInput> odometry_;
  const SamplePort* imu_ = nullptr;
  double R_base_imu_[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  std::optional<TiltFilter> tilt_;
  double tilt_sigma_rad_ = 0;
  const SamplePort* gnss_ = nullptr;
  GeodeticPlace origin_;
  double antenna_lever_m_ = 0;

  // Without a guide there is none of these.
  std::optional<DriveOutput> drive_;
  std::optional<PathFollower> follower_;
  std::optional<MarkedTrees> marked_;

  std::optional<EstimateOutput> estimate_;
};

}  // namespace

std::unique_ptr<Application> make_forest_localization() { return std::make_unique<ForestLocalization>(); }

}  // namespace rigor
