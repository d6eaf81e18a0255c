#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/sensors/camera/exposure_timing.h"
#include "sim/sensors/camera/ground_truth.h"
#include "sim/sensors/camera/lens_grid.h"
#include "sim/sensors/camera/lens_samples.h"
#include "sim/sensors/camera/pose_table.h"
#include "sim/sensors/camera/sky_edges.h"
#include "sim/sensors/camera/thin_lens.h"
#include "sim/sensors/camera/traced_grid.h"
#include "sim/sensors/camera/uneven_pixels.h"

namespace rigor {
namespace {

using render::Ray;

/// Rays that are traced at once, about: enough for all threads, little enough for the cache.
constexpr int kRaysAtOnce = 65536;
/// Tells the samples of uneven pixels apart from those that every pixel has.
constexpr std::uint64_t kMoreSamples = 0x3C6EF372FE94F82BULL, kSkySamples = 0xA54FF53A5F1D36F1ULL;
/// Where sky rays find the first sky or the first surface that is known of a pixel, its neighbours are asked
/// too, and theirs: so many pixels far.
constexpr int kFollowsSky_px = 3;

/// A ray that brings no light.
const Ray nowhere = [] {
  Ray r;
  std::fill(std::begin(r.direction), std::end(r.direction), std::numeric_limits<float>::quiet_NaN());
  return r;
}();

/// Of the picture's mean light: finding edges of less contrast costs more than what they are wrong by.
constexpr float kUnevenContrast = 0.3F;

/// In steps of a quarter of an octave, down: cameras that are about alike ask for the same content.
double stepped(double allowed_rad) { return std::exp2(std::floor(4 * std::log2(allowed_rad)) / 4); }

/// A part of a picture; the regions count from the same corner.
void crop(const OpticsPicture& from, const OpticsRequest::Region& whole, const OpticsRequest::Region& part,
          OpticsPicture& out) {
  const auto row_of = [](const OpticsRequest::Region& r, int x, int y) {
    return 4 * (static_cast<std::size_t>(y - r.y_px) * static_cast<std::size_t>(r.width_px) +
                static_cast<std::size_t>(x - r.x_px));
  };
  for (int y = part.y_px; y < part.y_px + part.height_px; ++y)
    std::copy_n(&from.radiance[row_of(whole, part.x_px, y)], 4 * static_cast<std::size_t>(part.width_px),
                &out.radiance[row_of(part, part.x_px, y)]);
}

class RaysOptics final : public CameraOpticsPicture {
 public:
  RaysOptics(const CameraModel& camera, const OpticsOptions& options, std::shared_ptr<SharedLight> light)
      : camera_(camera), grid_(camera), options_(options), light_of_(std::move(light)) {
    const bool in_focus_alike = !camera.chromatic.longitudinal() || !camera.depth_of_field.active();
    const bool traced =
        options.trace_colours.value_or(options.samples.every >= OpticsOptions::kColoursTraced);
    const bool one_picture =
        !camera.chromatic.lateral() || (!traced && TracedGrid::fits(camera, options.pixel_step));
    if (in_focus_alike && one_picture && (camera.chromatic.lateral() || options.pixel_step > 1)) {
      moves_ = true;
      grid_ = TracedGrid(camera, options.pixel_step);
      lenses_.emplace_back(grid_.camera(), kReferenceChannel, grid_.border_px());
      apertures_.push_back(ThinLens::of(camera, kReferenceChannel));
    } else if (camera.chromatic.lateral() || !in_focus_alike) {
      for (const int c : {kRed, kGreen, kBlue}) {
        lenses_.emplace_back(camera, c);
        apertures_.push_back(ThinLens::of(camera, c));
      }
    } else {
      lenses_.emplace_back(camera, kReferenceChannel);
      apertures_.push_back(ThinLens::of(camera, kReferenceChannel));
    }
  }
  [[nodiscard]] std::string_view engine() const override { return "rays"; }
  [[nodiscard]] Status form(const OpticsRequest& request, const render::SensorView& view, OpticsPicture& out,
                            GroundTruth* truth) override;
  [[nodiscard]] double prepare_ms() const override { return prepare_ms_; }

