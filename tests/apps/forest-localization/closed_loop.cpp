#include "tests/apps/forest-localization/closed_loop.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Core>
#include <Eigen/LU>

namespace rigor::forest::test {

std::string write_inputs(const std::filesystem::path& dir, const DiscForest& map,
                         const std::vector<PlanarPose>& way, const LoopOptions& options) {
  std::ofstream stems(dir / "stems.csv");
  stems << "x_m,y_m,diameter_m,fell\n";
  for (const Stem& s : map.stems)
    stems << s.x_m << "," << s.y_m << "," << 2 * s.radius_m << "," << (s.fell ? "true" : "false") << "\n";
  std::ofstream path(dir / "way.csv");
  path << "x_m,y_m\n";
  for (const PlanarPose& p : way) path << p.x_m << "," << p.y_m << "\n";
  const auto file = [&](const char* name) { return (dir / name).string(); };
  std::string keys =
      "scanner: { channel: scanner, T_base_sensor: { position_m: [0.5, 0] }, step_deg: 0.3333333333, "
      "range_sigma_mm: 11.6 }\nodometry: { channel: odometry }\n";
  if (options.imu) keys += "imu: { channel: imu }\n";
  if (options.with_gnss) keys += "gnss: { channel: gnss, origin: { latitude_deg: 50, longitude_deg: 7 } }\n";
  keys += "map: { file: " + file("stems.csv") +
          ", sigma_m: " + std::to_string(std::max(options.map_sigma_m, 0.001)) + " }\n";
  if (options.with_start)
    keys += "start: { position_m: [" + std::to_string(way[0].x_m) + ", " + std::to_string(way[0].y_m) +
            "], yaw_deg: 0, sigma_m: 0.3, sigma_deg: 5 }\n";
  keys += options.extra.empty() ? "path: { file: " + file("way.csv") + " }\n" : options.extra;
  keys += "drive: { sink: drive, rate_hz: 20, speed_mps: 0.8 }\nestimate: { sink: estimate, rate_hz: 20 }\n";
  return keys;
}

LoopResult run_loop(const LoopOptions& o) {
  LoopResult result;
  std::mt19937 rng(o.seed * 7919 + 17);
  std::normal_distribution<double> normal(0, 1);
  std::uniform_real_distribution<double> unit(0, 1);
  const auto way = way_200();
  DiscForest forest = DiscForest::random(44, o.per_m2, o.seed + 100, way);
  DiscForest map = forest;
  for (Stem& s : map.stems) s.x_m += o.map_sigma_m * normal(rng), s.y_m += o.map_sigma_m * normal(rng);
  std::vector<Stem> marked;
  if (!o.extra.empty())  // marked: three of them
    for (std::size_t i = 0; i < 3; ++i) {
      map.stems[20 * i].fell = true;
      marked.push_back(forest.stems[20 * i]);
    }
  std::vector<bool> stood(marked.size());

  const auto dir = std::filesystem::temp_directory_path() /
                   ("forest-localization-" + std::to_string(getpid()) + "-" + std::to_string(o.seed));
  std::filesystem::create_directories(dir);
  const std::string keys = write_inputs(dir, map, way, o);

  FakeChannel scanner(SampleKind::point_cloud, nanoseconds(66'666'667), milliseconds(100),
                      900 * sizeof(LidarPoint));
  FakeChannel odometry(SampleKind::odometry, milliseconds(20), milliseconds(10), 1);
  FakeChannel imu(SampleKind::imu, milliseconds(10), milliseconds(4), 1);
  FakeChannel gnss(SampleKind::nav_fix, milliseconds(1000), milliseconds(60), 1);
  FakeSink drive({"v", "w"}), estimate({"x", "y", "yaw", "sigma_x", "sigma_y", "sigma_yaw", "state", "done"});
  CommandPort drive_port("drive", drive, milliseconds(20)),
      estimate_port("estimate", estimate, milliseconds(0));
  ApplicationPorts ports;
  for (auto& [name, channel] : {std::pair<const char*, FakeChannel*>{"scanner", &scanner},
                                {"odometry", &odometry},
                                {"imu", &imu},
                                {"gnss", &gnss}})
    ports.inputs[name] = {name, &channel->description, &channel->port};
  ports.outputs["drive"] = &drive_port;
  ports.outputs["estimate"] = &estimate_port;

  auto application = make_forest_localization();
  auto document = ConfigDocument::parse(keys);
  EXPECT_TRUE(document.has_value());
  const Status configured = application->configure(*document, ports, milliseconds(10));
  EXPECT_TRUE(configured.has_value()) << (configured ? "" : configured.error().text());
  std::filesystem::remove_all(dir);
  if (!configured) return result;

  // The robot: follows commands with a lag, on ground where its odometry is wrong by scales and noise.
  PlanarPose truth{way[0].x_m + 0.1 * normal(rng), way[0].y_m + 0.1 * normal(rng), 0.03 * normal(rng)};
  Twist now;
  const double way_scale = 1 + 0.02 * normal(rng), turn_scale = 1 + 0.07 * normal(rng);
  const double gyro_bias = 0.01 * normal(rng);
  PlanarPose told;  // what the odometry adds up
  double slip_until_s = -1;
  int slip_side = 0;
  std::deque<std::pair<double, Twist>> commands;
  std::deque<PlanarPose> past;
  double lost_since_s = -1;
  bool kidnapped = false;
  std::uint64_t seen_commands = 0, seen_estimates = 0;
  std::uint64_t k = 0;
  double scan_at_s = 0;
  for (; static_cast<double>(k) * 0.01 < o.max_s; ++k) {
    const double t_s = static_cast<double>(k) * 0.01;
    const BenchTime t = BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(k);
    if (!kidnapped && t_s >= o.kidnap_at_s) {
      kidnapped = true;
      truth = {way[120].x_m + 0.5, way[120].y_m - 0.4, truth.yaw_rad + 2};
    }
    // Samples of this instant.
    if (o.imu) {
      ImuSample s;
      s.angular_rate_radps = {0, 0, now.turn_radps + gyro_bias + 0.002 * normal(rng)};
      imu.push(t, s);
    }
    const bool odometry_out =
        t_s >= o.odometry_out_from_s && t_s < o.odometry_out_from_s + o.odometry_out_for_s;
    if (k % 2 == 0 && !odometry_out) {
      Odometry s;
      s.T_odom_base.position_m = {told.x_m, told.y_m, 0};
      s.T_odom_base.orientation_wxyz = {std::cos(told.yaw_rad / 2), 0, 0, std::sin(told.yaw_rad / 2)};
      odometry.push(t, s);
    }
    if (k % 100 == 0 && o.with_gnss) {
      NavFix f;
      f.status = FixStatus::fix;
      const double lat = 50 * kPi / 180;
      f.latitude_deg = 50 + (truth.y_m + 1.5 * normal(rng)) / 111229.0;
      f.longitude_deg = 7 + (truth.x_m + 1.5 * normal(rng)) / (111320.0 * std::cos(lat) * 1.00196);
      f.covariance_enu_m2 = {2.25, 0, 0, 0, 2.25, 0, 0, 0, 9};
      gnss.push(t, f);
    }
    if (t_s >= scan_at_s) {
      scan_at_s += 1.0 / 15;
      const bool out = t_s >= o.scans_out_from_s && t_s < o.scans_out_from_s + o.scans_out_for_s;
      if (!out && unit(rng) >= o.scan_loss) {
        auto points = forest.scan(truth, Scanner{.mount_x_m = 0.5}, rng, now);
        for (LidarPoint& p : points)
          if (o.nan_share > 0 && unit(rng) < o.nan_share) p.x_m = std::numeric_limits<float>::quiet_NaN();
        scanner.push(t, PointCloudInfo{static_cast<std::uint32_t>(points.size())}, points);
      }
    }
    past.push_back(truth);
    for (FakeChannel* c : {&scanner, &odometry, &imu, &gnss}) c->port.advance(t, true);

    watching = true;
    application->step(k, t);
    watching = false;
    result.allocations += allocations;
    allocations = 0;

    if (drive.count != seen_commands) {
      seen_commands = drive.count;
      commands.push_back({t_s + 0.02, {drive.last.value[0], drive.last.value[1]}});
    }
    if (estimate.count != seen_estimates) {
      seen_estimates = estimate.count;
      const auto& v = estimate.last.value;
      const bool tracking = v[6] == 1;
      const Eigen::Vector3d e(v[0] - truth.x_m, v[1] - truth.y_m,
                              std::remainder(v[2] - truth.yaw_rad, 2 * kPi));
      const double error = e.head<2>().norm();
      if (tracking && t_s > 1) {
        result.error_m.push_back(error);
        result.error_yaw_rad.push_back(e.z());
      }
      if (kidnapped && result.found_after_s < 0 && t_s > o.kidnap_at_s + 0.3 && tracking && error < 0.3)
        result.found_after_s = t_s - o.kidnap_at_s;
      if (tracking) lost_since_s = -1;
      if (!tracking && lost_since_s < 0) lost_since_s = t_s;
      if (!tracking && t_s > lost_since_s + 2.5)
        result.worst_lost_speed_mps = std::max(result.worst_lost_speed_mps, std::abs(drive.last.value[0]));
      result.done = v[7] == 1;
    }
    if (result.done && std::abs(now.forward_mps) < 1e-3 && o.extra.empty()) break;

    // Ten milliseconds of driving.
    Twist wanted = commands.empty() ? Twist{} : commands.front().second;
    while (commands.size() > 1 && commands[1].first <= t_s)
      commands.pop_front(), wanted = commands.front().second;
    now.forward_mps += (wanted.forward_mps - now.forward_mps) * 0.1;
    now.turn_radps += (wanted.turn_radps - now.turn_radps) * 0.1;
    if (t_s > slip_until_s && unit(rng) < o.slips_per_s * 0.01)
      slip_until_s = t_s + 0.5, slip_side = unit(rng) < 0.5;
    Twist real = now, wheels = now;
    if (t_s < slip_until_s) {  // the wheels of one side turn faster than the ground passes
      const double track = 1.12;
      const double side = (slip_side ? 1 : -1) * track / 2;
      const double v_side = real.forward_mps + side * real.turn_radps;
      wheels.forward_mps += 0.5 * v_side / 2;
      wheels.turn_radps += 0.5 * v_side / (2 * side);
    }
    if (!o.extra.empty() && t_s > 1 && std::abs(now.forward_mps) < 1e-3)
      for (std::size_t i = 0; i < marked.size(); ++i)
        if (!stood[i] &&
            std::hypot(marked[i].x_m - truth.x_m, marked[i].y_m - truth.y_m) < marked[i].radius_m + 2.2)
          stood[i] = true, ++result.stops_at_marked;
    if (!o.extra.empty() && result.stops_at_marked == marked.size()) break;
    const PlanarPose before = truth;
    truth = after(truth, real, 0.01);
    result.driven_m += std::hypot(truth.x_m - before.x_m, truth.y_m - before.y_m);
    // Sideslip, and noise of the wheels' contact.
    const double across = 0.01 * std::sqrt(std::abs(real.forward_mps) * 0.01) * normal(rng);
    truth.x_m -= across * std::sin(truth.yaw_rad), truth.y_m += across * std::cos(truth.yaw_rad);
    Twist odo{wheels.forward_mps / way_scale, wheels.turn_radps / turn_scale};
    const double length = std::abs(odo.forward_mps) * 0.01;
    odo.forward_mps += 0.02 * std::sqrt(length) * normal(rng) / 0.01;
    odo.turn_radps += 0.008 * std::sqrt(length) * normal(rng) / 0.01;
    told = after(told, odo, 0.01);
  }
  result.elapsed_s = static_cast<double>(k) * 0.01;
  result.end = truth;
  result.end_error_m = std::hypot(truth.x_m - way.back().x_m, truth.y_m - way.back().y_m);
  return result;
}

}  // namespace rigor::forest::test
