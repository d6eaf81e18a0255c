// The sensor stage against the GPU's sensor pass: one model, one set of counters, two machines.
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "sim/sensors/camera/sensor_stage.h"
#include "tests/sim/render/render_fixture.h"

namespace rigor {
namespace {

class StageAndGpu : public test::RenderTest {};

// A plane that fills the view and shines alike everywhere: what the raster pass draws in electrons per second
// is handed to the CPU's stage as radiance.
TEST_F(StageAndGpu, DrawTheSameNoiseOnAFlatField) {
  CameraSpec c = spec();
  c.noise = true;
  c.seed = 5;
  c.model.noise.shot_noise = true;
  c.model.noise.read_noise_e = 6;
  c.model.noise.dsnu_e = 3;
  c.model.noise.prnu = 0.01;
  c.model.noise.dark_current_e_per_s = 500;
  c.model.noise.temperature_c = 36;
  c.model.noise.black_level_dn = 40;
  c.model.vignetting.cos4_weight = 1;
  c.model.optics.mono_efficiency = {0.5, 0, 0, 0};
  c.model.optics.colour_efficiency = {{{0.5, 0, 0, 0}, {0, 0.5, 0, 0}, {0, 0, 0.5, 0}}};
  c.T_parent_sensor = look_at({0, 0, 3}, {0, 0.001, 0});
  world::Scene scene = plain_scene();
  scene.ground->noise_contrast = 0;
  scene.materials[0].reflectance = {0.5, 0.4, 0.3, 0.2};

  for (const PixelFormat f : {PixelFormat::mono16, PixelFormat::bayer_rg12, PixelFormat::rgb8}) {
    c.format = f;
    auto camera = make(c, scene);
    ASSERT_TRUE(camera);
    const double exposure_s = 0.003;
    const CaptureRequest q{.capture_index = 12, .exposure = Duration(3'000'000), .gain_db = 3};
    const auto gpu = shoot(*camera, q);

    render::PictureRequest linear;
    linear.T_world_sensor = c.T_parent_sensor;
    linear.exposure_s = exposure_s;
    linear.region = {0, 0, c.model.width_px, c.model.height_px};
    const auto ideal = camera->renderer().draw_linear(linear, world::WorldSnapshot(camera->scene()));
    ASSERT_TRUE(ideal) << ideal.error().text();
    const auto rate = c.model.electron_rate_per_radiance({0.5, 0.5, 0.5, 0});
    const std::size_t centre = static_cast<std::size_t>(ideal->channels) *
                               (static_cast<std::size_t>(ideal->height_px / 2) * ideal->width_px +
                                static_cast<std::size_t>(ideal->width_px / 2));
    OpticsPicture p{c.model.width_px, c.model.height_px, {}};
    const std::size_t pixels = static_cast<std::size_t>(p.width_px) * p.height_px;
    p.radiance.assign(4 * pixels, 0.0f);
    for (std::size_t i = 0; i < pixels; ++i)
      for (std::size_t b = 0; b < (ideal->channels == 1 ? 1u : 3u); ++b)
        p.radiance[4 * i + b] = ideal->electrons_per_second[centre + b] / static_cast<float>(rate[b]);
    const double electrons = ideal->electrons_per_second[centre] * exposure_s;
    EXPECT_GT(electrons, 300) << "bright enough to tell";
    EXPECT_LT(electrons, 9000) << "and not saturated";

    auto stage = SensorStage::create({.name = c.name, .model = c.model, .seed = c.seed});
    ASSERT_TRUE(stage);
    std::vector<std::byte> cpu(gpu.size());
    ASSERT_TRUE(
        (*stage)->expose({.capture_index = 12, .exposure_s = exposure_s, .gain_db = 3, .format = f}, p, cpu));
    // The rates differ by two roundings (2.4e-7 of a thousand electrons), normal draws by 4e-6 of a sigma of
    // thirty: 4e-4 electrons, so that one draw in some thousands falls on the other side of a whole electron,
    // and then by one number at K below 1 DN per electron.
    const std::size_t step = has_words(f) ? 2 : 1;
    std::size_t different = 0;
    for (std::size_t i = 0; i < gpu.size(); i += step) {
      const auto at = [&](const std::vector<std::byte>& v) {
        return std::to_integer<int>(v[i]) | (step == 2 ? std::to_integer<int>(v[i + 1]) << 8 : 0);
      };
      ASSERT_NEAR(at(cpu), at(gpu), 1) << pfnc_name(f) << " at " << i / step;
      different += at(cpu) != at(gpu) ? 1 : 0;
    }
    EXPECT_LT(static_cast<double>(different), 0.001 * static_cast<double>(gpu.size() / step)) << pfnc_name(f);
    if (std::getenv("RIGOR_VERBOSE") != nullptr)
      std::printf("%s: %zu of %zu differ, %.0f e-\n", std::string(pfnc_name(f)).c_str(), different,
                  gpu.size() / step, electrons);
  }
}

}  // namespace
}  // namespace rigor
