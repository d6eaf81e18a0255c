#include "benches/bench_calibration_tof.h"

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <nlohmann/json.hpp>

#include "calibration/tof/range_fit.h"
#include "tests/calibration/tof/synthetic_tof.h"

namespace rigor::bench {
namespace {

using namespace calibration;

template <class T>
T need(Result<T> r) {
  if (r) return std::move(*r);
  std::fprintf(stderr, "bench: %s\n", r.error().text().c_str());
  std::exit(1);
}

struct Clock {
  std::chrono::steady_clock::time_point at = std::chrono::steady_clock::now();
  double lap_s() {
    const auto now = std::chrono::steady_clock::now();
    const double s = std::chrono::duration<double>(now - at).count();
    at = now;
    return s;
  }
};

}  // namespace

nlohmann::json tof_rows() {
  nlohmann::json rows = nlohmann::json::array();
  std::printf("\ntime of flight, 176x144 px, a plane at ten distances, temporal noise and ranges\n");
  std::printf("%-22s %8s  %7s %7s %7s %8s %7s %7s\n", "models", "ranges", "sort s", "noise s", "law s",
              "ranges s", "all s", "CPU s");
  for (const bool all : {false, true}) {
    SyntheticTof t{.model = small_tof(176, 144), .offset_m = 0.02, .distance_sigma_m = 1e-3, .tilt = 0.03};
    t.remission = 0.4;
    models::TofModel nominal = t.model;
    nominal.modulation.waveform = models::TofWaveform::sine;
    nominal.modulation.harmonics = {};
    nominal.pixel.range_offset_sigma_m = 0;
    auto frames = record_plane(t, {0.7, 0.9, 1.1, 1.3, 1.5, 1.7, 1.9, 2.1, 2.3, 2.5}, 4, 1);
    const std::size_t count = frames.size() * frames[0].range_m.size();
    Clock clock;
    const std::clock_t cpu = std::clock();
    const TofScenes scenes = need(sort_scenes(std::move(frames), {}));
    const double sort_s = clock.lap_s();
    const LocalNoise noise = need(temporal_noise(scenes, nominal));
    const double noise_s = clock.lap_s();
    const NoiseLawFit law = need(all ? fit_noise_law(noise.bins, {})
                                     : fit_noise_law(noise.bins, {.laws = {NoiseLaw::shot_read}}));
    const double law_s = clock.lap_s();
    RangeFitOptions options;
    options.distance_sigma_m = 1e-3;
    if (!all) options.models = {{2, false, false}};
    const RangeFit fit = need(fit_ranges(scenes, nominal, &law.noise, options));
    const double ranges_s = clock.lap_s();
    const double cpu_s = static_cast<double>(std::clock() - cpu) / CLOCKS_PER_SEC;
    const char* name = all ? "all that there are" : "harmonics2, shot_read";
    std::printf("%-22s %8zu  %7.2f %7.2f %7.2f %8.2f %7.2f %7.2f\n", name, count, sort_s, noise_s, law_s,
                ranges_s, sort_s + noise_s + law_s + ranges_s, cpu_s);
    nlohmann::json row = {{"models", name},
                          {"ranges", count},
                          {"sort_s", sort_s},
                          {"noise_s", noise_s},
                          {"noise_law_s", law_s},
                          {"ranges_s", ranges_s},
                          {"all_s", sort_s + noise_s + law_s + ranges_s},
                          {"cpu_s", cpu_s},
                          {"model", fit.result.model}};
    for (const auto& [parameter, truth] :
         std::initializer_list<std::pair<const char*, double>>{{"range_offset_m", 0.02},
                                                               {"harmonic_3", 0.03},
                                                               {"harmonic_5", 0.01},
                                                               {"pixel_offset_sigma_m", 3e-3}}) {
      const Parameter* p = fit.result.find(parameter);
      if (!p) continue;
      row["parameters"].push_back(
          {{"name", parameter}, {"truth", truth}, {"error", p->value - truth}, {"sigma", p->sigma}});
      std::printf("    %-24s truth %8.5f  error %+9.6f  its sigma %9.6f\n", parameter, truth,
                  p->value - truth, p->sigma);
    }
    std::fflush(stdout);
    rows.push_back(row);
  }
  return rows;
}

}  // namespace rigor::bench
