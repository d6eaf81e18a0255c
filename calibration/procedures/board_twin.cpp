#include "calibration/procedures/board_twin.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

namespace rigor {
namespace {

using namespace calibration;

constexpr double kBlur_px = 0.7;  // standard deviation: of a lens in focus and a pixel's own width
constexpr int kSide = 8;          // samples along each side of a pixel that an edge runs through

double median(std::vector<double> v) {
  if (v.empty()) return 0;
  const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
  std::nth_element(v.begin(), middle, v.end());
  return *middle;
}

/// Brightness and noise in the middle of the squares: those that four neighbouring corners enclose.
bool levels_of(const BoardView& view, const Board& board, double& black, double& white, double& noise) {
  if (board.kind != BoardKind::chessboard) return false;
  const cv::Mat picture = cv::imread(view.name, cv::IMREAD_GRAYSCALE);
  if (picture.empty() || picture.cols != view.width_px || picture.rows != view.height_px) return false;
  const auto corner = [&](int column, int row) -> const BoardPoint* {
    for (const BoardPoint& p : view.points)
      if (p.column == column && p.row == row) return &p;
    return nullptr;
  };
  std::vector<double> level[2], deviation;
  for (int row = 0; row + 1 < board.rows; ++row)
    for (int column = 0; column + 1 < board.columns; ++column) {
      const BoardPoint* c[4] = {corner(column, row), corner(column + 1, row), corner(column, row + 1),
                                corner(column + 1, row + 1)};
      double u = 0, v = 0;
      bool all = true;
      for (const BoardPoint* p : c) {
        all = all && p != nullptr;
        if (p != nullptr) u += p->u_px / 4, v += p->v_px / 4;
      }
      const int x = static_cast<int>(std::lround(u)), y = static_cast<int>(std::lround(v));
      if (!all || x < 2 || y < 2 || x >= picture.cols - 2 || y >= picture.rows - 2) continue;
      std::vector<double> patch;
      for (int i = -1; i <= 1; ++i)
        for (int k = -1; k <= 1; ++k) patch.push_back(picture.at<std::uint8_t>(y + i, x + k));
      const double middle = median(patch);
      level[(column + row) % 2].push_back(middle);
      for (const double p : patch) deviation.push_back(std::abs(p - middle));
    }
  if (level[0].empty() || level[1].empty()) return false;
  const double a = median(level[0]), b = median(level[1]);
  black = std::min(a, b), white = std::max(a, b);
  noise = 1.4826 * median(deviation);
  return white - black > 10;
}

}  // namespace

Result<BoardTwin> simulate_board_twin(const CameraFit& fit, const std::vector<BoardView>& views,
                                      const Board& board, StopToken stop) {
  if (board.kind == BoardKind::charuco)
    return fail(ErrorCode::bad_input, "--twin",
                "expected a chessboard or circles, got a ChArUco board: its markers are not drawn");
  BoardTwin twin;
  std::vector<double> blacks, whites, noises;
  for (const BoardView& view : views) {
    double black = 0, white = 0, noise = 0;
    if (!levels_of(view, board, black, white, noise)) continue;
    blacks.push_back(black), whites.push_back(white), noises.push_back(noise);
  }
  twin.measured = !blacks.empty();
  twin.black_dn = twin.measured ? median(blacks) : 40;
  twin.white_dn = twin.measured ? median(whites) : 200;
  // A median of whole numbers is blind below one: rounding alone is then at least that of 8 bits.
  twin.noise_dn = std::max(twin.measured ? median(noises) : 2, 0.5);

  const int w = fit.camera.width_px, h = fit.camera.height_px;
  // Rays through the pixels' corners: a pixel whose corners see one colour is of that colour, and in the
  // others places on the board are interpolated.
  std::vector<Eigen::Vector3d> rays;
  rays.reserve(static_cast<std::size_t>((w + 1) * (h + 1)));
  for (int v = 0; v <= h; ++v)
    for (int u = 0; u <= w; ++u) {
      const auto ray = unproject_ray(fit.camera, {u - 0.5, v - 0.5});
      rays.push_back(ray ? Eigen::Vector3d(ray->x, ray->y, ray->z) : Eigen::Vector3d::Zero());
    }
  std::mt19937 random(1);
  std::normal_distribution<double> noise(0, twin.noise_dn);
  std::vector<BoardView> found;
  for (std::size_t k = 0; k < views.size() && !stop.stop_requested(); ++k) {
    if (views[k].points.empty()) continue;
    const Eigen::Isometry3d& T = fit.T_camera_board[k];
    const Eigen::Vector3d normal = T.linear().col(2), origin = T.translation();
    const Eigen::Matrix3d back = T.linear().transpose();
    std::vector<Eigen::Vector2d> place;  // on the board; NaN: the ray misses its plane
    place.reserve(rays.size());
    for (const Eigen::Vector3d& ray : rays) {
      const double t = normal.dot(origin) / normal.dot(ray);
      place.push_back(t > 0 && std::isfinite(t)
                          ? Eigen::Vector2d((back * (t * ray - origin)).head<2>())
                          : Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN()));
    }
    const auto bright = [&](const Eigen::Vector2d& p) {
      return std::isfinite(p.x()) ? board_brightness(board, p.x(), p.y()) : 0.5;
    };
    cv::Mat light(h, w, CV_32F);
    for (int v = 0; v < h; ++v)
      for (int u = 0; u < w; ++u) {
        const std::size_t at = static_cast<std::size_t>(v * (w + 1) + u),
                          below = at + static_cast<std::size_t>(w) + 1;
        const Eigen::Vector2d &a = place[at], &b = place[at + 1], &c = place[below], &d = place[below + 1];
        double sum = bright(a);
        if (bright(b) != sum || bright(c) != sum || bright(d) != sum) {
          sum = 0;
          for (int i = 0; i < kSide * kSide; ++i) {
            const double x = (i % kSide + 0.5) / kSide, y = (i / kSide + 0.5) / kSide;
            sum += bright((1 - y) * ((1 - x) * a + x * b) + y * ((1 - x) * c + x * d)) / (kSide * kSide);
          }
        }
        light.at<float>(v, u) = static_cast<float>(twin.black_dn + (twin.white_dn - twin.black_dn) * sum);
      }
    cv::GaussianBlur(light, light, {}, kBlur_px);
    std::vector<std::uint8_t> grey(static_cast<std::size_t>(w) * static_cast<std::size_t>(h));
    for (int v = 0; v < h; ++v)
      for (int u = 0; u < w; ++u)
        grey[static_cast<std::size_t>(v * w + u)] = static_cast<std::uint8_t>(
            std::lround(std::clamp(light.at<float>(v, u) + noise(random), 0.0, 255.0)));
    auto view = find_board("twin of " + views[k].name, grey.data(), w, h, board);
    if (view) found.push_back(std::move(*view));
  }
  twin.views = found.size();
  auto again = fit_camera(found, {.models = {fit.lens_model}, .stop = stop});
  if (!again) return tl::unexpected<Error>(again.error());
  twin.fit = std::move(*again);
  return twin;
}