 private:
  struct Strip {
    int first_row, rows;  ///< of the full sensor
    std::size_t blocks_across;
    /// Where a pixel's first ray stands. Depends on the full sensor alone, so that a region's rays are those
    /// of the full picture.
    [[nodiscard]] std::size_t first_ray(int u, int v, int n) const {
      const auto block = static_cast<std::size_t>((v - first_row) / kPacketHeight_px) * blocks_across +
                         static_cast<std::size_t>(u / kPacketWidth_px);
      const auto within = static_cast<std::size_t>((v - first_row) % kPacketHeight_px * kPacketWidth_px +
                                                   u % kPacketWidth_px);
      return (block * kPacketWidth_px * kPacketHeight_px + within) * static_cast<std::size_t>(n);
    }
  };
  struct Shot {
    const OpticsRequest& request;
    OpticsRequest::Region region;
    const ExposureTiming& timing;
    const PoseTable& poses;
    Eigen::Vector3d origin;
    std::uint64_t samples_key;
    LensSamples samples;
  };
  /// In the middle of a row's exposure.
  struct RowPose {
    float middle;
    Eigen::Matrix3f turn;
    Eigen::Vector3f from;
  };
  [[nodiscard]] RowPose pose_of_row(const Shot& shot, int v) const;
  /// Rays of one pixel, as many as `rays` has room for, at most samples.per_pixel().
  void aim(const LensGrid::Pixel& pixel, const ThinLens& aperture, const Shot& shot,
           const LensSamples& samples, const RowPose& row, int u, int v, std::span<Ray> rays) const;
  Status trace(const Strip& strip, std::size_t channel, const Shot& shot, OpticsPicture& out);
  /// Traces uneven pixels of `picture` again, by PixelSamples::uneven: those of `inner`, a part of
  /// shot.region.
  Status refine(const Shot& shot, const OpticsRequest::Region& inner, OpticsPicture& picture);
  /// Rays of pixels, pixel by pixel, `query.rays` of them traced into light_.
  Status trace_places(const Shot& shot, std::span<const PixelPlace> places, std::size_t channel,
                      const LensSamples& samples, bool sky_only);
  /// Asks pixels of `inner` at the sky's edges how much of them is sky, and follows what that finds.
  Status ask_for_sky(const Shot& shot, const OpticsRequest::Region& inner, OpticsPicture& picture);
  [[nodiscard]] bool asks_for_sky() const { return options_.samples.sky > 0 && lenses_.size() == 1; }
  /// Rays through pixels all over the whole sensor, whatever region is asked for; into rays_.
  void sparse_rays(const Shot& shot);
  /// Mean radiance of the whole picture, by one of its pixels in kGatherWidth_px x kGatherHeight_px.
  Result<std::array<float, 4>> mean_light(const Shot& shot);
  /// Light about what the whole sensor sees.
  Status gather(const Shot& shot);
  [[nodiscard]] render::LightQuery light_query(const Shot& shot) const;
  /// A region with so many pixels more on each side, within the grid.
  [[nodiscard]] OpticsRequest::Region grown(const OpticsRequest::Region& region, int by_px) const;
  /// A region and what else of the grid its packets of rays hold.
  [[nodiscard]] OpticsRequest::Region whole_packets(const OpticsRequest::Region& region) const;
  [[nodiscard]] int width_px() const { return grid_.width_px(); }
  [[nodiscard]] int height_px() const { return grid_.height_px(); }
  [[nodiscard]] const LensGrid::Pixel& pixel_at(std::size_t channel, int u, int v) const {
    return lenses_[channel].at(u - grid_.border_px(), v - grid_.border_px());
  }

