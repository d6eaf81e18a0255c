#include "sim/render/view/view_renderer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <utility>

#include "rt-core/stage_time.h"
#include "sim/render/view/culling.h"
#include "sim/render/view/draw_context.h"
#include "sim/render/view/impostors.h"
#include "sim/render/view/view_frame.h"

namespace rigor::render {
namespace {

constexpr double kShadowReach_m = 400;
/// What stands outside the view within this way may throw shadows into it.
constexpr double kCasterReach_m = 120;
/// Lower than this nothing stands above the ground.
constexpr double kCoverRise_m = 0.3;

using Clock = std::chrono::steady_clock;
/// As shaders/view/octahedron.glsl packs it.
Eigen::Vector3f unpacked_direction(std::uint32_t bits) {
  const auto part = [&](int shift) {
    return std::max(static_cast<float>(static_cast<std::int16_t>(bits >> shift)) / 32767.0F, -1.0F);
  };
  Eigen::Vector3f n(part(0), part(16), 0);
  n.z() = 1 - std::abs(n.x()) - std::abs(n.y());
  if (n.z() < 0) {
    const float x = n.x(), y = n.y();
    n.x() = (1 - std::abs(y)) * (x >= 0 ? 1.0F : -1.0F);
    n.y() = (1 - std::abs(x)) * (y >= 0 ? 1.0F : -1.0F);
  }
  return n.normalized();
}

Status check(const ViewRequest& q, const VkPhysicalDeviceLimits& limits) {
  const Pinhole& p = q.pinhole;
  const auto bad = [](const char* where, const std::string& message) {
    return fail(ErrorCode::bad_input, where, message);
  };
  const auto side = static_cast<long long>(std::min(limits.maxImageDimension2D, 16384U));
  if (p.width_px < 1 || p.height_px < 1 || p.width_px > side || p.height_px > side)
    return bad("picture", "expected 1 to " + std::to_string(side) + " px a side, got " +
                              std::to_string(p.width_px) + "x" + std::to_string(p.height_px));
  if (!(p.fx_px > 0 && p.fy_px > 0) || !std::isfinite(p.fx_px + p.fy_px + p.cx_px + p.cy_px))
    return bad("pinhole", "expected finite fx, fy above 0 and a finite centre");
  if (!(p.near_m > 0) || !std::isfinite(p.near_m))
    return bad("pinhole", "near_m: expected a length above 0, got " + std::to_string(p.near_m));
  const Eigen::Matrix3d r = q.T_world_camera.linear();
  if (!q.T_world_camera.matrix().allFinite() || !(r.transpose() * r).isIdentity(1e-6) || r.determinant() < 0)
    return bad("T_world_camera", "expected a finite place and a rotation");
  for (const int b : q.bands)
    if (b < 0 || b >= static_cast<int>(kBandCount))
      return bad("bands", "expected 0 to " + std::to_string(kBandCount - 1) + ", got " + std::to_string(b));
  if (q.samples != 1 && q.samples != 4)
    return bad("samples", "expected 1 or 4, got " + std::to_string(q.samples));
  if (!(q.allowed_error_px >= 0) || !std::isfinite(q.allowed_error_px))
    return bad("allowed_error_px", "expected 0 or more, got " + std::to_string(q.allowed_error_px));
  return {};
}

std::size_t count(const std::vector<Bucket>& buckets) {
  std::size_t n = 0;
  for (const Bucket& b : buckets) n += b.instances.size();
  return n;
}

std::size_t count(const std::vector<ShadowLayer>& layers) {
  std::size_t n = 0;
  for (const ShadowLayer& l : layers) n += count(l.still) + count(l.others);
  return n;
}

/// Leaves before leaves before leaves: their depths alone first, and light only where they are seen.
bool has_holes(const std::vector<Bucket>& buckets) {
  return std::any_of(buckets.begin(), buckets.end(), [](const Bucket& b) {
    return b.mesh != nullptr && std::any_of(b.mesh->parts.begin(), b.mesh->parts.end(), [](const auto& part) {
             return (part.surface->features & kFeatureAlpha) != 0;
           });
  });
}

void count_calls(const std::vector<DrawCall>& calls, bool instancing, ViewStatistics& s) {
  for (const DrawCall& c : calls) {
    s.draw_calls += instancing ? 1 : c.instance_count;
    s.triangles_drawn += std::size_t{c.mesh != nullptr ? c.index_count / 3 : 2} * c.instance_count;
    if (c.mesh == nullptr) s.impostors_drawn += c.instance_count;
  }
}

/// What drawing costs, about.
double work_of(const DrawCall& c) {
  return static_cast<double>(c.index_count) * static_cast<double>(c.instance_count);
}
double work_of(std::span<const DrawCall> calls) {
  double work = 0;
  for (const DrawCall& c : calls) work += work_of(c);
  return work;
}
double work_of(const std::vector<Bucket>& buckets) {
  double work = 0;
  for (const Bucket& b : buckets)
    work += (b.mesh != nullptr ? 3.0 * b.mesh->triangles : 6.0) * static_cast<double>(b.instances.size());
  return work;
}

/// The same calls, none of them more work than `most` where it has several instances.
std::vector<DrawCall> in_pieces(std::span<const DrawCall> calls, double most) {
  std::vector<DrawCall> pieces;
  for (const DrawCall& c : calls) {
    const double each = static_cast<double>(c.index_count);
    const auto step = static_cast<std::uint32_t>(std::clamp(most / std::max(each, 1.0), 1.0, 4e9));
    for (std::uint32_t i = 0; i < c.instance_count; i += step) {
      DrawCall& piece = pieces.emplace_back(c);
      piece.first_instance += i;
      piece.instance_count = std::min(step, c.instance_count - i);
      if (c.instance_count - i <= step) break;
    }
  }
  return pieces;
}

/// How much of a picture is drawn, for who asked. `told` is empty where nobody did.
struct Progress {
  static constexpr double kPieces = 40;  ///< of a picture, each a submission
  std::function<void(double)> told;
  double total = 0, done = 0;