std::vector<Figure> twin_figures(const CameraFit& real, const BoardTwin& twin) {
  std::vector<double> scalars[2];
  const CameraFit* fits[2] = {&real, &twin.fit};
  for (std::size_t i = 0; i < 2; ++i) {
    for (const auto& r : fits[i]->residuals)
      if (r.used) scalars[i].push_back(r.du_px), scalars[i].push_back(r.dv_px);
    std::sort(scalars[i].begin(), scalars[i].end());
  }
  const auto at = [](const std::vector<double>& v, double q) {
    return v[std::min(v.size() - 1, static_cast<std::size_t>(q * static_cast<double>(v.size())))];
  };
  if (scalars[0].empty() || scalars[1].empty()) return {};
  const std::string how = fmt::format(
      "The twin's pictures are drawn through the fitted lens from the fitted poses (black {:.0f}, white "
      "{:.0f}, "
      "noise {:.1f} DN, {}; blur 0.7 px, assumed), and corners are found and fitted in them as in the real "
      "ones: "
      "RMS {:.3f} px a corner against {:.3f} px in the data.",
      twin.black_dn, twin.white_dn, twin.noise_dn, twin.measured ? "measured in the squares" : "assumed",
      twin.fit.rms_per_corner_px, real.rms_per_corner_px);
  Figure histogram{.kind = Figure::Kind::series,
                   .title = "Residuals beside those of the simulated twin",
                   .caption = how + " What the data have more is not in the model.",
                   .x_label = "residual [px]",
                   .y_label = "share of the residuals a bin"};
  const double end = std::max(std::abs(at(scalars[0], 0.003)), std::abs(at(scalars[0], 0.997)));
  constexpr int kBins = 40;
  for (std::size_t i = 0; i < 2; ++i) {
    Series s{i == 0 ? "data" : "twin", {}, {}, true};
    std::vector<double> share(kBins, 0);
    for (const double r : scalars[i])
      if (std::abs(r) < end)
        share[static_cast<std::size_t>((r + end) / (2 * end) * kBins)] +=
            1 / static_cast<double>(scalars[i].size());
    for (int b = 0; b < kBins; ++b)
      for (const int edge : {b, b + 1}) {
        s.x.push_back(-end + 2 * end * edge / kBins);
        s.y.push_back(share[static_cast<std::size_t>(b)]);
      }
    histogram.series.push_back(std::move(s));
  }
  Figure quantiles{.kind = Figure::Kind::series,
                   .title = "Quantiles of the residuals, data against twin",
                   .caption = "On the line both are distributed alike.",
                   .x_label = "twin [px]",
                   .y_label = "data [px]"};
  Series points{"1 % to 99 %", {}, {}, false}, line{"equal", {}, {}, true};
  for (int q = 1; q < 100; ++q) {
    points.x.push_back(at(scalars[1], q / 100.0));
    points.y.push_back(at(scalars[0], q / 100.0));
  }
  line.x = {points.x.front(), points.x.back()};
  line.y = line.x;
  quantiles.series = {points, line};
  return {histogram, quantiles};
}

}  // namespace rigor