  CameraModel camera_;
  TracedGrid grid_;
  bool moves_ = false;  ///< the picture's planes are taken from one of the grid's own
  OpticsPicture reference_;
  OpticsOptions options_;
  std::shared_ptr<SharedLight> light_of_;
  double prepare_ms_ = 0;
  std::vector<LensGrid> lenses_;  ///< one, or one for each of red, green, blue
  std::vector<ThinLens> apertures_;
  std::unique_ptr<LensGrid> truth_lens_;
  std::vector<Ray> rays_;
  std::vector<std::uint32_t> numbers_;
  std::vector<render::LightSample> light_;
  SkyEdges sky_edges_;
};

RaysOptics::RowPose RaysOptics::pose_of_row(const Shot& shot, int v) const {
  RowPose row;
  row.middle = static_cast<float>(shot.timing.middle_of(grid_.row_of(v)));
  shot.poses.at(row.middle, row.turn, row.from);
  return row;
}

void RaysOptics::aim(const LensGrid::Pixel& pixel, const ThinLens& aperture, const Shot& shot,
                     const LensSamples& samples, const RowPose& row, int u, int v,
                     std::span<Ray> rays) const {
  const auto exposure = static_cast<float>(shot.timing.exposure_share());
  const bool centre = samples.per_pixel() == 1, drawn = !centre || aperture.opens() || exposure > 0;
  LensSamples::Shift shift{};
  if (drawn) shift = samples.shift_of(static_cast<std::uint32_t>(v * width_px() + u));
  RowPose pose = row;
  for (int i = 0; i < static_cast<int>(rays.size()); ++i) {
    const LensSample s = drawn ? samples.sample(i, shift, aperture.opens()) : LensSample{};
    const float t = row.middle + exposure * s.time;
    if (exposure > 0) shot.poses.at(t, pose.turn, pose.from);
    Eigen::Vector3f d = centre ? pixel.ray : pixel.at(s.u, s.v), o = Eigen::Vector3f::Zero();
    if (aperture.opens()) aperture.refract(s.lens_x, s.lens_y, d, o);
    const Eigen::Vector3f direction = (pose.turn * d).normalized(), start = pose.turn * o + pose.from;
    Ray& r = rays[static_cast<std::size_t>(i)];
    for (int k = 0; k < 3; ++k) {
      r.origin[k] = start[k];
      r.direction[k] = direction[k];
    }
    r.time = t;
    r.far_m = std::numeric_limits<float>::infinity();
  }
}

Status RaysOptics::trace(const Strip& strip, std::size_t channel, const Shot& shot, OpticsPicture& out) {
  const int n = shot.samples.per_pixel();
  const std::size_t count = strip.blocks_across * kPacketWidth_px *
                            static_cast<std::size_t>((strip.rows + kPacketHeight_px - 1) / kPacketHeight_px) *
                            kPacketHeight_px * static_cast<std::size_t>(n);
  const auto& region = shot.region;
  const bool whole = region.width_px == width_px() && region.x_px == 0 && width_px() % kPacketWidth_px == 0 &&
                     region.y_px <= strip.first_row &&
                     region.y_px + region.height_px >= strip.first_row + strip.rows &&
                     strip.rows % kPacketHeight_px == 0;
  rays_.resize(count);
  if (!whole) std::fill(rays_.begin(), rays_.end(), nowhere);
  light_.resize(count);
  const int first = std::max(strip.first_row, region.y_px),
            last = std::min(strip.first_row + strip.rows, region.y_px + region.height_px);
  tbb::parallel_for(first, last, [&](int v) {
    const RowPose row = pose_of_row(shot, v);
    for (int u = region.x_px; u < region.x_px + region.width_px; ++u) {
      const LensGrid::Pixel& pixel = pixel_at(channel, u, v);
      const std::span ray(&rays_[strip.first_ray(u, v, n)], static_cast<std::size_t>(n));
      if (pixel.lit())
        aim(pixel, apertures_[channel], shot, shot.samples, row, u, v, ray);
      else
        std::fill(ray.begin(), ray.end(), nowhere);
    }
  });
  render::LightQuery query = light_query(shot);
  query.rays = rays_;
  query.spread_rad /= std::sqrt(static_cast<float>(n));
  query.packets = true;
  query.seed ^= (static_cast<std::uint64_t>(strip.first_row) << 40U) ^ (std::uint64_t{channel} << 60U);
  if (auto s = light_of_->tracer.trace(query, light_); !s) return s;
  const bool split = lenses_.size() > 1, edges = asks_for_sky();
  const float share = 1.0F / static_cast<float>(n);
  tbb::parallel_for(first, last, [&](int v) {
    for (int u = region.x_px; u < region.x_px + region.width_px; ++u) {
      if (!pixel_at(channel, u, v).lit()) continue;
      const render::LightSample* const sample = &light_[strip.first_ray(u, v, n)];
      Eigen::Array4f sum = Eigen::Array4f::Zero();
      for (int i = 0; i < n; ++i) sum += Eigen::Map<const Eigen::Array4f>(sample[i].radiance);
      sum *= share;
      if (edges)
        for (int i = 0; i < n; ++i) sky_edges_.add({u - region.x_px, v - region.y_px}, sample[i]);
      float* const pixel = &out.radiance[4 * (static_cast<std::size_t>(v - region.y_px) *
                                                  static_cast<std::size_t>(region.width_px) +
                                              static_cast<std::size_t>(u - region.x_px))];
      if (!split) {
        for (int b = 0; b < 4; ++b) pixel[b] = sum[b];
      } else {
        pixel[channel] = sum[static_cast<Eigen::Index>(channel)];
        if (channel == 0) pixel[3] = sum[3];
      }
    }
  });
  return {};
}

render::LightQuery RaysOptics::light_query(const Shot& shot) const {
  render::LightQuery query;
  query.origin = shot.origin;
  query.shadows = options_.shadows;
  query.sky_rays = options_.sky_rays;
  query.gathered = options_.shadows && options_.sky_rays == 0;
  query.spread_rad = static_cast<float>(1 / std::max(grid_.camera().fx_px, grid_.camera().fy_px));
  query.sun_rays = render::SunRays::wide;
  query.seed = shot.request.seed ^ (shot.request.measure.index * 0x9E3779B97F4A7C15ULL);
  return query;
}

void RaysOptics::sparse_rays(const Shot& shot) {
  rays_.clear();
  for (int row = 0; row * render::kGatherHeight_px < height_px(); ++row)
    for (int column = 0; column * render::kGatherWidth_px < width_px(); ++column) {
      const render::GatheringPixel at = render::gathering_pixel(column, row);
      if (at.u >= width_px() || at.v >= height_px()) continue;
      const LensGrid::Pixel& pixel = pixel_at(0, at.u, at.v);
      if (!pixel.lit()) continue;
      const RowPose row_pose = pose_of_row(shot, at.v);
      const Eigen::Vector3f direction = (row_pose.turn * pixel.ray).normalized();
      Ray ray{.time = row_pose.middle};
      for (int k = 0; k < 3; ++k) {
        ray.origin[k] = row_pose.from[k];
        ray.direction[k] = direction[k];
      }
      ray.far_m = std::numeric_limits<float>::infinity();
      rays_.push_back(ray);
    }
}

Status RaysOptics::gather(const Shot& shot) {
  sparse_rays(shot);
  render::LightQuery query = light_query(shot);
  query.rays = rays_;
  return light_of_->tracer.gather(query);
}

Result<std::array<float, 4>> RaysOptics::mean_light(const Shot& shot) {
  sparse_rays(shot);
  render::LightQuery query = light_query(shot);
  query.rays = rays_;
  light_.resize(rays_.size());
  if (auto s = light_of_->tracer.trace(query, light_); !s) return tl::unexpected(s.error());
  std::array<double, 4> sum{};
  for (const render::LightSample& s : light_)
    for (std::size_t b = 0; b < 4; ++b) sum[b] += static_cast<double>(s.radiance[b]);
  std::array<float, 4> mean{};
  for (std::size_t b = 0; b < 4; ++b)
    mean[b] = static_cast<float>(sum[b] / static_cast<double>(std::max<std::size_t>(light_.size(), 1)));
  return mean;
}

Status RaysOptics::trace_places(const Shot& shot, std::span<const PixelPlace> places, std::size_t channel,
                                const LensSamples& samples, bool sky_only) {
  const auto each = static_cast<std::size_t>(samples.per_pixel());
  rays_.resize(places.size() * each);
  numbers_.resize(rays_.size());
  light_.resize(rays_.size());
  tbb::parallel_for(std::size_t{0}, places.size(), [&](std::size_t i) {
    const int u = places[i].u + shot.region.x_px, v = places[i].v + shot.region.y_px;
    const std::span rays(&rays_[i * each], each);
    // Of the full sensor, as draws are the same in each region.
    const auto place = static_cast<std::uint32_t>(v * width_px() + u);
    for (std::size_t k = 0; k < each; ++k)
      numbers_[i * each + k] = place * static_cast<std::uint32_t>(each) + static_cast<std::uint32_t>(k);
    if (const LensGrid::Pixel& pixel = pixel_at(channel, u, v); pixel.lit())
      aim(pixel, apertures_[channel], shot, samples, pose_of_row(shot, v), u, v, rays);
    else
      std::fill(rays.begin(), rays.end(), nowhere);
  });
  render::LightQuery query = light_query(shot);
  query.rays = rays_;
  query.numbers = numbers_;
  query.seed ^= kMoreSamples ^ (std::uint64_t{channel} << 60U);
  query.spread_rad /= std::sqrt(static_cast<float>(each));
  query.sky_only = sky_only;
  return light_of_->tracer.trace(query, light_);
}

Status RaysOptics::ask_for_sky(const Shot& shot, const OpticsRequest::Region& inner, OpticsPicture& picture) {
  const OpticsRequest::Region& region = shot.region;
  const auto each = static_cast<std::size_t>(options_.samples.sky);
  const LensSamples samples(options_.samples.sky, shot.samples_key ^ kSkySamples);
  const std::size_t at_once = std::max<std::size_t>(kRaysAtOnce / each, 1);
  std::vector<PixelPlace> asked;
  for (int round = 0; round <= kFollowsSky_px; ++round) {
    const OpticsRequest::Region around = grown(inner, kFollowsSky_px - round);
    const std::vector<PixelPlace> places = sky_edges_.places(
        {around.x_px - region.x_px, around.y_px - region.y_px, around.width_px, around.height_px},
        [&](int u, int v) { return pixel_at(0, u + region.x_px, v + region.y_px).lit(); });
    for (std::size_t begin = 0; begin < places.size(); begin += at_once) {
      const auto some = std::span(places).subspan(begin, std::min(at_once, places.size() - begin));
      if (auto s = trace_places(shot, some, 0, samples, true); !s) return s;
      tbb::parallel_for(std::size_t{0}, some.size(), [&](std::size_t i) {
        for (std::size_t k = 0; k < each; ++k) sky_edges_.add_sky_only(some[i], light_[i * each + k]);
      });
    }
    asked.insert(asked.end(), places.begin(), places.end());
  }
  for (const PixelPlace at : asked)
    sky_edges_.resolve(
        at,
        &picture.radiance[4 * (static_cast<std::size_t>(at.v) * static_cast<std::size_t>(picture.width_px) +
                               static_cast<std::size_t>(at.u))]);
  return {};
}

Status RaysOptics::refine(const Shot& shot, const OpticsRequest::Region& inner, OpticsPicture& picture) {
  const auto mean = mean_light(shot);
  if (!mean) return tl::unexpected(mean.error());
  const OpticsRequest::Region& region = shot.region;
  const std::vector<PixelPlace> places = uneven_pixels(
      picture, {inner.x_px - region.x_px, inner.y_px - region.y_px, inner.width_px, inner.height_px}, *mean,
      kUnevenContrast, [&](int u, int v) { return pixel_at(0, u + region.x_px, v + region.y_px).lit(); });
  const int n = options_.samples.uneven;
  const auto each = static_cast<std::size_t>(n);
  const LensSamples samples(n, shot.samples_key ^ kMoreSamples);
  const std::size_t at_once = std::max<std::size_t>(kRaysAtOnce / each, 1);
  for (std::size_t begin = 0; begin < places.size(); begin += at_once) {
    const std::size_t count = std::min(at_once, places.size() - begin);
    for (std::size_t channel = 0; channel < lenses_.size(); ++channel) {
      if (auto s = trace_places(shot, std::span(places).subspan(begin, count), channel, samples, false); !s)
        return s;
      tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
        const PixelPlace at = places[begin + i];
        Eigen::Array4f sum = Eigen::Array4f::Zero();
        for (std::size_t k = 0; k < each; ++k) {
          sum += Eigen::Map<const Eigen::Array4f>(light_[i * each + k].radiance);
          if (asks_for_sky()) sky_edges_.add(at, light_[i * each + k]);
        }
        float* const pixel =
            &picture
                 .radiance[4 * (static_cast<std::size_t>(at.v) * static_cast<std::size_t>(picture.width_px) +
                                static_cast<std::size_t>(at.u))];
        const auto before = static_cast<float>(shot.samples.per_pixel()),
                   all = before + static_cast<float>(n);
        const auto mix = [&](std::size_t b) {
          pixel[b] = (before * pixel[b] + sum[static_cast<Eigen::Index>(b)]) / all;
        };
        if (lenses_.size() == 1)
          for (std::size_t b = 0; b < 4; ++b) mix(b);
        else
          mix(channel);
        if (lenses_.size() > 1 && channel == 0) mix(3);
      });
    }
  }
  return {};
}

