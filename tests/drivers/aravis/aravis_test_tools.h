// What tests of the Aravis source share: a channel's configuration from YAML, an emulated camera with stamped
// pictures, and a loop that polls.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <memory>
#include <string>
#include <vector>

#include "drivers/aravis/gige_emulator.h"
#include "sensor-hal/channel/channel.h"
#include "tests/drivers/aravis/stamped_picture.h"

namespace rigor::testing {

inline BenchTime now() { return bench_now(); }

inline ChannelConfig make_config(const std::string& keys, Duration period = milliseconds(40),
                                 Duration latency = milliseconds(60)) {
  auto params = ConfigDocument::parse(keys, "rig.yaml");
  if (!params) throw std::runtime_error(params.error().text());
  ChannelConfig c;
  c.name = "cam";
  c.kind = SampleKind::image;
  c.period = period;
  c.latency = latency;
  c.params = *params;
  return c;
}

inline std::unique_ptr<gige::GigeEmulator> start_camera(const std::string& address, const std::string& serial,
                                                        gige::FillFrame fill = gige::testing::fill_stamped,
                                                        gige::GigeCameraConfig config = {}) {
  using gige::PixelFormat;
  gige::GigeEmulatorOptions o;
  o.address = address;
  if (config.formats.size() == 1)
    config.formats = {PixelFormat::mono8,      PixelFormat::mono10,     PixelFormat::mono12,
                      PixelFormat::mono12p,    PixelFormat::mono16,     PixelFormat::bayer_rg8,
                      PixelFormat::bayer_rg10, PixelFormat::bayer_rg12, PixelFormat::bayer_rg16,
                      PixelFormat::rgb8};
  config.serial = serial;
  o.camera = config;
  auto camera = gige::GigeEmulator::start(o, std::move(fill));
  if (!camera) throw std::runtime_error(camera.error().text());
  return std::move(*camera);
}

struct Seen {
  Stamp stamp;
  ImageInfo image;
  std::size_t bytes = 0;
  gige::testing::Verdict verdict;
};

inline void collect(Source& source, std::vector<Seen>& seen) {
  const BenchTime t = now();
  source.begin_cycle(t);
  while (auto lease = source.poll(t)) {
    Seen s;
    s.stamp = lease->stamp;
    s.image = *lease->as<ImageInfo>();
    s.bytes = lease->bytes().size();
    const auto b = lease->bytes();
    s.verdict = gige::testing::judge_stamped(
        {reinterpret_cast<const std::uint8_t*>(b.data()), b.size()},
        static_cast<std::uint64_t>((lease->stamp.t_capture - s.image.exposure / 2).ns()));
    seen.push_back(std::move(s));
  }
}

/// A loop of about 1 kHz.
inline std::vector<Seen> run_for(Source& source, Duration d) {
  std::vector<Seen> seen;
  const BenchTime end = now() + d;
  while (now() < end) {
    collect(source, seen);
    usleep(900);
  }
  return seen;
}

}  // namespace rigor::testing
