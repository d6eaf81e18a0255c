// A simulated sensor in front of an even light, and stacks of its frames.
#pragma once

#include <gtest/gtest.h>

#include <cstring>

#include "calibration/photon/photon_fit.h"
#include "tests/sim/sensors/camera/sensor_stage_fixture.h"

namespace rigor::calibration {

/// Every noise of the model at once; its pixel is full before its converter is.
inline CameraModel noisy_camera(int width = 80, int height = 64) {
  CameraModel m = test::quiet_camera(width, height);
  m.noise.system_gain_dn_per_e = 0.38;
  m.noise.black_level_dn = 60;
  m.noise.full_well_e = 8000;
  m.noise.read_noise_e = 2.3;
  m.noise.dark_current_e_per_s = 200;
  m.noise.dsnu_e = 1.2;
  m.noise.prnu = 0.008;
  m.noise.shot_noise = true;
  return m;
}

struct Bench {
  CameraModel model;
  double electrons_per_s = 1e5;  ///< of the light
  std::unique_ptr<SensorStage> stage;
  std::uint64_t index = 0;
  PixelFormat format = PixelFormat::mono16;
  OpticsPicture bright, black;

  Bench(const CameraModel& m, std::uint64_t seed) : model(m), stage(test::make_stage(m, true, seed)) {
    bright = test::even_picture(m, electrons_per_s, 1.0);
    black = bright;
    std::fill(black.radiance.begin(), black.radiance.end(), 0.0f);
  }
  std::vector<std::uint16_t> frame(double exposure_s, bool light) {
    const auto bytes = test::shoot(*stage, light ? bright : black,
                                   {.capture_index = ++index, .exposure_s = exposure_s, .format = format},
                                   model.width_px, model.height_px);
    std::vector<std::uint16_t> out(static_cast<std::size_t>(model.width_px) *
                                   static_cast<std::size_t>(model.height_px));
    if (format == PixelFormat::mono16)
      std::memcpy(out.data(), bytes.data(), bytes.size());
    else
      for (std::size_t i = 0; i < out.size(); ++i) out[i] = std::to_integer<std::uint16_t>(bytes[i]);
    return out;
  }
};

struct Series {
  std::vector<double> dark_s{0.002, 0.05, 0.1, 0.2};
  std::vector<double> light_s{0.001, 0.002, 0.004, 0.007, 0.010, 0.015, 0.02, 0.027,
                              0.035, 0.045, 0.055, 0.065, 0.072, 0.1,   0.13};
  int frames = 6;
  double temperature_c = std::nan("");
};

inline void take(FrameStacks& stacks, Bench& bench, const Series& s,
                 const std::function<void(std::vector<std::uint16_t>&)>& spoil = {}) {
  for (const bool light : {false, true})
    for (const double t : light ? s.light_s : s.dark_s)
      for (int i = 0; i < s.frames; ++i) {
        auto pixels = bench.frame(t, light);
        if (spoil) spoil(pixels);
        const PhotonFrame f{(light ? "light" : "dark") + std::to_string(t) + "_" + std::to_string(i), t,
                            light, s.temperature_c, 0};
        const Status added = stacks.add(f, pixels, bench.model.width_px, bench.model.height_px);
        ASSERT_TRUE(added) << added.error().text();
      }
}

inline bool not_identifiable(const FitResult& r, const std::string& name, const std::string& word = "") {
  for (const auto& [n, why] : r.not_identifiable)
    if (n == name) return why.find(word) != std::string::npos;
  return false;
}

inline std::string all_words(const FitResult& r) {
  std::string s;
  for (const auto& p : r.parameters)
    s += p.name + " " + std::to_string(p.value) + " ± " + std::to_string(p.sigma) + "\n";
  for (const auto& [n, why] : r.not_identifiable) s += n + ": " + why + "\n";
  for (const auto& w : r.warnings) s += w + "\n";
  return s;
}

}  // namespace rigor::calibration