OpticsRequest::Region RaysOptics::grown(const OpticsRequest::Region& region, int by_px) const {
  OpticsRequest::Region out;
  out.x_px = std::max(region.x_px - by_px, 0);
  out.y_px = std::max(region.y_px - by_px, 0);
  out.width_px = std::min(region.x_px + region.width_px + by_px, width_px()) - out.x_px;
  out.height_px = std::min(region.y_px + region.height_px + by_px, height_px()) - out.y_px;
  return out;
}

OpticsRequest::Region RaysOptics::whole_packets(const OpticsRequest::Region& region) const {
  OpticsRequest::Region out;
  out.x_px = region.x_px / kPacketWidth_px * kPacketWidth_px;
  out.y_px = region.y_px / kPacketHeight_px * kPacketHeight_px;
  const auto end = [](int at, int packet, int size) {
    return std::min((at + packet - 1) / packet * packet, size);
  };
  out.width_px = end(region.x_px + region.width_px, kPacketWidth_px, width_px()) - out.x_px;
  out.height_px = end(region.y_px + region.height_px, kPacketHeight_px, height_px()) - out.y_px;
  return out;
}

Status RaysOptics::form(const OpticsRequest& request, const render::SensorView& view, OpticsPicture& out,
                        GroundTruth* truth) {
  const auto region = region_of(camera_, request.region);
  if (!region) return tl::unexpected(region.error());
  if (!(request.exposure_s >= 0 && request.exposure_s < 1e4))
    return fail(ErrorCode::bad_input, "exposure_s", "expected 0 s to 10000 s");
  const ExposureTiming timing(camera_, request);
  const auto motion = SensorMotion::of(view.T_world_sensor, timing);
  if (!motion) return tl::unexpected(motion.error());
  const Eigen::Vector3d origin = motion->middle();
  // All round: what stands behind throws shadows, hides the sky and is seen in mirrors.
  render::ContentQuery query;
  query.look_from_cell_of(origin);
  query.allowed_error_rad = stepped(options_.allowed_error_px / std::max(camera_.fx_px, camera_.fy_px));
  const auto window = view.world.collect(query, timing.begin(), timing.end(),
                                         timing.one_instant() ? 1 : std::max(options_.instants, 2));
  const std::lock_guard turn(light_of_->turn);
  render::EmbreeEngine& engine = *light_of_->engine;
  // In full: coarser levels have their leaves elsewhere, and finer ones cost no more.
  engine.set_options({});
  if (auto s = engine.prepare(window); !s) return s;
  prepare_ms_ = engine.statistics().prepare_ms;

  const OpticsRequest::Region looked_at_region = moves_ ? grid_.looked_at(*region) : *region;
  const bool more = options_.samples.uneven > 0 || asks_for_sky();
  // Whether a pixel is uneven depends on its neighbours; whether it is asked for the sky on theirs, and on
  // those that are followed; the light of a packet on all of its pixels.
  const OpticsRequest::Region uneven = grown(looked_at_region, asks_for_sky() ? kFollowsSky_px + 1 : 0),
                              traced = whole_packets(grown(uneven, more ? 1 : 0));
  const PoseTable poses(*motion, origin);
  const std::uint64_t key = request.seed ^ (request.measure.index * 0xD1342543DE82EF95ULL);
  const Shot shot{request, traced, timing, poses, origin, key, LensSamples(options_.samples.every, key)};
  const bool apart = moves_ || traced != *region;
  OpticsPicture& picture = apart ? reference_ : out;
  for (OpticsPicture* const p : {&out, &reference_}) {
    if (p == &reference_ && !apart) continue;
    const OpticsRequest::Region& of = p == &out ? *region : traced;
    p->width_px = of.width_px;
    p->height_px = of.height_px;
    p->radiance.assign(4 * static_cast<std::size_t>(of.width_px) * static_cast<std::size_t>(of.height_px),
                       0.0F);
  }
  if (asks_for_sky()) sky_edges_.reset(traced.width_px, traced.height_px);
  if (light_query(shot).gathered)
    if (auto s = gather(shot); !s) return s;
  const int across = (width_px() + kPacketWidth_px - 1) / kPacketWidth_px;
  const int rows = std::clamp(kRaysAtOnce / (across * kPacketWidth_px * shot.samples.per_pixel()) /
                                  kPacketHeight_px * kPacketHeight_px,
                              kPacketHeight_px, 4096);
  for (int row = traced.y_px / rows * rows; row < traced.y_px + traced.height_px; row += rows)
    for (std::size_t c = 0; c < lenses_.size(); ++c) {
      const Strip strip{row, std::min(rows, height_px() - row), static_cast<std::size_t>(across)};
      if (auto s = trace(strip, c, shot, picture); !s) return s;
    }
  if (options_.samples.uneven > 0)
    if (auto s = refine(shot, uneven, picture); !s) return s;
  if (asks_for_sky())
    if (auto s = ask_for_sky(shot, looked_at_region, picture); !s) return s;
  if (apart && !moves_) crop(reference_, traced, *region, out);
  if (moves_) grid_.move_colours(reference_, traced, lenses_.front(), *region, out);
  if (truth == nullptr) return {};
  const LensGrid* lens = lenses_.data();
  if (lenses_.size() > 1 || moves_) {
    if (!truth_lens_) truth_lens_ = std::make_unique<LensGrid>(camera_, kReferenceChannel);
    lens = truth_lens_.get();
  }
  return measure_truth({camera_, *lens, *region, timing, *motion}, engine, *window, view, *truth);
}

}  // namespace

