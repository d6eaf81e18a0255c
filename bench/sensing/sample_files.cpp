#include "bench/sensing/sample_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "bench/files/output_file.h"
#include "bench/files/picture_file.h"

namespace rigor {
namespace {

/// 1, 2 or 5 times a power of ten, not below x; 1 where there is nothing.
double round_up(double x) {
  if (!(x > 0) || !std::isfinite(x)) return 1;
  const double power = std::pow(10.0, std::floor(std::log10(x)));
  for (const double step : {1.0, 2.0, 5.0})
    if (step * power >= x * (1 - 1e-9)) return step * power;
  return 10 * power;
}

double quantile(std::vector<float>& values, double q) {
  if (values.empty()) return 0;
  const auto at = static_cast<std::ptrdiff_t>(q * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + at, values.end());
  return values[static_cast<std::size_t>(at)];
}

/// Google's Turbo by OpenCV, 256 colours in BGR.
const std::vector<cv::Vec3b>& turbo() {
  static const std::vector<cv::Vec3b> colours = [] {
    cv::Mat ramp(1, 256, CV_8U), out;
    for (int i = 0; i < 256; ++i) ramp.at<std::uint8_t>(0, i) = static_cast<std::uint8_t>(i);
    cv::applyColorMap(ramp, out, cv::COLORMAP_TURBO);
    return std::vector<cv::Vec3b>(out.begin<cv::Vec3b>(), out.end<cv::Vec3b>());
  }();
  return colours;
}
cv::Vec3b colour_of(double share) {
  return turbo()[static_cast<std::size_t>(std::lround(std::clamp(share, 0.0, 1.0) * 255))];
}

Status write_png(const std::filesystem::path& file, const cv::Mat& picture) {
  std::vector<std::uint8_t> bytes;
  try {
    if (!cv::imencode(
            ".png", picture, bytes,
            {cv::IMWRITE_PNG_COMPRESSION, 9, cv::IMWRITE_PNG_STRATEGY, cv::IMWRITE_PNG_STRATEGY_DEFAULT}))
      return fail(ErrorCode::internal, file.string(), "the picture cannot be made a PNG");
  } catch (const cv::Exception& e) {
    return fail(ErrorCode::internal, file.string(), e.what());
  }
  return write_output(file, std::string_view(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
}

Status write_planes(const std::filesystem::path& file, std::uint32_t width, std::uint32_t height,
                    const std::vector<ExrPlane>& planes, const std::string& class_names = {}) {
  const auto bytes = exr_bytes(width, height, planes, class_names);
  if (!bytes) return tl::unexpected<Error>(bytes.error());
  return write_output(file, *bytes);
}

Status write_pcd(const std::filesystem::path& file, const std::string& fields, std::size_t width,
                 std::size_t height, const std::string& bytes) {
  return write_output(
      file, "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n" + fields +
                fmt::format("WIDTH {}\nHEIGHT {}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {}\nDATA binary\n", width,
                            height, width * height) +
                bytes);
}

template <class T>
void append(std::string& bytes, const T& value) {
  const std::size_t at = bytes.size();
  bytes.resize(at + sizeof value);
  std::memcpy(bytes.data() + at, &value, sizeof value);
}

double range_of(const LidarPoint& p) { return std::hypot(p.x_m, p.y_m, p.z_m); }

/// Remission over what nearly all points stay below.
double remission_scale(std::span<const LidarPoint> points) {
  std::vector<float> remissions;
  for (const LidarPoint& p : points)
    if (std::isfinite(p.remission)) remissions.push_back(p.remission);
  const double top = quantile(remissions, 0.98);
  return top > 0 ? 1 / top : 1;
}

cv::Mat from_above(std::span<const LidarPoint> points, double half_m, double remission) {
  constexpr int kSize = 900;
  cv::Mat picture(kSize, kSize, CV_8UC3, cv::Scalar(16, 16, 16));
  const cv::Point centre(kSize / 2, kSize / 2);
  const double px_per_m = kSize / 2 / half_m;
  for (int k = 1; k <= 5; ++k)
    cv::circle(picture, centre, static_cast<int>(std::lround(kSize / 10.0 * k)), cv::Scalar(52, 52, 52), 1,
               cv::LINE_AA);
  cv::line(picture, centre, {kSize / 2, kSize / 2 - 20}, cv::Scalar(160, 160, 160), 1, cv::LINE_AA);
  for (const LidarPoint& p : points) {
    const auto x = std::lround(kSize / 2 - double{p.y_m} * px_per_m);
    const auto y = std::lround(kSize / 2 - double{p.x_m} * px_per_m);
    if (x < 1 || y < 1 || x >= kSize - 1 || y >= kSize - 1) continue;
    const cv::Vec3b c = colour_of(0.08 + 0.9 * double{p.remission} * remission);
    const int cx = static_cast<int>(x), cy = static_cast<int>(y);
    picture.at<cv::Vec3b>(cy, cx) = c;
    picture.at<cv::Vec3b>(cy, cx + 1) = c;
    picture.at<cv::Vec3b>(cy + 1, cx) = c;
    picture.at<cv::Vec3b>(cy + 1, cx + 1) = c;
  }
  return picture;
}

/// From one firing of a beam to its next, as most are; 0 where no beam has two.
double firing_step_rad(std::span<const LidarPoint> points, std::size_t beams) {
  std::vector<double> last(beams, std::numeric_limits<double>::quiet_NaN());
  std::vector<float> steps;
  for (const LidarPoint& p : points) {
    const double azimuth = std::atan2(double{p.y_m}, double{p.x_m});
    const double step = std::abs(std::remainder(azimuth - last[p.ring], 2 * std::numbers::pi));
    if (step > 1e-6) steps.push_back(static_cast<float>(step));
    last[p.ring] = azimuth;
  }
  return quantile(steps, 0.5);
}

/// Beams over azimuth, the highest beam on top, straight ahead in the middle.
cv::Mat panorama(std::span<const LidarPoint> points, double half_m, double remission, int width) {
  struct Beam {
    double slope_sum = 0;
    int count = 0;
  };
  std::vector<Beam> beams;
  for (const LidarPoint& p : points) {
    if (p.ring >= beams.size()) beams.resize(p.ring + 1U);
    beams[p.ring].slope_sum += std::atan2(double{p.z_m}, std::hypot(p.x_m, p.y_m));
    ++beams[p.ring].count;
  }
  std::vector<std::size_t> order;
  for (std::size_t i = 0; i < beams.size(); ++i)
    if (beams[i].count > 0) order.push_back(i);
  if (order.size() < 2) return {};
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return beams[a].slope_sum / beams[a].count > beams[b].slope_sum / beams[b].count;
  });
  std::vector<int> row_of(beams.size(), 0);
  for (std::size_t i = 0; i < order.size(); ++i) row_of[order[i]] = static_cast<int>(i);
  const int rows = static_cast<int>(order.size());
  // Each firing as wide as its step, or firings that fall between columns of the picture leave stripes.
  const double firing_px =
      std::min(firing_step_rad(points, beams.size()) / (2 * std::numbers::pi), 0.02) * width;
  cv::Mat ranges(rows, width, CV_8UC3, cv::Scalar(0, 0, 0)), grey = ranges.clone();
  for (const LidarPoint& p : points) {
    const double share = 0.5 - std::atan2(double{p.y_m}, double{p.x_m}) / (2 * std::numbers::pi);
    const int first = std::clamp(static_cast<int>(share * width - firing_px / 2), 0, width - 1);
    const int end = std::clamp(static_cast<int>(std::ceil(share * width + firing_px / 2)), first + 1, width);
    const auto g = cv::saturate_cast<std::uint8_t>(30 + 225 * double{p.remission} * remission);
    for (int u = first; u < end; ++u) {
      ranges.at<cv::Vec3b>(row_of[p.ring], u) = colour_of(range_of(p) / half_m);
      grey.at<cv::Vec3b>(row_of[p.ring], u) = cv::Vec3b(g, g, g);
    }
  }
  const int scale = std::max(1, 180 / rows);
  cv::Mat both;
  cv::vconcat(std::vector<cv::Mat>{ranges, cv::Mat(1, width, CV_8UC3, cv::Scalar(90, 90, 90)), grey}, both);
  cv::resize(both, both, {}, 1, scale, cv::INTER_NEAREST);
  return both;
}

}  // namespace

Status write_range_png(const std::filesystem::path& file, const RangePicture& picture, double& full_scale_m) {
  std::vector<float> ranges;
  for (const float r : picture.range_m)
    if (std::isfinite(r)) ranges.push_back(r);
  full_scale_m = round_up(quantile(ranges, 0.98));
  cv::Mat out(static_cast<int>(picture.height_px), static_cast<int>(picture.width_px), CV_8UC3);
  std::size_t i = 0;
  for (auto it = out.begin<cv::Vec3b>(); it != out.end<cv::Vec3b>(); ++it, ++i)
    *it = std::isfinite(picture.range_m[i]) ? colour_of(double{picture.range_m[i]} / full_scale_m)
                                            : cv::Vec3b(0, 0, 0);
  return write_png(file, out);
}

Status write_difference_png(const std::filesystem::path& file, const RangePicture& picture,
                            double& full_scale_m) {
  std::vector<float> sizes;
  for (const float r : picture.range_m)
    if (std::isfinite(r)) sizes.push_back(std::abs(r));
  full_scale_m = round_up(quantile(sizes, 0.95));
  cv::Mat out(static_cast<int>(picture.height_px), static_cast<int>(picture.width_px), CV_8UC3);
  std::size_t i = 0;
  for (auto it = out.begin<cv::Vec3b>(); it != out.end<cv::Vec3b>(); ++it, ++i) {
    const double share = double{picture.range_m[i]} / full_scale_m;
    if (!std::isfinite(share)) {
      *it = {0, 0, 0};
      continue;
    }
    const auto pale = static_cast<std::uint8_t>(std::lround(255 * (1 - std::min(std::abs(share), 1.0))));
    *it = share < 0 ? cv::Vec3b(255, pale, pale) : cv::Vec3b(pale, pale, 255);
  }
  return write_png(file, out);
}

Status write_range_exr(const std::filesystem::path& file, const RangePicture& picture) {
  std::vector<ExrPlane> planes{{"range", false, picture.range_m.data()}};
  if (!picture.amplitude.empty()) planes.push_back({"amplitude", false, picture.amplitude.data()});
  return write_planes(file, picture.width_px, picture.height_px, planes);
}

Status write_range_pcd(const std::filesystem::path& file, const RangePicture& picture,
                       std::span<const std::array<float, 3>> directions) {
  std::string bytes;
  for (std::size_t i = 0; i < picture.range_m.size(); ++i) {
    for (const float d : directions[i]) append(bytes, picture.range_m[i] * d);
    append(bytes, picture.amplitude.empty() ? 0.0F : picture.amplitude[i]);
  }
  return write_pcd(file, "FIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n",
                   picture.width_px, picture.height_px, bytes);
}

Status write_points_png(const std::filesystem::path& file, std::span<const LidarPoint> points,
                        double& full_scale_m) {
  std::vector<float> extent;
  for (const LidarPoint& p : points) extent.push_back(std::hypot(p.x_m, p.y_m));
  full_scale_m = round_up(quantile(extent, 0.98));
  const double remission = remission_scale(points);
  cv::Mat picture = from_above(points, full_scale_m, remission);
  if (const cv::Mat strip = panorama(points, full_scale_m, remission, picture.cols); !strip.empty())
    cv::vconcat(std::vector<cv::Mat>{picture, strip}, picture);
  return write_png(file, picture);
}

Status write_points_pcd(const std::filesystem::path& file, std::span<const LidarPoint> points) {
  std::string bytes;
  for (const LidarPoint& p : points) {
    append(bytes, p.x_m);
    append(bytes, p.y_m);
    append(bytes, p.z_m);
    append(bytes, p.remission);
    append(bytes, p.t_offset_ns);
    append(bytes, p.ring);
    append(bytes, p.return_index);
  }
  return write_pcd(
      file,
      "FIELDS x y z intensity t ring return\nSIZE 4 4 4 4 4 2 1\nTYPE F F F F I U U\nCOUNT 1 1 1 "
      "1 1 1 1\n",
      points.size(), 1, bytes);
}

Status write_truth(const std::filesystem::path& file, const GroundTruth& truth) {
  const std::size_t n = std::size_t{truth.width} * truth.height;
  if (n == 0 || truth.node.size() != n || truth.range_m.size() != n || truth.class_index.size() != n ||
      truth.normal.size() != 3 * n)
    return fail(ErrorCode::bad_input, file.string(),
                "expected a sample with elements to write the truth of, got none");
  // Ids count up from 1: those of a world that needs more than 32 bits are told by their low ones.
  std::vector<std::uint32_t> node(truth.node.begin(), truth.node.end());
  for (std::size_t i = 0; i < n; ++i) node[i] = static_cast<std::uint32_t>(truth.node[i]);
  const std::vector<std::uint32_t> classes(truth.class_index.begin(), truth.class_index.end());
  std::string names;
  for (std::size_t i = 0; i < truth.class_names.size(); ++i)
    names += fmt::format("{} {}\n", i, truth.class_names[i]);
  std::vector<ExrPlane> planes{
      {"node", true, node.data()}, {"class", true, classes.data()}, {"range", false, truth.range_m.data()}};
  for (std::size_t k = 0; k < 3; ++k)
    planes.push_back({fmt::format("normal.{}", "XYZ"[k]), false, truth.normal.data() + k, 12});
  if (truth.flow_px.size() == 2 * n)
    for (std::size_t k = 0; k < 2; ++k)
      planes.push_back({fmt::format("flow.{}", "XY"[k]), false, truth.flow_px.data() + k, 8});
  return write_planes(file, truth.width, truth.height, planes, names);
}

}  // namespace rigor