  void add(double work) {
    done += work;
    if (told && done > 0 && total > 0) told(std::min(1.0, done / total));
  }
};

}  // namespace

struct ViewRenderer::Impl : DrawContext {
  explicit Impl(std::shared_ptr<Device> d)
      : DrawContext(std::move(d)),
        targets(gpu()),
        tiles(gpu(), pipelines),
        particles(gpu(), pipelines),
        impostors(gpu(), pipelines) {}

  Status create() {
    if (auto s = DrawContext::create(); !s) return s;
    return impostors.create();
  }
  Status draw(const ContentFrame& frame, const ViewRequest& request, ViewPicture& out, ViewStatistics& s);
  /// After a frame that failed. False: there was nothing to forget.
  bool forget_shadows() {
    const bool sun = resources.shadow().forget(), sky = resources.zenith().forget();
    return sun || sky;
  }
  void keep_no_shadows() {
    resources.shadow().keep_nothing();
    resources.zenith().keep_nothing();
  }

 private:
  Status make_shadows(const ViewCamera& camera, const CullOptions& options, FrameNumbers& numbers,
                      const ViewRequest& request);
  FrameFeatures features_of(const ContentFrame& frame, const ViewRequest& request,
                            const FrameNumbers& n) const;
  /// Draws a part of the picture; `first`, `second`: before and after what is hidden is dropped;
  /// `first_is_done`: the first are drawn, or their depth is where that comes first.
  Status record_part(const FrameTargets::Part& part, std::span<const DrawCall> first,
                     std::span<const DrawCall> second, bool first_is_done, const FrameFeatures& features);
  /// Calls within `pass`, which was begun; piece by piece where somebody wants to know how far it is.
  Status record_calls(std::span<const DrawCall> calls, FrameTargets::Pass pass,
                      const FrameTargets::Part& part, bool instancing);
  void read_back(const ViewRequest& request, ViewPicture& out) const;

