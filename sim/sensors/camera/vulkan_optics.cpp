#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/sensors/camera/depth_blur.h"
#include "sim/sensors/camera/exposure_timing.h"
#include "sim/sensors/camera/ground_truth.h"
#include "sim/sensors/camera/lens_grid.h"
#include "sim/sensors/camera/lens_views.h"
#include "sim/sensors/camera/thin_lens.h"

namespace rigor {
namespace {

/// Radii beyond this share of what is infinitely far away belong to things very near: they may be cut.
double largest_radius_px(const ThinLens& lens) {
  return 0.5 * std::max(lens.diameter_at_far_px, lens.diameter_px(lens.focus_m / 3));
}

/// When views are drawn during a window, and what each is worth to a row.
class ViewInstants {
 public:
  ViewInstants(const CameraModel& camera, const ExposureTiming& timing, int count)
      : count_(timing.one_instant() ? 1 : std::max(count, 1)), rolling_(camera.shutter.line_time_s > 0) {
    if (rolling_ && count_ == 1 && !timing.one_instant()) count_ = 2;
  }
  [[nodiscard]] int count() const { return count_; }
  /// Share of the window: rolling shutters need its ends, an exposure that is everywhere the same the middles
  /// of equal parts.
  [[nodiscard]] double at(int i) const {
    if (count_ == 1) return 0.5;
    return rolling_ ? static_cast<double>(i) / (count_ - 1) : (i + 0.5) / count_;
  }
  /// Weights of all views for an exposure around `middle`; linear between views.
  void weights(double middle, double exposure, std::vector<float>& out) const {
    out.assign(static_cast<std::size_t>(count_), 0.0F);
    if (count_ == 1 || !rolling_) {
      std::fill(out.begin(), out.end(), 1.0F / static_cast<float>(count_));
      return;
    }
    const int segments = count_ - 1;
    const double from = std::clamp(middle - 0.5 * exposure, 0.0, 1.0) * segments,
                 to = std::clamp(middle + 0.5 * exposure, 0.0, 1.0) * segments;
    if (!(to - from > 1e-9)) {
      const int i = std::min(static_cast<int>(from), segments - 1);
      out[static_cast<std::size_t>(i)] = static_cast<float>(1 - (from - i));
      out[static_cast<std::size_t>(i + 1)] = static_cast<float>(from - i);
      return;
    }
    for (int i = 0; i < segments; ++i) {
      const double a = std::clamp(from - i, 0.0, 1.0), b = std::clamp(to - i, 0.0, 1.0);
      if (!(b > a)) continue;
      const double right = 0.5 * (b * b - a * a) / (to - from), all = (b - a) / (to - from);
      out[static_cast<std::size_t>(i)] += static_cast<float>(all - right);
      out[static_cast<std::size_t>(i + 1)] += static_cast<float>(right);
    }
  }

 private:
  int count_;
  bool rolling_;
};

class VulkanOptics final : public CameraOpticsPicture {
 public:
  VulkanOptics(const CameraModel& camera, const OpticsOptions& options,
               std::shared_ptr<render::ViewRenderer> renderer, LensViews views, std::vector<ThinLens> lenses,
               int border_px)
      : camera_(camera),
        options_(options),
        renderer_(std::move(renderer)),
        views_(std::move(views)),
        lenses_(std::move(lenses)),
        border_px_(border_px) {}
  [[nodiscard]] std::string_view engine() const override { return "raster"; }
  [[nodiscard]] Status form(const OpticsRequest& request, const render::SensorView& view, OpticsPicture& out,
                            GroundTruth* truth) override;

 private:
  [[nodiscard]] bool blurs() const { return border_px_ > 0; }
  [[nodiscard]] render::ContentQuery query(const SensorMotion& motion) const;
  Status draw(const render::ContentFrame& frame, const Eigen::Isometry3d& T_world_sensor, BenchTime t,
              LensViews::Rows rows);
  void add(const OpticsRequest::Region& region, const std::vector<float>& weight_of_row,
           const std::vector<char>& takes_depth);
  Status measure(const OpticsRequest::Region& region, const ExposureTiming& timing,
                 const SensorMotion& motion, const std::shared_ptr<const render::ContentWindow>& window,
                 const render::SensorView& view, GroundTruth& truth);

