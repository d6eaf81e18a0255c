// What holds of every picture: same request, same bytes; regions; the ideal camera; hard places; the whole
// camera.
#include "sim/sensors/camera/simulated_camera.h"

#include <tbb/global_control.h>

#include <cmath>
#include <cstring>

#include "tests/sim/sensors/camera/plate_world.h"

namespace rigor::test {
namespace {

INSTANTIATE_TEST_SUITE_P(Engines, CameraOptics, ::testing::Values(CameraEngine::rays, CameraEngine::vulkan),
                         [](const auto& i) { return i.param == CameraEngine::rays ? "rays" : "vulkan"; });

/// Every effect of the optics.
CameraModel everything() {
  CameraModel m = small_camera();
  m.lens = {.k1 = -0.25, .k2 = 0.06};
  m.chromatic = {.magnification = {1.01, 1, 0.99}, .focus_shift_m = {0.2, 0, -0.2}};
  m.optics.pixel_pitch_m = 20e-6;
  m.optics.f_number = 2;
  m.depth_of_field = {.focus_distance_m = 2.5, .focal_length_m = 0.02};
  m.shutter = {.line_time_s = 0.0005, .motion_blur = true};
  return m;
}
void scenery(PlateWorld& w) {
  w.light().light.sky = even_sky(0.2F);
  w.light().light.ground_albedo = grey(0.3F);
  w.put({9, 9, 1e-3F}, {0, 5, -1}, 0.4F);
  w.put({0.3F, 0.3F, 0.5F}, {-0.6, 3, -0.5}, 0.8F);
  w.add({{0.2F, 0.2F, 0.2F}, [](double s) { return at_place({0.5 + 2 * s, 2, -0.2}); }, true, 0.6F});
}
Eigen::Isometry3d drift(BenchTime t) {
  Eigen::Isometry3d T = northward();
  T.translation() += Eigen::Vector3d(0.3, 0.5, 0) * seconds_of(t);
  return T;
}
OpticsOptions cheap() {
  OpticsOptions o;
  o.samples = PixelSamples::only(4);
  o.instants = 3;
  return o;
}

TEST_P(CameraOptics, ThreadsDoNotChangeAPicture) {
  scenery(world_);
  pose_ = drift;
  const OpticsRequest request{.measure = {.index = 3}, .exposure_s = 0.01, .seed = 5};
  GroundTruth truth, other;
  const OpticsPicture first = shoot(everything(), cheap(), request, &truth);
  for (const std::size_t threads : {1UL, 2UL, 4UL}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    const OpticsPicture again = shoot(everything(), cheap(), request, &other);
    EXPECT_EQ(again.radiance, first.radiance) << threads;
    EXPECT_EQ(other.range_m, truth.range_m);
    EXPECT_EQ(other.flow_px, truth.flow_px);
  }
}

TEST_P(CameraOptics, ARegionIsACropOfTheWholePicture) {
  scenery(world_);
  world_.add({{0.3F, 0.1F, 0.3F},
              [](double s) {
                Eigen::Isometry3d T = at_place({-0.1, 1.6, -0.3});
                T.rotate(Eigen::AngleAxisd(30 * s, Eigen::Vector3d(0.2, 0.1, 1).normalized()));
                return T;
              },
              true,
              0.7F});
  pose_ = drift;
  // As by default, which pixels have more samples depends on what the others see.
  OpticsOptions by_default = cheap();
  if (rays()) by_default.samples = {};
  OpticsOptions with_sky_rays = by_default;
  with_sky_rays.sky_rays = 2;
  for (const auto& [m, options] : {std::pair{small_camera(), cheap()},
                                   {everything(), cheap()},
                                   {everything(), by_default},
                                   {small_camera(), with_sky_rays}}) {
    OpticsRequest request{.measure = {.index = 3}, .exposure_s = 0.01, .seed = 5};
    GroundTruth truth, part_truth;
    const OpticsPicture whole = shoot(m, options, request, &truth);
    for (const OpticsRequest::Region& r :
         {OpticsRequest::Region{13, 9, 21, 17}, {0, 40, 64, 1}, {63, 47, 1, 1}}) {
      request.region = r;
      const OpticsPicture part = shoot(m, options, request, &part_truth);
      ASSERT_EQ(part.width_px, r.width_px);
      ASSERT_EQ(part.height_px, r.height_px);
      for (int v = 0; v < r.height_px; ++v)
        for (int u = 0; u < r.width_px; ++u) {
          for (int b = 0; b < 4; ++b)
            ASSERT_EQ(at(part, u, v, b), at(whole, u + r.x_px, v + r.y_px, b)) << u << " " << v << " " << b;
          ASSERT_EQ(part_truth.range_m[static_cast<std::size_t>(v * r.width_px + u)],
                    truth.range_m[static_cast<std::size_t>((v + r.y_px) * 64 + u + r.x_px)]);
        }
    }
    auto by = optics(m, cheap());
    OpticsPicture out;
    request.region = {60, 0, 5, 5};
    EXPECT_EQ(by->form(request, {world_, pose_}, out).error().code, ErrorCode::bad_input);
  }
}

TEST_P(CameraOptics, EffectsThatMeanNothingChangeNothing) {
  world_.light().light.sky = even_sky(0.2F);
  world_.put({9, 9, 1e-3F}, {0, 5, -1}, 0.4F);
  world_.put({0.3F, 0.3F, 0.5F}, {-0.6, 3, -0.5}, 0.8F);
  const OpticsPicture ideal = shoot(small_camera(), plain(), {.exposure_s = 0.01});
  CameraModel m = small_camera();
  m.shutter = {.line_time_s = 0.001, .motion_blur = true};  // nothing moves
  m.depth_of_field.focal_length_m = 0.02;                   // nothing is out of focus
  EXPECT_EQ(shoot(m, plain(), {.exposure_s = 0.01}).radiance, ideal.radiance);
}

TEST_P(CameraOptics, NothingButSkyInAnEmptyWorld) {
  world_.light().light.sky = even_sky(0.3F);
  pose_ = [](BenchTime) { return look({0, 0, 0}, {0, 1, 1.5}); };
  GroundTruth truth;
  const OpticsPicture p = shoot(everything(), cheap(), {}, &truth);
  for (int v = 0; v < 48; ++v)
    for (int u = 0; u < 64; ++u) ASSERT_NEAR(at(p, u, v), 0.3F, 0.003F) << u << " " << v;
  for (const auto n : truth.node) ASSERT_EQ(n, 0U);
}

TEST_P(CameraOptics, FarFromTheOriginLooksTheSame) {
  const Eigen::Vector3d far(100e3, -70e3, 500);
  scenery(world_);
  const OpticsPicture here = shoot(small_camera(), plain());
  PlateWorld there;
  there.light() = world_.light();
  there.put({9, 9, 1e-3F}, far + Eigen::Vector3d(0, 5, -1), 0.4F);
  there.put({0.3F, 0.3F, 0.5F}, far + Eigen::Vector3d(-0.6, 3, -0.5), 0.8F);
  there.add({{0.2F, 0.2F, 0.2F},
             [far](double) { return at_place(far + Eigen::Vector3d(0.5, 2, -0.2)); },
             false,
             0.6F});
  std::swap(world_, there);
  pose_ = [far](BenchTime) {
    Eigen::Isometry3d T = northward();
    T.translation() += far;
    return T;
  };
  EXPECT_LT(rms(shoot(small_camera(), plain()), here), 0.01 * 0.3);
}

TEST_P(CameraOptics, WithinABodyThereIsNoSun) {
  world_.light().light.sky = even_sky(0.2F);
  world_.put({2, 2, 2}, {0, 0, 0}, 0.5F);
  GroundTruth truth;
  const OpticsPicture p = shoot(small_camera(), plain(), {}, &truth);
  for (const float l : p.radiance) {
    ASSERT_TRUE(std::isfinite(l));
    ASSERT_LE(l, 0.5F) << "no sunlight";
  }
}

TEST_P(CameraOptics, AnInvalidRequestIsRefused) {
  auto by = optics(small_camera(), plain());
  OpticsPicture out;
  EXPECT_EQ(by->form({.exposure_s = std::nan("")}, {world_, pose_}, out).error().code, ErrorCode::bad_input);
  EXPECT_EQ(by->form({},
                     {world_,
                      [](BenchTime) {
                        return at_place({0, std::nan(""), 0});
                      }},
                     out)
                .error()
                .code,
            ErrorCode::bad_input);
}

// By how much the engines differ, where both measure the same light; most of it at edges and in the softness
// of shadows.
TEST_P(CameraOptics, BothEnginesAgree) {
  if (rays()) return;  // compared from the other one
  world_.put({9, 9, 1e-3F}, {0, 5, -1}, 0.4F);
  world_.put({0.3F, 0.3F, 0.5F}, {-0.6, 3, -0.5}, 0.8F);
  world_.put({0.2F, 0.2F, 0.2F}, {0.5, 2, -0.2}, 0.6F);
  pose_ = drift;
  world_.light().light.direction_to_sun = Eigen::Vector3d(-0.3, -1, 0.8).normalized();
  for (CameraModel m : {small_camera(), everything()}) {
    // With shadows, the view guesses what hides the sky, and rays gather what is there instead.
    OpticsOptions quick = fine();
    quick.shadows = rays();
    OpticsOptions o = quick;
    o.samples = PixelSamples::only(256);
    auto reference = make_rays_optics(m, o, std::shared_ptr<render::EmbreeCache>());
    ASSERT_TRUE(reference);
    OpticsPicture truth;
    const OpticsRequest request{.exposure_s = 0.01};
    ASSERT_TRUE((*reference)->form(request, {world_, pose_}, truth));
    double mean = 0;
    for (const float l : truth.radiance) mean += static_cast<double>(l);
    mean /= static_cast<double>(truth.radiance.size());
    const double error = rms(shoot(m, quick, request), truth) / mean;
    EXPECT_LT(error, 0.08);
    RecordProperty(m.depth_of_field.active() ? "rms_all" : "rms_ideal", std::to_string(error));
  }
}

TEST_P(CameraOptics, TheIdealCameraIsOneRayPerPixel) {
  if (!rays()) return;  // rays alone
  scenery(world_);
  OpticsOptions o = plain();
  o.sky_rays = 0;
  o.shadows = false;  // which would gather light
  const CameraModel m = small_camera();
  const OpticsPicture p = shoot(m, o);
  auto cache = render::EmbreeCache::create();
  ASSERT_TRUE(cache);
  auto engine = render::EmbreeEngine::create(*cache);
  ASSERT_TRUE(engine);
  ASSERT_TRUE((*engine)->prepare(world_.collect({}, BenchTime(0), BenchTime(0), 1)));
  render::LightTracer tracer(*engine);
  std::vector<render::Ray> rays;
  for (int v = 0; v < 48; ++v)
    for (int u = 0; u < 64; ++u) {
      const auto r = unproject_ray(m, {static_cast<double>(u), static_cast<double>(v)});
      const Eigen::Vector3f d =
          (northward().linear().cast<float>() * Eigen::Vector3d(r->x, r->y, r->z).cast<float>()).normalized();
      rays.push_back({.direction = {d.x(), d.y(), d.z()}});
    }
  std::vector<render::LightSample> light(rays.size());
  ASSERT_TRUE(tracer.trace({.rays = rays, .shadows = false, .spread_rad = 1.0F / 80}, light));
  for (std::size_t i = 0; i < rays.size(); ++i)
    for (std::size_t b = 0; b < 4; ++b) ASSERT_EQ(p.radiance[4 * i + b], light[i].radiance[b]) << i;
}

SimulatedCameraSpec spec_of(CameraEngine engine, const char* name) {
  SimulatedCameraSpec s;
  s.name = name;
  s.model = everything();
  s.seed = 7;
  s.engine = engine;
  s.optics = cheap();
  return s;
}

TEST_P(CameraOptics, ACaptureDependsOnItsRequestAlone) {
  scenery(world_);
  auto camera = SimulatedCamera::create(spec_of(GetParam(), "left"), {.device = device_});
  ASSERT_TRUE(camera) << camera.error().text();
  const CameraCapture a{.measure = {.index = 1}, .exposure = milliseconds(4)};
  const CameraCapture b{.measure = {.index = 2}, .exposure = milliseconds(4), .format = PixelFormat::rgb8};
  std::vector<std::byte> first((*camera)->bytes(a)), again(first.size()), colour((*camera)->bytes(b));
  EXPECT_EQ(first.size(), 64U * 48);
  EXPECT_EQ(colour.size(), 3U * 64 * 48);
  const render::SensorView view{world_, pose_};
  ASSERT_TRUE((*camera)->capture(a, view, first));
  ASSERT_TRUE((*camera)->capture(b, view, colour));
  ASSERT_TRUE((*camera)->capture(a, view, again));
  EXPECT_EQ(first, again);
  EXPECT_FALSE((*camera)->capture(a, view, std::span(again).first(10)));
}

TEST_P(CameraOptics, CamerasThatShareTheirEngineSeeWhatTheySeeAlone) {
  if (!rays()) return;  // rays alone
  scenery(world_);
  auto light = SharedLight::create(nullptr);
  ASSERT_TRUE(light);
  const CameraCapture request{.measure = {.index = 4}, .exposure = milliseconds(4)};
  std::vector<std::unique_ptr<SimulatedCamera>> sharing;
  std::vector<std::vector<std::byte>> alone;
  std::vector<render::PoseFunction> poses;
  for (int i = 0; i < 3; ++i) {
    // The third one stands in another cell and takes coarser levels.
    poses.push_back([i](BenchTime t) {
      Eigen::Isometry3d T = drift(t);
      T.translation() += Eigen::Vector3d(i == 2 ? -2.5 : 0.2 * i, 0, 0);
      return T;
    });
    auto spec = spec_of(CameraEngine::rays, i == 0 ? "left" : "right");
    if (i == 2) spec.optics.allowed_error_px = 4;
    auto camera = SimulatedCamera::create(spec), shares = SimulatedCamera::create(spec, {.light = *light});
    ASSERT_TRUE(camera && shares);
    alone.emplace_back(64UL * 48);
    ASSERT_TRUE((*camera)->capture(request, {world_, poses.back()}, alone.back()));
    sharing.push_back(std::move(*shares));
  }
  std::vector<std::byte> pixels(64UL * 48);
  for (const std::size_t i : {2, 0, 1, 2, 1, 0}) {
    ASSERT_TRUE(sharing[i]->capture(request, {world_, poses[i]}, pixels));
    EXPECT_EQ(pixels, alone[i]) << i;
  }
}

TEST_P(CameraOptics, APairIsTwoCamerasThatLookOnce) {
  scenery(world_);
  const auto left_spec = spec_of(GetParam(), "left"), right_spec = spec_of(GetParam(), "right");
  const render::PoseFunction left = drift, right = [](BenchTime t) {
    Eigen::Isometry3d T = drift(t);
    T.translation() += 0.2 * T.linear().col(0);
    return T;
  };
  const CameraCapture request{.measure = {.index = 4}, .exposure = microseconds(20)};
  std::vector<std::byte> pixels[4];
  for (auto& p : pixels) p.resize(64UL * 48);
  for (const int i : {0, 1}) {
    auto camera = SimulatedCamera::create(i == 0 ? left_spec : right_spec, {.device = device_});
    ASSERT_TRUE(camera);
    ASSERT_TRUE((*camera)->capture(request, {world_, i == 0 ? left : right}, pixels[i]));
  }
  auto pair = StereoCamera::create(left_spec, right_spec, {.device = device_});
  ASSERT_TRUE(pair) << pair.error().text();
  const int before = world_.collected();
  ASSERT_TRUE((*pair)->capture(request, world_, {left, pixels[2]}, {right, pixels[3]}));
  EXPECT_EQ(world_.collected() - before, 1);
  EXPECT_EQ(pixels[2], pixels[0]);
  EXPECT_EQ(pixels[3], pixels[1]);
  EXPECT_TRUE(pixels[2] != pixels[3]);
}

}  // namespace
}  // namespace rigor::test
