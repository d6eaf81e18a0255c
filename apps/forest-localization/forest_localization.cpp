#include "apps/forest-localization/forest_localization.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "apps/forest-localization/crane_ports.h"
#include "apps/forest-localization/geodetic.h"
#include "apps/forest-localization/level_scan.h"
#include "apps/forest-localization/localizer.h"
#include "apps/forest-localization/path_follower.h"
#include "apps/forest-localization/stem_detector.h"
#include "apps/forest-localization/stem_map.h"
#include "apps/forest-localization/tilt_filter.h"

namespace rigor {
namespace {

using namespace forest;

constexpr double kRadPerDeg = std::numbers::pi / 180;
constexpr std::array<const char*, 16> kEstimateNames{
    "x",     "y",           "yaw",      "sigma_x",     "sigma_y",      "sigma_yaw",      "state",
    "stems", "matched",     "progress", "cross_track", "target_range", "target_bearing", "done",
    "cut",   "out_of_reach"};

double yaw_of(const std::array<double, 4>& q) noexcept {
  return std::atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] * q[2] + q[3] * q[3]));
}

std::string joined(const auto& named) {
  std::string names;
  for (const auto& [name, port] : named) names += (names.empty() ? "" : ", ") + name;
  return names.empty() ? "there is none" : names;
}