  CameraModel camera_;
  OpticsOptions options_;
  std::shared_ptr<render::ViewRenderer> renderer_;
  LensViews views_;
  std::vector<ThinLens> lenses_;  ///< one, or one for each of red, green, blue
  int border_px_;
  // The last views drawn, one after the other.
  std::vector<float> radiance_, depth_;
  render::ViewPicture picture_;
  BlurPicture sharp_;  ///< on the sensor with its border
  std::vector<float> depth_of_pixel_;
  std::unique_ptr<LensGrid> truth_lens_;
  std::shared_ptr<render::EmbreeEngine> truth_engine_;
};

render::ContentQuery VulkanOptics::query(const SensorMotion& motion) const {
  render::ViewRequest request;
  request.pinhole = views_.views().front().pinhole;
  request.allowed_error_px = options_.allowed_error_px;
  request.switches.shadows = options_.shadows;
  request.T_world_camera = motion.at(0.5);
  request.T_world_camera.linear() *= views_.views().front().R_sensor_view;
  auto q = render::ViewRenderer::query_for(request);
  if (views_.views().size() > 1 || !motion.still()) q.frustum.clear();
  return q;
}

Status VulkanOptics::draw(const render::ContentFrame& frame, const Eigen::Isometry3d& T_world_sensor,
                          BenchTime t, LensViews::Rows rows) {
  radiance_.resize(4 * views_.pixels());
  if (blurs()) depth_.resize(views_.pixels());
  for (const LensView& v : views_.views()) {
    render::ViewRequest request;
    request.T_world_camera = T_world_sensor;
    request.T_world_camera.linear() *= v.R_sensor_view;
    request.pinhole = v.pinhole;
    const int first = std::clamp(rows.first, 0, v.pinhole.height_px - 1),
              last = std::clamp(rows.last, first + 1, v.pinhole.height_px);
    request.pinhole.cy_px -= first;
    request.pinhole.height_px = last - first;
    request.t = t;
    request.allowed_error_px = options_.allowed_error_px;
    request.samples = options_.view_samples;
    request.switches.shadows = options_.shadows;
    if (auto s = renderer_->draw(frame, request, picture_); !s) return s;
    const std::size_t offset =
        v.first + static_cast<std::size_t>(first) * static_cast<std::size_t>(v.pinhole.width_px);
    std::copy(picture_.radiance.begin(), picture_.radiance.end(),
              radiance_.begin() + static_cast<std::ptrdiff_t>(4 * offset));
    if (blurs())
      std::copy(picture_.depth_m.begin(), picture_.depth_m.end(),
                depth_.begin() + static_cast<std::ptrdiff_t>(offset));
  }
  return {};
}

void VulkanOptics::add(const OpticsRequest::Region& region, const std::vector<float>& weight_of_row,
                       const std::vector<char>& takes_depth) {
  const auto& maps = views_.maps();
  const LensGrid& grid = views_.grids()[maps.size() > 1 ? 1 : 0];
  const bool split = maps.size() > 1;
  std::vector<Eigen::Vector3f> axis;
  for (const LensView& v : views_.views()) axis.emplace_back(v.R_sensor_view.col(2).cast<float>());
  tbb::parallel_for(0, sharp_.height_px, [&](int y) {
    const float weight = weight_of_row[static_cast<std::size_t>(y)];
    const bool depth = takes_depth[static_cast<std::size_t>(y)] != 0;
    if (weight == 0 && !depth) return;
    for (int x = 0; x < sharp_.width_px; ++x) {
      const std::size_t cell =
          static_cast<std::size_t>(region.y_px + y) * static_cast<std::size_t>(grid.width_px()) +
          static_cast<std::size_t>(region.x_px + x);
      const std::size_t pixel = static_cast<std::size_t>(y) * static_cast<std::size_t>(sharp_.width_px) +
                                static_cast<std::size_t>(x);
      const auto read = [&](const ResampleMap& map) -> Eigen::Array4f {
        Eigen::Array4f sum = Eigen::Array4f::Zero();
        const ViewTap* const tap = &map.taps[cell * static_cast<std::size_t>(map.taps_per_pixel)];
        if (tap->index == ViewTap::kNowhere) return sum;
        for (int k = 0; k < map.taps_per_pixel; ++k) {
          const ViewTap& t = tap[k];
          const auto row = 4 * static_cast<std::size_t>(views_.views()[t.view].pinhole.width_px);
          const float* const p = &radiance_[4 * static_cast<std::size_t>(t.index)];
          using Texel = Eigen::Map<const Eigen::Array4f>;
          const Eigen::Array4f upper = (1 - t.x) * Texel(p) + t.x * Texel(p + 4),
                               lower = (1 - t.x) * Texel(p + row) + t.x * Texel(p + row + 4);
          sum += (1 - t.y) * upper + t.y * lower;
        }
        return map.taps_per_pixel == 1 ? sum : Eigen::Array4f(sum / static_cast<float>(map.taps_per_pixel));
      };
      if (weight != 0) {
        Eigen::Map<Eigen::Array4f> light(&sharp_.radiance[4 * pixel]);
        if (!split) {
          light += weight * read(maps[0]);
        } else {
          const Eigen::Array4f red = read(maps[0]);
          light += weight * Eigen::Array4f(red[0], read(maps[1])[1], read(maps[2])[2], red[3]);
        }
      }
      if (depth) {
        const ResampleMap& map = maps[split ? 1 : 0];
        const ViewTap& t = map.taps[cell * static_cast<std::size_t>(map.taps_per_pixel)];
        float d = std::numeric_limits<float>::quiet_NaN();
        if (t.index != ViewTap::kNowhere) {
          const auto row = static_cast<std::size_t>(views_.views()[t.view].pinhole.width_px);
          d = depth_[t.index + (t.x > 0.5F ? 1U : 0U) + (t.y > 0.5F ? row : 0U)];
          if (lenses_.front().fisheye) d /= std::max(grid.pixels()[cell].ray.dot(axis[t.view]), 1e-6F);
        }
        depth_of_pixel_[pixel] = d;
      }
    }
  });
}

Status VulkanOptics::measure(const OpticsRequest::Region& region, const ExposureTiming& timing,
                             const SensorMotion& motion,
                             const std::shared_ptr<const render::ContentWindow>& window,
                             const render::SensorView& view, GroundTruth& truth) {
  if (!truth_engine_) {
    auto cache = render::EmbreeCache::create();
    if (!cache) return tl::unexpected(cache.error());
    auto engine = render::EmbreeEngine::create(*cache);
    if (!engine) return tl::unexpected(engine.error());
    truth_engine_ = *engine;
    truth_lens_ = std::make_unique<LensGrid>(camera_, kReferenceChannel);
  }
  truth_engine_->set_options(
      {.allowed_error_rad = options_.allowed_error_px / camera_.fx_px, .eye = motion.middle()});
  if (truth_engine_->window() != window.get())
    if (auto s = truth_engine_->prepare(window); !s) return s;
  return measure_truth({camera_, *truth_lens_, region, timing, motion}, *truth_engine_, *window, view, truth);
}

Status VulkanOptics::form(const OpticsRequest& request, const render::SensorView& view, OpticsPicture& out,
                          GroundTruth* truth) {
  const auto asked = region_of(camera_, request.region);
  if (!asked) return tl::unexpected(asked.error());
  if (!(request.exposure_s >= 0 && request.exposure_s < 1e4))
    return fail(ErrorCode::bad_input, "exposure_s", "expected 0 s to 10000 s");
  const ExposureTiming timing(camera_, request);
  const auto motion = SensorMotion::of(view.T_world_sensor, timing);
  if (!motion) return tl::unexpected(motion.error());
  ViewInstants instants(camera_, timing, options_.instants);
  const int n = instants.count();
  const auto window =
      view.world.collect(query(*motion), timing.at(instants.at(0)), timing.at(instants.at(n - 1)), n);
  const bool moves = window->frames.size() > 1 || !motion->still();

  // Blurred pictures are made whole: where the discs of pixels beyond a region reach it is then the same.
  OpticsRequest::Region made = *asked;
  if (blurs()) made = {0, 0, camera_.width_px + 2 * border_px_, camera_.height_px + 2 * border_px_};
  const std::size_t pixels =
      static_cast<std::size_t>(made.width_px) * static_cast<std::size_t>(made.height_px);
  sharp_.width_px = made.width_px;
  sharp_.height_px = made.height_px;
  sharp_.radiance.assign(4 * pixels, 0.0F);
  depth_of_pixel_.resize(blurs() ? pixels : 0);
  const auto rows = static_cast<std::size_t>(made.height_px);
  std::vector<float> weight_of_row(rows, 1.0F);
  std::vector<char> takes_depth(rows, blurs() ? 1 : 0);
  if (!moves) {
    const auto all = views_.rows_read(0, camera_.height_px);
    if (auto s = draw(window->first(), motion->at(0.5), timing.at(0.5), all); !s) return s;
    add(made, weight_of_row, takes_depth);
  } else {
    const int border = blurs() ? border_px_ : 0;
    std::vector<std::vector<float>> weights(static_cast<std::size_t>(camera_.height_px));
    for (int v = 0; v < camera_.height_px; ++v)
      instants.weights(timing.middle_of(v), timing.exposure_share(), weights[static_cast<std::size_t>(v)]);
    for (int i = 0; i < n; ++i) {
      // Rows of the sensor, with those of the border as its first and its last one.
      int first = camera_.height_px, last = 0;
      for (int v = 0; v < camera_.height_px; ++v)
        if (weights[static_cast<std::size_t>(v)][static_cast<std::size_t>(i)] > 0) {
          first = std::min(first, v);
          last = std::max(last, v + 1);
        }
      if (last <= first) continue;
      const std::size_t frame =
          window->frames.size() == 1 ? 0 : std::min(static_cast<std::size_t>(i), window->frames.size() - 1);
      if (auto s = draw(*window->frames[frame], motion->at(instants.at(i)), timing.at(instants.at(i)),
                        views_.rows_read(first, last));
          !s)
        return s;
      for (int y = 0; y < made.height_px; ++y) {
        const auto& w =
            weights[static_cast<std::size_t>(std::clamp(made.y_px + y - border, 0, camera_.height_px - 1))];
        weight_of_row[static_cast<std::size_t>(y)] = w[static_cast<std::size_t>(i)];
        takes_depth[static_cast<std::size_t>(y)] =
            blurs() && std::max_element(w.begin(), w.end()) - w.begin() == (n > 1 && !w.empty() ? i : 0);
      }
      add(made, weight_of_row, takes_depth);
    }
  }

  out.width_px = asked->width_px;
  out.height_px = asked->height_px;
  if (!blurs()) {
    std::swap(out.radiance, sharp_.radiance);
  } else {
    std::vector<float> whole(4 * static_cast<std::size_t>(camera_.width_px) *
                             static_cast<std::size_t>(camera_.height_px));
    sharp_.radius_px.resize(pixels);
    const bool one_focus = lenses_.size() == 1;
    for (std::size_t c = 0; c < lenses_.size(); ++c) {
      const auto far = static_cast<float>(0.5 * lenses_[c].diameter_at_far_px),
                 focus = static_cast<float>(lenses_[c].focus_m);
      for (std::size_t i = 0; i < pixels; ++i) sharp_.radius_px[i] = far * (1 - focus / depth_of_pixel_[i]);
      if (one_focus) {
        blur_by_depth(sharp_, border_px_, 0, 4, whole.data());
      } else {
        blur_by_depth(sharp_, border_px_, static_cast<int>(c), static_cast<int>(c) + 1, whole.data());
        if (c == 0) blur_by_depth(sharp_, border_px_, 3, 4, whole.data());
      }
    }
    out.radiance.resize(4 * static_cast<std::size_t>(out.width_px) * static_cast<std::size_t>(out.height_px));
    for (int v = 0; v < out.height_px; ++v)
      std::copy_n(
          whole.begin() + 4 * (static_cast<std::ptrdiff_t>(asked->y_px + v) * camera_.width_px + asked->x_px),
          4 * out.width_px, out.radiance.begin() + 4 * static_cast<std::ptrdiff_t>(v) * out.width_px);
  }
  if (truth == nullptr) return {};
  return measure(*asked, timing, *motion, window, view, *truth);
}

}  // namespace

Result<std::unique_ptr<CameraOpticsPicture>> make_vulkan_optics(
    const CameraModel& camera, const OpticsOptions& options, std::shared_ptr<render::ViewRenderer> renderer) {
  if (auto s = camera.validate(); !s) return tl::unexpected(s.error());
  if (!renderer) return fail(ErrorCode::unavailable, "raster", "expected a renderer, got none");
  if (!(options.supersampling >= 0.25 && options.supersampling <= 4))
    return fail(ErrorCode::bad_input, "supersampling",
                "expected 0.25 to 4, got " + std::to_string(options.supersampling));
  if (options.view_samples != 1 && options.view_samples != 4)
    return fail(ErrorCode::bad_input, "view_samples",
                "expected 1 or 4, got " + std::to_string(options.view_samples));
  const std::vector<int> colours{kRed, kGreen, kBlue};
  std::vector<int> channels{kReferenceChannel};
  if (camera.chromatic.lateral()) channels = colours;
  std::vector<ThinLens> lenses;
  if (camera.chromatic.longitudinal())
    for (const int c : colours) lenses.push_back(ThinLens::of(camera, c));
  else
    lenses.push_back(ThinLens::of(camera, kReferenceChannel));
  double radius = 0;
  for (const ThinLens& l : lenses) radius = std::max(radius, largest_radius_px(l));
  // A disc smaller than a pixel changes nothing that is seen.
  const int border = radius > 0 ? std::clamp(static_cast<int>(std::ceil(radius)), 2, kMaxBlurRadius_px) : 0;
  auto views = LensViews::of(camera, channels, options.supersampling, border);
  if (!views) return tl::unexpected(views.error());
  return std::make_unique<VulkanOptics>(camera, options, std::move(renderer), std::move(*views),
                                        std::move(lenses), border);
}

Result<std::unique_ptr<CameraOpticsPicture>> make_vulkan_optics(const CameraModel& camera,
                                                                const OpticsOptions& options,
                                                                std::shared_ptr<render::Device> device) {
  auto renderer = render::ViewRenderer::create(std::move(device));
  if (!renderer) return tl::unexpected(renderer.error());
  return make_vulkan_optics(camera, options, std::shared_ptr<render::ViewRenderer>(std::move(*renderer)));
}

}  // namespace rigor
