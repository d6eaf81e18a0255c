#include "calibration/procedures/extrinsics_calibration.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <optional>

#include "bench/console/progress.h"
#include "bench/files/picture.h"
#include "calibration/pair/board_pose.h"
#include "calibration/pair/plane_extrinsics.h"
#include "calibration/procedures/input_files.h"
#include "calibration/procedures/recording_input.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"

namespace rigor {
namespace {

using namespace calibration;
constexpr double kDegree = M_PI / 180;
/// By how much the corners of all pictures may be pulled outwards alike, as by a focal length that is not
/// quite the sensor model's. In simulated pictures it is some thousandths of a pixel.
constexpr double kCornersAlike_px = 0.02;

/// A board as the camera saw it at an instant.
struct Seen {
  BenchTime t;
  BoardView view;
  BoardPose pose;
};

struct Cloud {
  BenchTime t;
  std::vector<Eigen::Vector3d> points_m;
  std::vector<float> t_s{};  ///< of each point after t; empty: all at it
  float first_s = 0, last_s = 0;

  /// How far an instant lies outside of the scan.
  [[nodiscard]] double away_s(BenchTime at) const {
    const double after = 1e-9 * static_cast<double>((at - t).ns());
    return std::max({0.0, double{first_s} - after, after - double{last_s}});
  }
};

/// Optical axes (x right, y down, z forward) of what points forward, left, up.
Eigen::Matrix3d optical_from_forward() {
  Eigen::Matrix3d r;
  r << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  return r;
}

/// `optical`: the second sensor has the axes of a camera; else x forward.
Result<Eigen::Isometry3d> parse_rough(const std::string& text, bool optical) {
  std::array<double, 6> v{};
  char rest = 0;
  const int n =
      std::sscanf(text.c_str(), "%lf,%lf,%lf,%lf,%lf,%lf%c", &v[0], &v[1], &v[2], &v[3], &v[4], &v[5], &rest);
  const bool whole = n == 6 || (n == 3 && std::count(text.begin(), text.end(), ',') == 2);
  if (!whole)
    return fail(
        ErrorCode::bad_input, "--rough",
        "expected x,y,z[,roll,pitch,yaw]: where the second sensor is in the camera's optical frame (x "
        "right, y down, z forward) in metres, and how it is turned against looking the same way (roll to "
        "the right, pitch down, yaw to the left, degrees), as in 0.2,-0.1,0 or 0.2,-0.1,0,0,-8,0, got " +
            (text.empty() ? "nothing" : text));
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
  const Eigen::Matrix3d turn = (Eigen::AngleAxisd(v[5] * kDegree, Eigen::Vector3d::UnitZ()) *
                                Eigen::AngleAxisd(v[4] * kDegree, Eigen::Vector3d::UnitY()) *
                                Eigen::AngleAxisd(v[3] * kDegree, Eigen::Vector3d::UnitX()))
                                   .toRotationMatrix();
  T.linear() = optical_from_forward() * turn;
  if (optical) T.linear() = T.linear() * optical_from_forward().transpose();
  return T;
}

Result<std::vector<Seen>> boards_of(const ExtrinsicsCalibrationOptions& o, const std::filesystem::path& file,
                                    const Board& board, const CameraModel& camera, const StopToken& stop,
                                    std::vector<std::string>& warnings) {
  std::vector<Seen> seen;
  ProgressTask looking("look for boards", 0, "pictures");
  std::uint64_t looked = 0;
  Status bad;
  const auto read = read_samples(file, o.camera, SampleKind::image, [&](const Sample& sample) {
    const auto* info = sample.as<ImageInfo>();
    const auto grey = grey_picture(*info, sample.bytes());
    if (!grey) {
      bad = tl::unexpected<Error>(grey.error());
      return false;
    }
    ++looked;
    looking.set(static_cast<double>(looked));
    looking.note(fmt::format("{} found", seen.size()));
    const std::string name =
        fmt::format("{}#{}", o.camera.empty() ? "camera" : o.camera, sample.stamp.sequence);
    auto view = find_board(name, grey->data(), static_cast<int>(info->width_px),
                           static_cast<int>(info->height_px), board);
    if (!view) return !stop.stop_requested();
    const auto pose = pose_of_board(*view, camera);
    if (!pose) {
      bad = tl::unexpected<Error>(pose.error());
      return false;
    }
    seen.push_back({sample.stamp.t_capture, std::move(*view), *pose});
    return !stop.stop_requested();
  });
  looking.finish();
  if (!bad) return tl::unexpected<Error>(bad.error());
  if (!read) return tl::unexpected<Error>(read.error());
  warnings.insert(warnings.end(), read->warnings.begin(), read->warnings.end());
  if (seen.empty())
    return fail(ErrorCode::bad_input, file.string(),
                fmt::format("expected pictures of {} with a board {}, found none in {}", read->topic,
                            board.text(), read->samples));
  return seen;
}

Result<std::vector<Cloud>> clouds_of(const ExtrinsicsCalibrationOptions& o, const std::filesystem::path& file,
                                     std::vector<std::string>& warnings) {
  std::vector<Cloud> clouds;
  if (o.second_model_file.empty()) {
    const auto read = read_samples(file, o.second, SampleKind::point_cloud, [&](const Sample& sample) {
      Cloud c{sample.stamp.t_capture, {}};
      const auto bytes = sample.bytes();
      for (std::size_t i = 0; i + sizeof(LidarPoint) <= bytes.size(); i += sizeof(LidarPoint)) {
        LidarPoint p;
        std::memcpy(&p, bytes.data() + i, sizeof p);
        if (p.return_index != 0) continue;
        c.points_m.emplace_back(p.x_m, p.y_m, p.z_m);
        c.t_s.push_back(1e-9F * static_cast<float>(p.t_offset_ns));
        c.first_s = std::min(c.first_s, c.t_s.back()), c.last_s = std::max(c.last_s, c.t_s.back());
      }
      clouds.push_back(std::move(c));
      return true;
    });
    if (!read) return tl::unexpected<Error>(read.error());
    warnings.insert(warnings.end(), read->warnings.begin(), read->warnings.end());
    return clouds;
  }
  const auto model = load_tof_model(o.second_model_file);
  if (!model) return tl::unexpected<Error>(model.error());
  CameraModel lens;
  lens.width_px = static_cast<decltype(lens.width_px)>(model->width_px);
  lens.height_px = static_cast<decltype(lens.height_px)>(model->height_px);
  lens.fx_px = model->fx_px, lens.fy_px = model->fy_px, lens.cx_px = model->cx_px, lens.cy_px = model->cy_px;
  lens.lens = model->lens;
  std::vector<Eigen::Vector3d> rays;
  for (int v = 0; v < lens.height_px; ++v)
    for (int u = 0; u < lens.width_px; ++u) {
      const auto ray = unproject_ray(lens, {double(u), double(v)});
      rays.push_back(ray ? Eigen::Vector3d(ray->x, ray->y, ray->z).normalized()
                         : Eigen::Vector3d::Constant(NAN));
    }
  Status bad;
  const auto read = read_samples(file, o.second, SampleKind::range_image, [&](const Sample& sample) {
    const auto* info = sample.as<RangeImageInfo>();
    if (info->width_px != static_cast<std::uint32_t>(lens.width_px) ||
        info->height_px != static_cast<std::uint32_t>(lens.height_px)) {
      bad = fail(ErrorCode::bad_input, o.second_model_file.string(),
                 fmt::format("expected the recording's size {}x{}, got {}x{}", info->width_px,
                             info->height_px, lens.width_px, lens.height_px));
      return false;
    }
    Cloud c{sample.stamp.t_capture, {}};
    for (std::size_t i = 0; i < rays.size(); ++i) {
      float range = 0;
      std::memcpy(&range, sample.bytes().data() + 4 * i, 4);
      const Eigen::Vector3d p = double{range} * rays[i];
      if (p.allFinite()) c.points_m.push_back(p);
    }
    clouds.push_back(std::move(c));
    return true;
  });
  if (!bad) return tl::unexpected<Error>(bad.error());
  if (!read) return tl::unexpected<Error>(read.error());
  warnings.insert(warnings.end(), read->warnings.begin(), read->warnings.end());
  return clouds;
}

/// What is on the board of the scan whose points of it lie nearest in time to the picture; none: too few in
/// any of the three nearest scans, or these are more than half a second away.
std::optional<PlaneObservation> observation_of(const Seen& seen, const std::vector<Seen>& all,
                                               const std::vector<Cloud>& clouds, const Board& board,
                                               const Eigen::Isometry3d& T_camera_sensor, double margin_m,
                                               double outline_margin_m) {
  PlaneObservation s;
  s.name = seen.view.name;
  s.T_camera_board = seen.pose.T_camera_board;
  s.plane_covariance = seen.pose.plane_covariance;
  const auto seconds = [&](BenchTime t) { return 1e-9 * static_cast<double>((t - seen.t).ns()); };
  std::vector<BoardAt> around;
  for (const Seen& other : all)
    if (std::abs(seconds(other.t)) <= 0.15)
      around.push_back({seconds(other.t), other.pose.T_camera_board, other.pose.plane_covariance});
  const Eigen::Vector3d middle(0.5 * (board.columns - 1) * board.spacing_m,
                               0.5 * (board.rows - 1) * board.spacing_m, 0);
  set_rate(s, 0, around, middle);

  std::vector<const Cloud*> nearest;
  for (const Cloud& c : clouds)
    if (c.away_s(seen.t) <= 0.5) nearest.push_back(&c);
  const std::size_t few = std::min<std::size_t>(3, nearest.size());
  std::partial_sort(nearest.begin(), nearest.begin() + static_cast<std::ptrdiff_t>(few), nearest.end(),
                    [&](const Cloud* a, const Cloud* b) { return a->away_s(seen.t) < b->away_s(seen.t); });
  // Inner corners do not reach the board's edge: a square more on each side does.
  const Eigen::Isometry3d corner(Eigen::Translation3d(-board.spacing_m, -board.spacing_m, 0));
  double best_s = INFINITY;
  for (std::size_t k = 0; k < few; ++k) {
    const Cloud& c = *nearest[k];
    const auto on =
        points_on_board(c.points_m, seen.pose.T_camera_board * corner, T_camera_sensor,
                        {(board.columns + 1) * board.spacing_m, (board.rows + 1) * board.spacing_m}, margin_m,
                        outline_margin_m);
    if (on.empty()) continue;
    std::vector<double> t;
    double mean = 0;
    for (const std::size_t i : on) {
      t.push_back(seconds(c.t) + (c.t_s.empty() ? 0.0 : double{c.t_s[i]}));
      mean += t.back() / static_cast<double>(on.size());
    }
    if (std::abs(mean) >= best_s) continue;
    best_s = std::abs(mean);
    s.t_s = std::move(t);
    s.points_m.clear();
    for (const std::size_t i : on) s.points_m.push_back(c.points_m[i]);
  }
  if (s.points_m.empty()) return {};
  return s;
}

/// Boards whose middle stood still from the picture before or to the next; evenly `views` of them.
std::vector<PlaneObservation> observations_of(const ExtrinsicsCalibrationOptions& o,
                                              const std::vector<Seen>& seen, const std::vector<Cloud>& clouds,
                                              const Board& board, const Eigen::Isometry3d& T_camera_sensor,
                                              double margin_m, double outline_margin_m,
                                              std::vector<std::string>& warnings) {
  std::vector<std::size_t> still;
  int moving = 0;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const Eigen::Vector3d middle(0.5 * (board.columns - 1) * board.spacing_m,
                                 0.5 * (board.rows - 1) * board.spacing_m, 0);
    const auto at = [&](std::size_t k) { return Eigen::Vector3d(seen[k].pose.T_camera_board * middle); };
    const bool before = i == 0 || (at(i) - at(i - 1)).norm() <= o.still_m;
    const bool after = i + 1 == seen.size() || (at(i) - at(i + 1)).norm() <= o.still_m;
    if (before || after)
      still.push_back(i);
    else
      ++moving;
  }
  if (moving > 0)
    warnings.push_back(
        fmt::format("{} pictures were left out in which the board moved by more than {} mm; show it still, "
                    "for two pictures at least",
                    moving, o.still_m * 1000));
  std::vector<PlaneObservation> out;
  std::size_t without = 0;
  const std::size_t take = std::min<std::size_t>(still.size(), static_cast<std::size_t>(o.views));
  for (std::size_t k = 0; k < take; ++k) {
    const Seen& s = seen[still[take > 1 ? k * (still.size() - 1) / (take - 1) : 0]];
    auto observation = observation_of(s, seen, clouds, board, T_camera_sensor, margin_m, outline_margin_m);
    if (observation)
      out.push_back(std::move(*observation));
    else
      ++without;
  }
  if (without > 0)
    warnings.push_back(fmt::format(
        "{} views have fewer than 8 points of the second sensor on the board within half a second", without));
  return out;
}

}  // namespace

