#include "benches/bench_calibration_lidar.h"

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <nlohmann/json.hpp>

#include "tests/calibration/lidar/simulated_room.h"

namespace rigor::bench {

using namespace calibration;

nlohmann::json lidar_rows() {
  nlohmann::json rows = nlohmann::json::array();
  std::printf("\nLiDAR, 16 beams, a room of four walls: walls, noise, biases, remission\n");
  std::printf("%-24s %9s  %7s %7s\n", "models", "returns", "all s", "cpu s");
  test::Truth truth;
  truth.model = test::sixteen_beams(0.4);
  for (std::size_t b = 0; b < 16; ++b)
    truth.model.scan.beams[b].range_bias_m = 0.004 * (static_cast<double>(b * 7 % 16) - 7.5);
  const LidarReturns returns = test::measure(truth, 70, 1);
  for (const bool all : {false, true}) {
    LidarFitOptions options;
    if (!all) options.model = "beams", options.noise_model = "offset";
    const auto begin = std::chrono::steady_clock::now();
    const std::clock_t cpu = std::clock();
    const auto fit = fit_lidar(returns, test::sixteen_beams(0.4), options);
    const double cpu_s = static_cast<double>(std::clock() - cpu) / CLOCKS_PER_SEC;
    const double all_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    if (!fit) {
      std::fprintf(stderr, "bench: %s\n", fit.error().text().c_str());
      std::exit(1);
    }
    const char* name = all ? "all that there are" : "beams, offset";
    std::printf("%-24s %9zu  %7.2f %7.2f   chosen: %s\n", name, returns.all.size(), all_s, cpu_s,
                fit->result.model.c_str());
    nlohmann::json row = {{"models", name},
                          {"returns", returns.all.size()},
                          {"all_s", all_s},
                          {"cpu_s", cpu_s},
                          {"model", fit->result.model}};
    const auto compare = [&](const std::string& parameter, double value) {
      const Parameter* p = fit->result.find(parameter);
      if (!p) return;
      row["parameters"].push_back(
          {{"name", parameter}, {"truth", value}, {"error", p->value - value}, {"sigma", p->sigma}});
      std::printf("    %-24s truth %9.5f  error %+9.6f  its sigma %9.6f\n", parameter.c_str(), value,
                  p->value - value, p->sigma);
    };
    for (const std::size_t b : {0U, 5U, 10U, 15U})
      compare("beam_bias_m[" + std::to_string(b) + "]", truth.model.scan.beams[b].range_bias_m);
    compare("noise_scale_m", truth.model.noise.scale_m);
    compare("noise_offset", truth.model.noise.offset);
    compare("remission_noise", truth.model.remission.noise);
    std::fflush(stdout);
    rows.push_back(row);
  }
  return rows;
}

}  // namespace rigor::bench