class ForestLocalization final : public Application {
 public:
  Status configure(ConfigNode params, const ApplicationPorts& ports, Duration loop_period) override {
    period_ = loop_period;
    auto read = catch_config([&]() -> Status {
      if (auto s = read_map(params.map("map")); !s) return s;
      if (params.has("scanners"))
        for (const ConfigNode& n : params.list("scanners")) read_scanner(n, ports);
      else
        read_scanner(params.map("scanner"), ports);
      read_odometry(params.map("odometry"), ports);
      if (params.has("imu")) read_imu(params.map("imu"), ports);
      if (params.has("gnss")) read_gnss(params.map("gnss"), ports);
      read_start(params);
      if (auto s = read_guide(params, ports); !s) return s;
      if (params.has("estimate")) read_estimate(params.map("estimate"), ports);
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
    const bool drives = drive_ && cycle % drive_every_ == 0;
    const bool tells = estimate_ && cycle % estimate_every_ == 0;
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

  static const InputPort& input(const ConfigNode& n, const ApplicationPorts& ports,
                                std::initializer_list<SampleKind> kinds, const char* expected) {
    const std::string name = n.text("channel");
    const auto it = ports.inputs.find(name);
    if (it == ports.inputs.end())
      throw n.error("channel",
                    "expected the name of a channel (" + joined(ports.inputs) + "), got \"" + name + "\"");
    if (std::find(kinds.begin(), kinds.end(), it->second.description->kind) == kinds.end())
      throw n.error("channel", std::string("expected a channel of kind ") + expected + "; \"" + name +
                                   "\" is of another");
    return it->second;
  }
  static CommandPort& output(const ConfigNode& n, const ApplicationPorts& ports) {
    const std::string name = n.text("sink");
    const auto it = ports.outputs.find(name);
    if (it == ports.outputs.end())
      throw n.error("sink",
                    "expected the name of a sink (" + joined(ports.outputs) + "), got \"" + name + "\"");
    return *it->second;
  }
  std::uint64_t every(const ConfigNode& n) const {
    const double loop_hz = 1e9 / static_cast<double>(period_.ns());
    const double rate_hz = n.number_or("rate_hz", std::min(20.0, loop_hz), {.min = 0.1, .max = loop_hz});
    return static_cast<std::uint64_t>(std::llround(loop_hz / rate_hz));
  }

  void read_scanner(const ConfigNode& n, const ApplicationPorts& ports) {
    const SamplePort* port = input(n, ports, {SampleKind::point_cloud}, "point_cloud").port;
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

  void read_odometry(const ConfigNode& n, const ApplicationPorts& ports) {
    const InputPort& in =
        input(n, ports, {SampleKind::odometry, SampleKind::register_block}, "odometry or registers");
    odometry_ = in.port;
    if (in.description->kind == SampleKind::register_block) {
      const auto& names = in.description->names;
      steered_ = std::find(names.begin(), names.end(), "wheel_angle") != names.end();
      for (std::size_t side = 0; side < 2; ++side) {
        const char* name =
            steered_ ? (side == 0 ? "wheel_angle" : "steer") : (side == 0 ? "left_angle" : "right_angle");
        const auto it = std::find(names.begin(), names.end(), name);
        if (it == names.end())
          throw n.error(
              "channel",
              "expected registers with left_angle and right_angle in rad, or wheel_angle in rad and "
              "steer in deg, found no \"" +
                  std::string(name) + "\" among them");
        wheel_register_[side] = static_cast<std::size_t>(it - names.begin());
      }
      wheel_radius_m_ = n.number("wheel_radius_m", {.min = 0.001, .max = 10});
      if (steered_)
        wheelbase_m_ = n.number("wheelbase_m", {.min = 0.01, .max = 50});
      else
        track_m_ = n.number("track_m", {.min = 0.01, .max = 20});
    }
    n.finish();
  }

  void read_imu(const ConfigNode& n, const ApplicationPorts& ports) {
    imu_ = input(n, ports, {SampleKind::imu}, "imu").port;
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
    gnss_ = input(n, ports, {SampleKind::nav_fix}, "nav_fix").port;
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

  Status read_guide(const ConfigNode& params, const ApplicationPorts& ports) {
    guide_ = params.choice_or("guide", {"path", "marked", "none"}, params.has("path") ? "path" : "none");
    drive_ = nullptr;
    // Keys of the other guides may stand there, so that a rig changes over by one word.
    (void)params.map_or_absent("path");
    (void)params.map_or_absent("marked");
    (void)params.map_or_absent("drive");
    (void)params.map_or_absent("crane");
    if (guide_ == "none") return {};
    const ConfigNode n = params.map("drive");
    drive_ = &output(n, ports);
    const auto& names = drive_->describe().names;
    if (names.size() > drive_values_.size()) throw n.error("sink", "expected a sink of at most 16 values");
    const ConfigNode steering = n.map_or_absent("steering");
    turns_by_angle_ = steering.present();
    const auto place = [&](const char* name) {
      const auto it = std::find(names.begin(), names.end(), name);
      if (it == names.end())
        throw n.error("sink", std::string("expected a sink with the values v [m/s] and ") +
                                  (turns_by_angle_ ? "steer_to [deg]" : "w [rad/s]") + ", found no \"" +
                                  std::string(name) + "\" among its values");
      return static_cast<std::size_t>(it - names.begin());
    };
    v_at_ = place("v");
    w_at_ = place(turns_by_angle_ ? "steer_to" : "w");
    if (turns_by_angle_) {
      steering_base_m_ = steering.number("wheelbase_m", {.min = 0.01, .max = 50});
      max_steer_rad_ = steering.number("max_deg", {.min = 1, .max = 80}) * kRadPerDeg;
      steering.finish();
    }
    drive_values_.fill(0);
    for (std::size_t i = 0; i < names.size(); ++i)
      if (names[i] == "enable") drive_values_[i] = 1;
    drive_count_ = names.size();
    drive_every_ = every(n);
    PathFollowerConfig c;
    c.speed_mps = n.number_or("speed_mps", 0.5, {.min = 0.01, .max = 20});
    c.max_turn_radps = n.number_or("max_turn_degps", 45, {.min = 1, .max = 360}) * kRadPerDeg;
    c.lookahead_m = n.number_or("lookahead_m", 1, {.min = 0.1, .max = 50});
    c.stop_within_m = n.number_or("stop_within_m", 0.15, {.min = 0.01, .max = 10});
    if (turns_by_angle_) c.spot_turn_rad = 2 * std::numbers::pi;  // it cannot turn on the spot
    n.finish();
    if (guide_ == "marked") {
      const ConfigNode marked = params.map_or_absent("marked");
      along_path_ = marked.flag_or("along_path", false);
      stand_off_m_ = marked.number_or("stand_off_m", 2, {.min = 0, .max = 50});
      dwell_ = seconds_from(marked.number_or("dwell_s", 5, {.min = 0, .max = 1e6}));
      marked.finish();
      visited_.assign(map_->size(), 0);
      if (along_path_) {
        if (auto s = read_path(params.map("path"), c); !s) return s;
      } else {
        follower_.emplace(c, 2);
      }
      if (std::none_of(map_->stems().begin(), map_->stems().end(), [](const Stem& s) { return s.fell; }))
        return fail(ErrorCode::bad_input, params.place(),
                    "guide: marked needs stems with `fell: true` in the map; there is none");
      if (params.has("crane")) {
        if (!along_path_)
          throw params.error("crane",
                             "expected `marked.along_path: true` with a crane: it works beside a path");
        crane_.emplace(params.map("crane"), ports);
      }
      if (along_path_) plan_stops();
      return {};
    }
    return read_path(params.map("path"), c);
  }

  Status read_path(const ConfigNode& n, const PathFollowerConfig& c) {
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
    follower_.emplace(c, points.size());
    (void)follower_->set_path(points.data(), points.size());
    return {};
  }
  void read_estimate(const ConfigNode& n, const ApplicationPorts& ports) {
    estimate_ = &output(n, ports);
    estimate_every_ = every(n);
    const auto at = n.numbers_or("at_m", {0, 0});
    estimate_at_m_ = {at[0], at[1]};
    const auto& names = estimate_->describe().names;
    if (names.size() > estimate_index_.size()) throw n.error("sink", "expected a sink of at most 16 values");
    estimate_count_ = names.size();
    for (std::size_t i = 0; i < names.size(); ++i) {
      const auto it = std::find(kEstimateNames.begin(), kEstimateNames.end(), names[i]);
      if (it == kEstimateNames.end()) {
        std::string known;
        for (const char* k : kEstimateNames) known += std::string(known.empty() ? "" : ", ") + k;
        throw n.error("sink",
                      "expected a sink whose values are among " + known + "; got \"" + names[i] + "\"");
      }
      estimate_index_[i] = static_cast<std::size_t>(it - kEstimateNames.begin());
    }
    n.finish();
  }

  // ---- loop ----
  static const Sample* fresh(const SamplePort* port) noexcept {
    if (!port || port->status() != PortStatus::fresh || !port->sample()) return nullptr;
    const Sample& s = *port->sample();
    return (s.stamp.validity & (kCorrupt | kIncomplete)) == 0 ? &s : nullptr;
  }

  void take_odometry() noexcept {
    const Sample* sample = fresh(odometry_);
    if (!sample) return;
    const BenchTime t = sample->stamp.t_capture;
    if (const auto* o = sample->as<Odometry>()) {
      const std::array<double, 3> now{o->T_odom_base.position_m[0], o->T_odom_base.position_m[1],
                                      yaw_of(o->T_odom_base.orientation_wxyz)};
      if (odometry_seen_) {
        const double dx = now[0] - told_[0], dy = now[1] - told_[1], turn = wrapped_rad(now[2] - told_[2]);
        // The chord of a circle; its length is signed by the heading in its middle.
        const double heading = told_[2] + turn / 2;
        const double along = dx * std::cos(heading) + dy * std::sin(heading);
        const double half = turn / 2;
        const double way = along * (std::abs(half) < 1e-4 ? 1 : half / std::sin(half));
        const double dt_s = std::max((t - t_odometry_).seconds(), 1e-3);
        if (std::abs(way) < 0.5 + 5 * dt_s) way_m_ += way, turn_rad_ += turn;  // else it began anew
      }
      told_ = now;
    } else if (const auto* r = sample->as<RegisterBlock>()) {
      if (wheel_register_[0] >= r->count || wheel_register_[1] >= r->count) return;
      const double left = r->value[wheel_register_[0]], right = r->value[wheel_register_[1]];
      if (steered_) {
        // A curve of the angle that the front wheels had on the way between two reports.
        const double way = wheel_radius_m_ * (left - told_[0]), steer = right * kRadPerDeg;
        if (odometry_seen_) {
          way_m_ += way;
          turn_rad_ += way * std::tan((told_[1] + steer) / 2) / wheelbase_m_;
        }
        told_ = {left, steer, 0};
        t_odometry_ = t;
        odometry_seen_ = true;
        localizer_->odometry(t, way_m_, turn_rad_);
        if (tilt_) tilt_->odometry(t, way_m_);
        return;
      }
      if (odometry_seen_) {
        way_m_ += wheel_radius_m_ * (left - told_[0] + right - told_[1]) / 2;
        turn_rad_ += wheel_radius_m_ * (right - told_[1] - left + told_[0]) / track_m_;
      }
      told_ = {left, right, 0};
    } else {
      return;
    }
    t_odometry_ = t;
    odometry_seen_ = true;
    localizer_->odometry(t, way_m_, turn_rad_);
    if (tilt_) tilt_->odometry(t, way_m_);
  }

  void take_imu() noexcept {
    const Sample* sample = fresh(imu_);
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
    const Sample* sample = fresh(gnss_);
    const auto* s = sample ? sample->as<NavFix>() : nullptr;
    if (!s || s->status == FixStatus::none) return;
    const auto enu = east_north_m(origin_, {s->latitude_deg, s->longitude_deg, s->height_m});
    // Receivers claim too little under trees: three times, and never better than half a metre.
    const double claimed = std::sqrt(std::max(s->covariance_enu_m2[0], s->covariance_enu_m2[4]));
    localizer_->hint(sample->stamp.t_capture,
                     {enu[0], enu[1], std::max(3 * claimed, 0.5) + antenna_lever_m_});
  }

  void take_scan(Scanner& scanner) noexcept {
    const Sample* sample = fresh(scanner.port);
    const auto* info = sample ? sample->as<PointCloudInfo>() : nullptr;
    if (!info) return;
    const auto bytes = sample->bytes();
    const std::size_t count = std::min<std::size_t>(info->count, bytes.size() / sizeof(LidarPoint));
    const auto* points = reinterpret_cast<const LidarPoint*>(bytes.data());
    const double v = localizer_->speed_mps(), w = localizer_->turn_radps();
    const PlanarPose& at = scanner.level.mount().T_base_sensor;
    const double c = std::cos(at.yaw_rad), s = std::sin(at.yaw_rad);
    const double vx = v - w * at.y_m, vy = w * at.x_m;
    const std::optional<IgnoredStrip> own = crane_ ? crane_->strip() : std::nullopt;
    const auto level = scanner.level.level({points, count}, own ? &*own : nullptr);
    const auto stems = scanner.detector.detect(level, {c * vx + s * vy, -s * vx + c * vy, w});
    const double height_m = scanner.level.mount().height_m;
    const Tilt tilt = tilt_ ? tilt_->at(sample->stamp.t_capture) : Tilt{};
    for (std::size_t i = 0; i < stems.size(); ++i) {
      in_base_[i] = moved(stems[i], at);
      if (tilt_) in_base_[i] = levelled(in_base_[i], height_m, tilt);
    }
    if (crane_ && target_ != StemMap::kNone) look_for_target({in_base_.data(), stems.size()});
    const std::uint64_t matched_before = localizer_->counters().matched;
    localizer_->scan(sample->stamp.t_capture, {in_base_.data(), stems.size()});
    last_stems_ = static_cast<double>(stems.size());
    last_matched_ = static_cast<double>(localizer_->counters().matched - matched_before);
  }

  void drive(const PoseGaussian& pose, BenchTime now) noexcept {
    const bool may_drive = localizer_->state() == LocalizerState::tracking;
    if (along_path_) {
      work_along(pose, may_drive, now);
    } else if (guide_ == "marked" && may_drive) {
      aim(pose, now);
    }
    const double dt_s = static_cast<double>(drive_every_) * period_.seconds();
    const bool busy = crane_ && crane_->work().busy();
    const DriveCommand command = follower_->step(pose.mean, dt_s, may_drive && !busy);
    drive_values_[v_at_] = command.v_mps;
    if (!turns_by_angle_)
      drive_values_[w_at_] = command.w_radps;
    else if (std::abs(command.v_mps) > 0.02)  // while it stands, the wheels stay where they are
      drive_values_[w_at_] = std::clamp(std::atan(command.w_radps * steering_base_m_ / command.v_mps),
                                        -max_steer_rad_, max_steer_rad_) /
                             kRadPerDeg;
    (void)drive_->send(now,
                       std::span(drive_values_).first(drive_count_));  // a full ring is counted by the sink
  }

  /// Where on the path each marked stem is worked on: within the crane's reach, as nearly at its best bearing
  /// as can be; without a crane, where the path passes it.
  void plan_stops() {
    constexpr double kStep_m = 0.1;
    for (std::uint32_t i = 0; i < map_->size(); ++i) {
      const Stem& s = (*map_)[i];
      if (!s.fell) continue;
      Stop stop{0, i};
      double best = std::numeric_limits<double>::infinity();
      for (double at = 0; at <= follower_->length_m(); at += kStep_m) {
        const Eigen::Vector2d p = seen_from(follower_->pose_at(at), s.x_m, s.y_m).p_base;
        const double cost = crane_ ? crane_->cost(p.x(), p.y()) : p.norm() - stand_off_m_;
        if (cost < best) best = cost, stop.progress_m = at;
      }
      const bool reached = crane_ ? std::isfinite(best) : best < 1;
      if (reached)
        stops_.push_back(stop);
      else
        ++out_of_reach_;
    }
    std::stable_sort(stops_.begin(), stops_.end(),
                     [](const Stop& a, const Stop& b) { return a.progress_m < b.progress_m; });
    next_stop_ = 0;
    t_there_ = BenchTime();
    follower_->set_end(stops_.empty() ? follower_->length_m() : stops_[0].progress_m);
  }

  /// Drives from stop to stop, works there, and to the path's end.
  void work_along(const PoseGaussian& pose, bool may_drive, BenchTime now) noexcept {
    if (crane_) crane_->step(now);
    if (next_stop_ == stops_.size() || (crane_ && crane_->work().busy())) return;
    if (!follower_->done() || !may_drive) {
      if (follower_->done()) return;
      t_there_ = now;
      begun_here_ = target_seen_ = false;
      target_ = stops_[next_stop_].stem;
      return;
    }
    if (now - t_there_ < (crane_ ? kSettles : dwell_)) return;
    if (crane_ && !begun_here_) {
      begun_here_ = true;
      Eigen::Vector2d p = seen_from(pose.mean, (*map_)[target_].x_m, (*map_)[target_].y_m).p_base;
      if (target_seen_) p = target_in_base_;
      if (crane_->begin(p.x(), p.y(), now)) return;
      ++out_of_reach_;
    }
    visited_[target_] = 1;
    ++next_stop_;
    begun_here_ = target_seen_ = false;
    t_there_ = now;
    const bool more = next_stop_ < stops_.size();
    if (more) target_ = stops_[next_stop_].stem;
    follower_->set_end(more ? stops_[next_stop_].progress_m : follower_->length_m());
  }

  /// Where it stands before a stem, what the scanners see of it is nearer to the truth than the map.
  void look_for_target(std::span<const StemObservation> stems) noexcept {
    if (!follower_->done() || crane_->work().busy()) return;
    const PoseGaussian& pose = localizer_->filter().pose();
    const Eigen::Vector2d expected = seen_from(pose.mean, (*map_)[target_].x_m, (*map_)[target_].y_m).p_base;
    double best = kSameStem_m;
    for (const StemObservation& s : stems) {
      const double d = std::hypot(s.x_m - expected.x(), s.y_m - expected.y());
      if (d >= best) continue;
      best = d;
      target_seen_ = true;
      target_in_base_ = {s.x_m, s.y_m};
    }
  }

  /// The next marked stem, when it stands before the last one for long enough.
  void aim(const PoseGaussian& pose, BenchTime now) noexcept {
    if (!follower_->done()) {
      t_there_ = now;
      return;
    }
    if (target_ != StemMap::kNone && now - t_there_ < dwell_) return;
    double best = 0;
    std::uint32_t next = StemMap::kNone;
    for (std::uint32_t i = 0; i < map_->size(); ++i) {
      const Stem& s = (*map_)[i];
      if (!s.fell || visited_[i]) continue;
      const double d = std::hypot(s.x_m - pose.mean.x(), s.y_m - pose.mean.y());
      if (next == StemMap::kNone || d < best) next = i, best = d;
    }
    if (next == StemMap::kNone) return;
    target_ = next;
    visited_[next] = 1;
    const Stem& s = (*map_)[next];
    const double keep = std::min(1.0, (stand_off_m_ + s.radius_m) / std::max(best, 1e-6));
    const std::array<WayPoint, 2> way{
        WayPoint{pose.mean.x(), pose.mean.y()},
        WayPoint{s.x_m + keep * (pose.mean.x() - s.x_m), s.y_m + keep * (pose.mean.y() - s.y_m)}};
    (void)follower_->set_path(way.data(), way.size());
    t_there_ = now;
  }

  void tell(const PoseGaussian& pose, BenchTime now) noexcept {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    double range = nan, bearing = nan;
    if (target_ != StemMap::kNone) {
      const auto p = seen_from(pose.mean, (*map_)[target_].x_m, (*map_)[target_].y_m).p_base;
      range = p.norm();
      bearing = std::atan2(p.y(), p.x());
    }
    // Where the accelerometer is wrong about the level, the scanner is not where it is thought to be above
    // the base; no scan tells.
    const double lean_m =
        tilt_ && !scanners_.empty() ? tilt_sigma_rad_ * scanners_[0].level.mount().height_m : 0;
    // Of the point of the base that is asked for: it swings with the heading.
    const double c = std::cos(pose.mean.z()), s = std::sin(pose.mean.z());
    const Eigen::Vector2d arm(c * estimate_at_m_.x() - s * estimate_at_m_.y(),
                              s * estimate_at_m_.x() + c * estimate_at_m_.y());
    Eigen::Matrix3d J = Eigen::Matrix3d::Identity();
    J(0, 2) = -arm.y(), J(1, 2) = arm.x();
    const Eigen::Matrix3d covariance = J * pose.covariance * J.transpose();
    const std::array<double, kEstimateNames.size()> all{pose.mean.x() + arm.x(),
                                                        pose.mean.y() + arm.y(),
                                                        pose.mean.z(),
                                                        std::sqrt(covariance(0, 0) + lean_m * lean_m),
                                                        std::sqrt(covariance(1, 1) + lean_m * lean_m),
                                                        std::sqrt(covariance(2, 2)),
                                                        static_cast<double>(localizer_->state()),
                                                        last_stems_,
                                                        last_matched_,
                                                        follower_ ? follower_->progress_m() : 0,
                                                        follower_ ? follower_->cross_track_m() : 0,
                                                        range,
                                                        bearing,
                                                        follower_ && follower_->done() ? 1.0 : 0.0,
                                                        crane_ ? crane_->work().cut() : 0.0,
                                                        static_cast<double>(out_of_reach_)};
    std::array<double, 16> values{};
    for (std::size_t i = 0; i < estimate_count_; ++i) values[i] = all[estimate_index_[i]];
    (void)estimate_->send(now, std::span(values).first(estimate_count_));
  }

  Duration period_;
  std::unique_ptr<StemMap> map_;
  LocalizerConfig localizer_config_;
  std::optional<Localizer> localizer_;
  std::optional<PathFollower> follower_;
  std::optional<PoseGaussian> start_;
  std::uint32_t search_poses_ = 100;

  std::vector<Scanner> scanners_;
  std::array<StemObservation, StemDetector::kMaxStems> in_base_{};
  double last_stems_ = 0, last_matched_ = 0;

  const SamplePort* odometry_ = nullptr;
  std::array<std::size_t, 2> wheel_register_{};
  double wheel_radius_m_ = 0, track_m_ = 1, wheelbase_m_ = 1;
  bool steered_ = false;          ///< by an angle of the front wheels
  std::array<double, 3> told_{};  ///< x, y, yaw; or the angles of the wheels; or of a wheel and of steering
  double way_m_ = 0, turn_rad_ = 0;
  BenchTime t_odometry_;
  bool odometry_seen_ = false;

  const SamplePort* imu_ = nullptr;
  double R_base_imu_[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  std::optional<TiltFilter> tilt_;
  double tilt_sigma_rad_ = 0;
  const SamplePort* gnss_ = nullptr;
  GeodeticPlace origin_;
  double antenna_lever_m_ = 0;

  std::string guide_;
  CommandPort* drive_ = nullptr;
  std::size_t v_at_ = 0, w_at_ = 1, drive_count_ = 2;
  std::array<double, 16> drive_values_{};
  std::uint64_t drive_every_ = 1;
  std::vector<std::uint8_t> visited_;
  std::uint32_t target_ = StemMap::kNone;
  double stand_off_m_ = 2;
  Duration dwell_;
  bool turns_by_angle_ = false;
  double steering_base_m_ = 1, max_steer_rad_ = 0.5;

  // Beside a path.
  static constexpr Duration kSettles = seconds(1);
  static constexpr double kSameStem_m = 0.3;
  struct Stop {
    double progress_m = 0;
    std::uint32_t stem = 0;
  };
  bool along_path_ = false, begun_here_ = false, target_seen_ = false;
  std::vector<Stop> stops_;
  std::size_t next_stop_ = 0;
  std::uint32_t out_of_reach_ = 0;
  Eigen::Vector2d target_in_base_ = Eigen::Vector2d::Zero();
  std::optional<CranePorts> crane_;

  BenchTime t_there_;

  CommandPort* estimate_ = nullptr;
  Eigen::Vector2d estimate_at_m_ = Eigen::Vector2d::Zero();
  std::array<std::size_t, 16> estimate_index_{};
  std::size_t estimate_count_ = 0;
  std::uint64_t estimate_every_ = 1;
};

}  // namespace

std::unique_ptr<Application> make_forest_localization() { return std::make_unique<ForestLocalization>(); }

}  // namespace rigor