Result<CalibrationResult> calibrate_extrinsics(const ExtrinsicsCalibrationOptions& o, const StopToken& stop) {
  const auto board = parse_board(o.target);
  if (!board) return tl::unexpected<Error>(board.error());
  const auto rough = parse_rough(o.rough, !o.second_model_file.empty());
  if (!rough) return tl::unexpected<Error>(rough.error());
  const auto sensor_model = load_camera(o.camera_model_file);
  if (!sensor_model) return tl::unexpected<Error>(sensor_model.error());
  const auto files = input_files(o.inputs, {".mcap"});
  if (!files) return tl::unexpected<Error>(files.error());

  CalibrationResult result;
  result.title = "Where the second sensor sits";
  result.inputs = *files;
  struct Recorded {
    std::vector<Seen> seen;
    std::vector<Cloud> clouds;
  };
  std::vector<Recorded> recorded;
  std::vector<std::string> warnings;
  for (const auto& file : *files) {
    if (!recorded.empty() && stop.stop_requested()) break;
    auto seen = boards_of(o, file, *board, sensor_model->model, stop, warnings);
    if (!seen) return tl::unexpected<Error>(seen.error());
    auto clouds = clouds_of(o, file, warnings);
    if (!clouds) return tl::unexpected<Error>(clouds.error());
    recorded.push_back({std::move(*seen), std::move(*clouds)});
  }
  // Corners that are all shifted outwards make the board look larger, and nearer by the same ratio.
  double squares_px2 = 0, corners = 0;
  for (const Recorded& r : recorded)
    for (const Seen& s : r.seen) {
      const auto n = static_cast<double>(s.view.points.size());
      double u = 0, v = 0;
      for (const BoardPoint& c : s.view.points) u += c.u_px / n, v += c.v_px / n;
      for (const BoardPoint& c : s.view.points)
        squares_px2 += (c.u_px - u) * (c.u_px - u) + (c.v_px - v) * (c.v_px - v);
      corners += n;
    }
  PlaneExtrinsicsOptions options;
  options.camera_scale_sigma = kCornersAlike_px / std::sqrt(squares_px2 / corners);
  options.sigma_point_m = o.sigma_m;
  options.start = *rough;
  options.stop = stop;
  std::vector<PlaneObservation> observations;
  Result<PlaneExtrinsics> fit = fail(ErrorCode::internal, "extrinsics", "");
  // First with all that may be on the board by the rough mount; that may hold the floor before it and the
  // wall behind it, in one line with the board. Then, with a mount that is nearly right, only what is well
  // inside.
  for (const bool again : {false, true}) {
    std::vector<std::string> said;
    observations.clear();
    for (const Recorded& r : recorded) {
      auto more = again ? observations_of(o, r.seen, r.clouds, *board, fit->T_camera_sensor, 0.5 * o.margin_m,
                                          -0.4 * board->spacing_m, said)
                        : observations_of(o, r.seen, r.clouds, *board, *rough, o.margin_m, o.margin_m, said);
      observations.insert(observations.end(), std::make_move_iterator(more.begin()),
                          std::make_move_iterator(more.end()));
    }
    if (observations.empty())
      return fail(
          ErrorCode::bad_input, files->front().string(),
          fmt::format("expected points of the second sensor on the board within {} m of where --rough "
                      "puts them, found none; check --rough, or give another --margin",
                      o.margin_m));
    fit = fit_plane_extrinsics(observations, options);
    if (!fit) return tl::unexpected<Error>(fit.error());
    options.start = fit->T_camera_sensor;
    if (again) warnings.insert(warnings.end(), said.begin(), said.end());
  }
  result.fit = std::move(fit->result);
  result.fit.warnings.insert(result.fit.warnings.end(), warnings.begin(), warnings.end());
  result.fit.interrupted = result.fit.interrupted || stop.stop_requested();
  const Eigen::Vector3d t = fit->T_camera_sensor.translation();
  const Eigen::Quaterniond q(fit->T_camera_sensor.linear());
  const std::string sensor = o.second_model_file.empty() ? "lidar" : "tof", T = "T_camera_" + sensor;
  result.recipe.kind = "extrinsics";
  result.recipe.set = {
      {"camera", o.camera.empty() ? "camera" : o.camera},
      {sensor, o.second.empty() ? sensor : o.second},
      {T + ".position_m",
       fmt::format("[{}, {}, {}]", exact_text(t.x()), exact_text(t.y()), exact_text(t.z()))},
      {T + ".quaternion_wxyz", fmt::format("[{}, {}, {}, {}]", exact_text(q.w()), exact_text(q.x()),
                                           exact_text(q.y()), exact_text(q.z()))}};
  result.details.json() = {{"views", observations.size()},
                           {"sigma_point_m", fit->sigma_point_m},
                           {"plane_scale", fit->plane_scale},
                           {"position_m", {t.x(), t.y(), t.z()}},
                           {"quaternion_wxyz", {q.w(), q.x(), q.y(), q.z()}}};
  Figure views{
      .kind = Figure::Kind::series,
      .title = "Distance of the points from the board",
      .caption =
          "Mean and RMS over the points of each view. A mean that is not zero is a bias of the second "
          "sensor, or a board that is not flat.",
      .x_label = "view",
      .y_label = "m"};
  Series mean{"mean", {}, {}, false}, rms{"RMS", {}, {}, false}, all;
  for (std::size_t v = 0; v < observations.size(); ++v) {
    mean.x.push_back(static_cast<double>(v)), mean.y.push_back(fit->view_mean_m[v]);
    rms.x.push_back(static_cast<double>(v)), rms.y.push_back(fit->view_rms_m[v]);
    for (std::size_t i = 0; i < observations[v].points_m.size(); ++i)
      all.y.push_back(
          (T_board_camera_at(observations[v], i) * (fit->T_camera_sensor * observations[v].points_m[i])).z());
  }
  views.series = {mean, rms};
  result.figures.push_back(views);
  Figure histogram{.kind = Figure::Kind::histogram,
                   .title = "Distances from the planes",
                   .caption = "Of all points.",
                   .x_label = "m",
                   .y_label = "number"};
  histogram.series = {all};
  result.figures.push_back(histogram);
  Figure quantiles{.kind = Figure::Kind::quantiles, .title = "Q–Q plot", .caption = "Of the same distances."};
  quantiles.series = {all};
  result.figures.push_back(quantiles);
  for (const auto& w : result.fit.weak) result.record_next.push_back(w.cure);
  result.base = o.base;
  return result;
}

}  // namespace rigor