Result<std::unique_ptr<CameraOpticsPicture>> make_rays_optics(const CameraModel& camera,
                                                              const OpticsOptions& options,
                                                              std::shared_ptr<SharedLight> light) {
  if (auto s = camera.validate(); !s) return tl::unexpected(s.error());
  if (!light) return fail(ErrorCode::unavailable, "rays", "expected an engine, got none");
  if (options.samples.every < 1 || options.samples.every > 65536)
    return fail(ErrorCode::bad_input, "samples_per_pixel",
                "expected 1 to 65536, got " + std::to_string(options.samples.every));
  if (options.pixel_step < 1 || options.pixel_step > 8)
    return fail(ErrorCode::bad_input, "pixel_step",
                "expected 1 to 8, got " + std::to_string(options.pixel_step));
  if (options.samples.sky < 0 || options.samples.sky > 4096)
    return fail(ErrorCode::bad_input, "sky_samples",
                "expected 0 to 4096, got " + std::to_string(options.samples.sky));
  if (options.samples.uneven < 0 || options.samples.uneven > 4096)
    return fail(ErrorCode::bad_input, "uneven_samples",
                "expected 0 to 4096, got " + std::to_string(options.samples.uneven));
  return std::make_unique<RaysOptics>(camera, options, std::move(light));
}

Result<std::unique_ptr<CameraOpticsPicture>> make_rays_optics(const CameraModel& camera,
                                                              const OpticsOptions& options,
                                                              std::shared_ptr<render::EmbreeCache> cache) {
  auto light = SharedLight::create(std::move(cache));
  if (!light) return tl::unexpected(light.error());
  return make_rays_optics(camera, options, std::move(*light));
}

Result<std::shared_ptr<SharedLight>> SharedLight::create(std::shared_ptr<render::EmbreeCache> cache) {
  if (!cache) {
    auto made = render::EmbreeCache::create();
    if (!made) return tl::unexpected(made.error());
    cache = *made;
  }
  auto engine = render::EmbreeEngine::create(std::move(cache));
  if (!engine) return tl::unexpected(engine.error());
  return std::make_shared<SharedLight>(std::move(*engine));
}

}  // namespace rigor
