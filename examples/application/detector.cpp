// The detector of detector.py in C++, as a program and as a shared object:
//   rigor run demo --clock virtual --set "application={command: [$PWD/build/detector]}"
//   rigor run demo --clock virtual --set "application={library: $PWD/build/libdetector.so}"
#include <algorithm>

#include "rigor_client.h"

class Detector : public rigor_client::Application {
 public:
  double rate_hz() const override { return 50; }
  void start(const rigor_client::Rig& rig) override { gain_ = rig.params.value("gain_degps_per_px", 0.1); }
  void step(rigor_client::Turn& turn) override {
    const rigor_client::Port& camera = turn["right"];
    if (camera.fresh()) {
      const auto width = camera.sample().info<rigor_client::ImageInfo>().width_px;
      const auto pixels = camera.sample().pixels<std::uint8_t>();
      std::vector<std::uint64_t> columns(width);
      for (std::size_t i = 0; i < pixels.size(); ++i) columns[i % width] += pixels[i];
      const auto brightest = std::max_element(columns.begin(), columns.end()) - columns.begin();
      rate_degps_ = gain_ * (static_cast<double>(brightest) - width / 2.0);
    }
    turn.command("table_command", {1, rate_degps_});
  }

 private:
  double gain_ = 0, rate_degps_ = 0;
};

RIGOR_APPLICATION(Detector)