  Progress progress;
  FrameTargets targets;
  TilePass tiles;
  ParticlePass particles;
  Impostors impostors;
  std::uint32_t particle_features = 0;
  std::vector<const ResidentBatch*> batches;
  std::vector<ShadowLayer> shadows;  ///< of the sun's cascades
  std::vector<ShadowLayer> cover;    ///< one, where things may hide the sky
};

FrameFeatures ViewRenderer::Impl::features_of(const ContentFrame& frame, const ViewRequest& request,
                                              const FrameNumbers& n) const {
  FrameFeatures f;
  f.instancing = request.switches.instancing;
  f.snow = frame.surface.snow_depth_m > 0;
  f.wet = frame.surface.wetness > 0;
  f.sway = n.sway_factor > 0;
  if (request.samples == 4) f.all |= kFeatureMultisampled;
  if (n.uniforms.counts.x > 0) f.all |= kFeatureHaze;
  if (n.uniforms.counts.y > 0) f.all |= kFeatureLamps;
  if (f.wet) f.all |= kFeatureWet;
  if (!shadows.empty()) f.all |= kFeatureShadows;
  if (!cover.empty()) f.all |= kFeatureSkyCover;
  if (request.normals) f.all |= kFeatureNormals;
  return f;
}

Status ViewRenderer::Impl::make_shadows(const ViewCamera& camera, const CullOptions& options,
                                        FrameNumbers& numbers, const ViewRequest& request) {
  shadows.clear();
  cover.clear();
  if (!request.switches.shadows) return {};
  Eigen::AlignedBox3d box;
  bool any = false, leaves = false;
  double low_m = 1e300, high_m = -1e300;
  for (const ResidentBatch* b : batches) {
    box.extend(b->bounds);
    if (!b->prototype->prototype->casts_shadow) continue;
    any = true;
    leaves = leaves || b->prototype->leaves;
    low_m = std::min(low_m, b->batch->origin.z() + static_cast<double>(b->low_m));
    high_m = std::max(high_m, b->batch->origin.z() + static_cast<double>(b->high_m));
  }
  if (!any) return {};
  const Eigen::AlignedBox3d relative(Eigen::Vector3d(box.min() - camera.eye),
                                     Eigen::Vector3d(box.max() - camera.eye));
  view_gpu::ViewFrame& uniforms = numbers.uniforms;
  if (request.switches.sky_cover && high_m - low_m > kCoverRise_m) {
    const ZenithSettings settings;
    const ShadowCascade zenith = zenith_map(camera, relative, settings);
    if (auto s = resources.set_zenith_side(settings.side_px); !s) return s;
    uniforms.cascades[view_gpu::kZenith] = zenith.data(settings.side_px, camera.eye);
    set_covered(leaves, request.bands, uniforms);
    cover.push_back(resources.zenith().plan(0, zenith, batches, options, zenith.texel_m));
  }
  if (!numbers.sun) return {};
  const int side = shadow_side_px(request.pinhole, gpu().limits.maxImageDimension2D);
  const Eigen::Vector3d sun(static_cast<double>(uniforms.sun.x), static_cast<double>(uniforms.sun.y),
                            static_cast<double>(uniforms.sun.z));
  const auto cascades =
      shadow_cascades(camera, sun.normalized(), relative, {.side_px = side, .reach_m = kShadowReach_m});
  if (cascades.empty()) return {};
  if (auto s = resources.set_shadow_side(side); !s) return s;
  for (std::size_t i = 0; i < cascades.size(); ++i) {
    uniforms.cascades[i] = cascades[i].data(side, camera.eye);
    shadows.push_back(resources.shadow().plan(i, cascades[i], batches, options));
  }
  uniforms.counts.z = static_cast<std::uint32_t>(cascades.size());
  return {};
}

Status ViewRenderer::Impl::record_calls(std::span<const DrawCall> calls, FrameTargets::Pass pass,
                                        const FrameTargets::Part& part, bool instancing) {
  const bool depth_only = pass.writes == FrameTargets::Writes::depth;
  pass.clears_depth = pass.clears_colours = false;
  std::vector<DrawCall> pieces;
  if (progress.told) calls = pieces = in_pieces(calls, progress.total / Progress::kPieces);
  while (!calls.empty()) {
    std::size_t n = calls.size();
    double work = 0;
    if (progress.told) {
      n = 0;
      do work += work_of(calls[n++]);
      while (n < calls.size() && work < progress.total / Progress::kPieces);
    }
    if (depth_only)
      lists.record_depth(commands, calls.first(n), instancing);
    else
      lists.record(commands, calls.first(n), instancing);
    calls = calls.subspan(n);
    if (!progress.told) continue;
    vkCmdEndRendering(commands);
    if (auto s = submit(); !s) return s;
    progress.add(work);
    if (auto s = begin(); !s) return s;
    targets.begin_pass(commands, pass, part);
    bind_frame();
  }
  return {};
}

Status ViewRenderer::Impl::record_part(const FrameTargets::Part& part, std::span<const DrawCall> first,
                                       std::span<const DrawCall> second, bool first_is_done,
                                       const FrameFeatures& features) {
  if (!first_is_done) targets.record_begin(commands);
  const bool depth_first = (features.all & kFeatureAfterDepth) != 0;
  if (depth_first) {
    const FrameTargets::Pass pass{.writes = FrameTargets::Writes::depth, .clears_depth = !first_is_done};
    targets.begin_pass(commands, pass, part);
    bind_frame();
    if (!first_is_done)
      if (auto s = record_calls(first, pass, part, features.instancing); !s) return s;
    if (auto s = record_calls(second, pass, part, features.instancing); !s) return s;
    vkCmdEndRendering(commands);
  }
  const FrameTargets::Pass pass{.clears_depth = !depth_first && !first_is_done,
                                .clears_colours = depth_first || !first_is_done,
                                .resolves = !particles.any(),
                                .resolves_identity = true};
  targets.begin_pass(commands, pass, part);
  bind_frame();
  if (depth_first || !first_is_done)
    if (auto s = record_calls(first, pass, part, features.instancing); !s) return s;
  if (auto s = record_calls(second, pass, part, features.instancing); !s) return s;
  if (auto s = record_sky(commands, pipelines, features.all); !s) return s;
  vkCmdEndRendering(commands);
  if (particles.any()) {
    targets.begin_pass(commands, {.writes = FrameTargets::Writes::radiance, .resolves = true}, part);
    bind_frame();
    const std::uint32_t keep = features.all & (kFeatureMultisampled | kFeatureHaze);
    if (auto s = particles.record(commands, keep | particle_features); !s) return s;
    vkCmdEndRendering(commands);
  }
  targets.record_readback(commands, part);
  return {};
}

void ViewRenderer::Impl::read_back(const ViewRequest& request, ViewPicture& out) const {
  const Pinhole& p = request.pinhole;
  const std::size_t pixels = static_cast<std::size_t>(p.width_px) * p.height_px;
  out.width_px = p.width_px;
  out.height_px = p.height_px;
  out.radiance.assign(targets.radiance(), targets.radiance() + 4 * pixels);
  out.depth_m.resize(pixels);
  out.nodes.resize(pixels);
  const auto near_m = static_cast<float>(p.near_m);
  for (std::size_t i = 0; i < pixels; ++i) {
    out.depth_m[i] = near_m / targets.reversed_depth()[i];  // nothing there: 0, so infinity
    out.nodes[i] = lists.node(targets.identities()[i]).value;
  }
  out.normals.clear();
  if (!request.normals) return;
  out.normals.resize(3 * pixels);
  const Eigen::Matrix3f to_camera = request.T_world_camera.linear().transpose().cast<float>();
  for (std::size_t i = 0; i < pixels; ++i)
    if (const std::uint32_t packed = targets.packed_normals()[i]; packed != 0)
      Eigen::Map<Eigen::Vector3f>(&out.normals[3 * i]) = to_camera * unpacked_direction(packed);
}

Status ViewRenderer::Impl::draw(const ContentFrame& frame, const ViewRequest& request, ViewPicture& out,
                                ViewStatistics& s) {
  ++frame_number;
  const auto begun = Clock::now();
  textures->set_bands(request.bands);
  impostors.set_bands(request.bands);
  if (auto ok = resources.set_sky(frame.light.sky, request.bands); !ok) return ok;
  batches.clear();
  if (auto ok = take_over(frame, batches, s); !ok) return ok;
  const Pinhole& p = request.pinhole;
  if (auto ok = targets.prepare(p.width_px, p.height_px, request.samples, pipelines.colour_format(),
                                request.normals);
      !ok)
    return ok;
  s.upload_ms += ms_since(begun);

  const auto cull_begun = Clock::now();
  const ViewCamera camera(request);
  FrameNumbers numbers = frame_numbers(frame, request, camera, resources.sky(), resources.sky_scale());
  CullOptions options;
  options.frustum = request.switches.frustum_culling;
  options.levels = request.switches.levels_of_detail;
  options.impostors = request.switches.impostors;
  options.allowed_error_px = request.allowed_error_px;
  options.sway_factor = 1.5 * numbers.sway_factor;
  options.impostor = [this](const ResidentPrototype& prototype) {
    return impostors.get(prototype, frame_number);
  };
  std::vector<Bucket> all = cull(camera, batches, options);
  sort_by_distance(all);
  if (auto ok = make_shadows(camera, options, numbers, request); !ok) return ok;
  const std::size_t seen = count(all);
  if (seen + count(shadows) + count(cover) > lists.most_instances()) {
    // More than this picture needs: it can do without what is to be kept for others.
    forget_shadows();
    keep_no_shadows();
    if (auto ok = make_shadows(camera, options, numbers, request); !ok) return ok;
  }
  FrameFeatures features = features_of(frame, request, numbers);
  // With four samples most leaves show in one of them, and would be drawn twice for nothing.
  if (request.samples == 1 && has_holes(all)) features.all |= kFeatureAfterDepth;
  const bool whole = targets.rows_at_once() >= p.height_px;
  // Solid things first where they may hide others.
  std::vector<Bucket> solid;
  if (request.switches.occlusion_culling && whole) {
    std::vector<Bucket> rest;
    for (Bucket& b : all)
      (b.prototype->prototype->occludes && b.mesh != nullptr ? solid : rest).push_back(std::move(b));
    all = std::move(rest);
    if (all.empty()) std::swap(all, solid);
  }
  const std::size_t instances = seen + count(shadows) + count(cover);
  const auto drops = make_particles(camera, frame.precipitation, request.t);
  particle_features = frame.precipitation.kind == Precipitation::Kind::snow ? kFeatureSnow : 0U;
  s.cull_ms += ms_since(cull_begun);

  const auto draw_begun = Clock::now();
  if (auto ok = lists.begin(instances); !ok) return ok;
  if (auto ok = particles.prepare(drops); !ok) return ok;
  resources.write(numbers.uniforms);
  if (auto ok = begin(); !ok) return ok;
  uploads.record(commands);
  resources.record_begin(commands);
  if (auto ok = impostors.record(commands, resources.set()); !ok) return ok;
  double shadow_work = 0;
  for (auto* layers : {&shadows, &cover})
    for (ShadowLayer& l : *layers)
      for (auto [buckets, calls] : {std::pair{&l.still, &l.still_calls}, {&l.others, &l.other_calls}}) {
        auto added = lists.add_casters(*buckets, l.cascade.centre, features);
        if (!added) return tl::unexpected(added.error());
        count_calls(*added, features.instancing, s);
        shadow_work += work_of(*added);
        *calls = std::move(*added);
      }
  auto first = lists.add(solid, camera.eye, features);
  if (!first) return tl::unexpected(first.error());
  count_calls(*first, features.instancing, s);
  s.instances_drawn += count(solid);
  std::vector<DrawCall> second;
  const auto add_rest = [&]() -> Status {
    auto calls = lists.add(all, camera.eye, features);
    if (!calls) return tl::unexpected(calls.error());
    count_calls(*calls, features.instancing, s);
    s.instances_drawn += count(all);
    second = std::move(*calls);
    return lists.record_gather(commands, *content);
  };
  const bool two_steps = !solid.empty();
  if (!two_steps) {
    if (auto ok = add_rest(); !ok) return ok;
  } else if (auto ok = lists.record_gather(commands, *content); !ok) {
    return ok;
  }
  resources.shadow().record(commands, resources.set(), lists, shadows, features.instancing);
  resources.zenith().record(commands, resources.set(), lists, cover, features.instancing);
  progress = {request.progress};
  if (progress.told) {
    const int parts = (p.height_px + targets.rows_at_once() - 1) / targets.rows_at_once();
    const double times = ((features.all & kFeatureAfterDepth) != 0 ? 2 : 1) * parts;
    progress.total = shadow_work + times * (work_of(*first) + (two_steps ? work_of(all) : work_of(second)));
    if (auto ok = submit(); !ok) return ok;
    progress.add(shadow_work);
    if (auto ok = begin(); !ok) return ok;
  }
  if (two_steps) {
    const FrameTargets::Part part{0, p.height_px};
    targets.record_begin(commands);
    const bool depth_first = (features.all & kFeatureAfterDepth) != 0;
    const FrameTargets::Pass pass{
        .writes = depth_first ? FrameTargets::Writes::depth : FrameTargets::Writes::picture,
        .clears_depth = true,
        .clears_colours = !depth_first};
    targets.begin_pass(commands, pass, part);
    bind_frame();
    if (auto ok = record_calls(*first, pass, part, features.instancing); !ok) return ok;
    vkCmdEndRendering(commands);
    if (auto ok = tiles.record(commands, targets, p.width_px, p.height_px, request.samples == 4); !ok)
      return ok;
    if (auto ok = submit(); !ok) return ok;
    const auto again = Clock::now();
    const std::size_t before = count(all);
    drop_hidden(camera, tiles.read(p.width_px, p.height_px, p.near_m), options.sway_factor, all);
    s.instances_hidden = before - count(all);
    s.cull_ms += ms_since(again);
    if (auto ok = begin(); !ok) return ok;
    if (auto ok = add_rest(); !ok) return ok;
    progress.total = progress.done + (depth_first ? work_of(*first) + 2 * work_of(second)
                                                  : work_of(second));  // without what is hidden
    if (auto ok = record_part(part, *first, second, true, features); !ok) return ok;
  } else {
    for (int row = 0; row < p.height_px; row += targets.rows_at_once()) {
      const FrameTargets::Part part{row, std::min(targets.rows_at_once(), p.height_px - row)};
      if (auto ok = record_part(part, *first, second, false, features); !ok) return ok;
    }
  }
  if (auto ok = submit(); !ok) return ok;
  read_back(request, out);
  s.draw_ms += ms_since(draw_begun);
  drop_unseen();
  if (frame_number > kFramesKept) impostors.drop_older_than(frame_number - kFramesKept);
  return {};
}

ViewRenderer::ViewRenderer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ViewRenderer::~ViewRenderer() = default;

Result<std::unique_ptr<ViewRenderer>> ViewRenderer::create(std::shared_ptr<Device> device) {
  if (!device) return fail(ErrorCode::unavailable, "view", "expected a device, got none");
  auto impl = std::make_unique<Impl>(std::move(device));
  if (auto s = impl->create(); !s) return tl::unexpected(s.error());
  return std::unique_ptr<ViewRenderer>(new ViewRenderer(std::move(impl)));
}

ContentQuery ViewRenderer::query_for(const ViewRequest& request) {
  const ViewCamera camera(request);
  ContentQuery q;
  q.eye = camera.eye;
  q.t = request.t;
  const ViewSwitches& s = request.switches;
  q.allowed_error_rad = s.levels_of_detail ? request.allowed_error_px / camera.focal_px : 0.0;
  if (s.frustum_culling)
    for (const Eigen::Vector4d& plane : camera.planes)
      q.frustum.emplace_back(Eigen::Vector3d(plane.head<3>()), plane.w() - plane.head<3>().dot(camera.eye));
  if (s.shadows) q.shadow_reach_m = kCasterReach_m;
  return q;
}

Status ViewRenderer::draw(const ContentFrame& frame, const ViewRequest& request, ViewPicture& out,
                          ViewStatistics* statistics) {
  ViewStatistics unused;
  ViewStatistics& s = statistics != nullptr ? *statistics : unused;
  const double collect_ms = s.collect_ms;
  s = {};
  s.collect_ms = collect_ms;
  if (auto ok = check(request, impl_->gpu().limits); !ok) return ok;
  auto drawn = impl_->draw(frame, request, out, s);
  if (drawn || !impl_->forget_shadows()) return drawn;
  // It may be what is kept that left no room.
  s = {};
  s.collect_ms = collect_ms;
  drawn = impl_->draw(frame, request, out, s);
  if (drawn)
    impl_->keep_no_shadows();
  else
    impl_->forget_shadows();
  return drawn;
}

std::vector<std::string> ViewRenderer::pipelines() const { return impl_->pipelines.names(); }

}  // namespace rigor::render
