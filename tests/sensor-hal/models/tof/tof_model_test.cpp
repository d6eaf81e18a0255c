// Time-of-flight models as numbers and as files.
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <string>

#include "sensor-hal/models/tof/tof_math.h"
#include "sensor-hal/models/tof/tof_yaml.h"
#include "tests/paths.h"

namespace rigor::models {
namespace {

constexpr const char* kSmall = "width_px: 8\nheight_px: 6\nintrinsics: { fx_px: 10 }\n";

Result<TofModel> parse(const std::string& text) {
  auto root = ConfigDocument::parse(text, "tof.yaml");
  if (!root) return tl::unexpected<Error>(root.error());
  return parse_tof_model(*root);
}
std::string complaint(const std::string& text) {
  const auto model = parse(text);
  return model ? "accepted" : model.error().text();
}

TEST(TofModel, UnambiguousRangesAreThoseOfTheSr4000sFrequencies) {
  TofModel m;
  for (const auto& [f_hz, range_m] :
       {std::pair{30e6, 5.00}, {15e6, 9.99}, {29e6, 5.17}, {31e6, 4.84}, {14.5e6, 10.34}, {15.5e6, 9.67}}) {
    m.modulation.frequencies_hz = {f_hz};
    EXPECT_NEAR(m.unambiguous_range_m(), range_m, 0.0051);
  }
  m.modulation.frequencies_hz = {80e6, 100e6};
  EXPECT_NEAR(m.unambiguous_range_m(), 299792458.0 / (2 * 20e6), 1e-9);
}

TEST(TofModel, ExposuresLieEvenlyAboutTheCapture) {
  TofModel m;
  m.modulation.integration_time_s = 1e-3;
  m.modulation.tap_window_s = 8e-3;
  EXPECT_EQ(m.exposures(), 4);
  for (int k = 0; k < 4; ++k) EXPECT_NEAR(m.exposure_offset_s(k), (k - 1.5) * 2e-3, 1e-12);
  m.modulation.taps = TofTaps::differential;
  EXPECT_EQ(m.exposures(), 2);
  EXPECT_NEAR(m.exposure_offset_s(1), 2e-3, 1e-12);
  m.modulation.frequencies_hz = {30e6, 20e6, 50e6};
  EXPECT_EQ(m.exposures(), 6);
  m.modulation.tap_window_s = 0;
  EXPECT_NEAR(m.effective_tap_window_s(), 6e-3, 1e-12);
}

TEST(TofModel, ElectronsAreCountedAsPhotonsAre) {
  TofModel m;
  // By hand: 1 W/sr on a white surface at 2 m gives 1/4 W/m² and 1/(4 pi) W/(m² sr); f/1.4, 0.9: irradiance
  // of the pixel pi/4 · 0.9/1.96 of that, times 144 um², 0.8, 1 ms, photons of 2.337e-19 J.
  const double photon_J = 6.62607015e-34 * 299792458.0 / 850e-9;
  const double expected = (1.0 / 4 / M_PI) * (M_PI / 4 * 0.9 / 1.96) * 144e-12 * 0.8 * 1e-3 / photon_J;
  EXPECT_NEAR(m.active_electrons(2), expected, 1e-9 * expected);
  EXPECT_NEAR(m.active_electrons(4, 0.5), expected / 8, 1e-9 * expected);
}

TEST(TofModel, RefusesWhatCannotBe) {
  const auto refused = [](auto change) {
    TofModel m;
    change(m);
    const auto s = m.validate();
    return s ? std::string("accepted") : s.error().message;
  };
  EXPECT_EQ(refused([](TofModel&) {}), "accepted");
  EXPECT_NE(refused([](TofModel& m) { m.width_px = 4097; }).find("width_px: expected a value in [1, 4096]"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) { m.fx_px = NAN; }).find("fx_px"), std::string::npos);
  EXPECT_NE(refused([](TofModel& m) { m.modulation.frequencies_hz.clear(); }).find("1 to 8"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) {
              m.modulation.frequencies_hz = {1e6, 2e6, 3e6, 4e6, 5e6, 6e6, 7e6, 8e6, 9e6};
            }).find("1 to 8"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) {
              m.modulation.frequencies_hz = {30e6, 30e6};
            }).find("differ"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) {
              m.modulation.frequencies_hz = {100e6, 99999999};
            }).find("divisor"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) { m.range_error.offset_m = NAN; }).find("range_error.offset_m"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) {
              m.range_error.wiggling = {1, 2, {0, 0, 0}};
            }).find("4 to 64 coefficients"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) {
              m.range_error.wiggling = {2, 1, {0, 0, 0, 0}};
            }).find("from_m < to_m"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) {
              m.range_error.wiggling = {1, 2, {0, 0, 0, INFINITY}};
            }).find("coefficients in"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) { m.sampling.samples = 5; }).find("1, 4, 9 or 16"), std::string::npos);
  EXPECT_NE(refused([](TofModel& m) { m.filters.median_px = 4; }).find("0, 3 or 5"), std::string::npos);
  EXPECT_NE(refused([](TofModel& m) {
              m.limits.min_range_m = 3;
              m.limits.max_range_m = 2;
            }).find("limits.max_range_m"),
            std::string::npos);
  EXPECT_NE(refused([](TofModel& m) {
              m.width_px = m.height_px = 4096;
              m.sampling.samples = 16;
            }).find("rays in a frame"),
            std::string::npos);
  // Taps cannot be negative: 0.9 · (1 + 0.2) > 1.
  EXPECT_NE(refused([](TofModel& m) {
              m.modulation.contrast = 0.9;
              m.modulation.waveform = TofWaveform::harmonics;
              m.modulation.harmonics = {0.2};
            }).find("negative"),
            std::string::npos);
  EXPECT_EQ(refused([](TofModel& m) {
              m.modulation.contrast = 0.8;
              m.modulation.waveform = TofWaveform::triangle;
            }),
            "accepted");
}

TEST(TofYaml, ReadsWhatIsWrittenAndDefaultsTheRest) {
  const auto m =
      parse(std::string(kSmall) +
            "lens: { k1: -0.1 }\n"
            "modulation: { frequencies_mhz: [80, 100], contrast: 0.6, taps: differential,\n"
            "  waveform: harmonics, harmonics: [0.05, -0.01], sine_like_noise: false,\n"
            "  integration_time_ms: 2, unwrap_tolerance_m: 0.2 }\n"
            "illumination: { wavelength_nm: 905, radiant_intensity_w_per_sr: 3 }\n"
            "optics: { filter_width_nm: 20 }\n"
            "pixel: { full_well_e: 5000, adc_bits: 10, range_offset_sigma_mm: 4, trembling: false }\n"
            "range_error: { offset_mm: 12, amplitude_error_mm_e: 40000,\n"
            "  wiggling_spline: { from_m: 0.5, to_m: 2.5, coefficients_mm: [0, 2, -1, 3, 1] } }\n"
            "sampling: { samples: 9, bilinear: true, multipath_rays: 2 }\n"
            "limits: { max_range_m: 6 }\n"
            "filters: { median_px: 5 }\n");
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_EQ(m->width_px, 8);
  EXPECT_EQ(m->fy_px, 10);
  EXPECT_EQ(m->cx_px, 3.5);
  EXPECT_EQ(m->lens.k1, -0.1);
  ASSERT_EQ(m->modulation.frequencies_hz.size(), 2u);
  EXPECT_DOUBLE_EQ(m->modulation.frequencies_hz[1], 100e6);
  EXPECT_EQ(m->modulation.taps, TofTaps::differential);
  EXPECT_EQ(m->modulation.harmonics[1], -0.01);
  EXPECT_TRUE(m->modulation.wiggling_bias);
  EXPECT_FALSE(m->modulation.sine_like_noise);
  EXPECT_DOUBLE_EQ(m->modulation.integration_time_s, 2e-3);
  EXPECT_DOUBLE_EQ(m->illumination.wavelength_m, 905e-9);
  EXPECT_DOUBLE_EQ(m->optics.filter_width_m, 20e-9);
  EXPECT_FALSE(m->pixel.trembling);
  EXPECT_DOUBLE_EQ(m->pixel.range_offset_sigma_m, 4e-3);
  EXPECT_DOUBLE_EQ(m->range_error.offset_m, 12e-3);
  EXPECT_DOUBLE_EQ(m->range_error.amplitude_error_m_e, 40);
  EXPECT_EQ(m->range_error.wiggling.to_m, 2.5);
  ASSERT_EQ(m->range_error.wiggling.coefficients_m.size(), 5u);
  EXPECT_DOUBLE_EQ(m->range_error.wiggling.coefficients_m[3], 3e-3);
  EXPECT_EQ(m->sampling.samples, 9);
  EXPECT_TRUE(m->sampling.bilinear);
  EXPECT_EQ(m->limits.max_range_m, 6);
  EXPECT_EQ(m->filters.median_px, 5);
}

TEST(TofYaml, ComplainsAboutASplineThatIsNone) {
  const auto spline = [](const std::string& w) {
    return complaint(std::string(kSmall) + "range_error: { wiggling_spline: {" + w + "} }\n");
  };
  EXPECT_NE(spline(" from_m: 1, to_m: 2, coefficients_mm: [1, 2, 3] ").find("4 to 64 coefficients"),
            std::string::npos);
  EXPECT_NE(spline(" from_m: 2, to_m: 1, coefficients_mm: [1, 2, 3, 4] ").find("from_m < to_m"),
            std::string::npos);
  EXPECT_NE(spline(" from_m: 2, coefficients_mm: [1, 2, 3, 4] ").find("to_m"), std::string::npos);
}

TEST(TofYaml, ComplainsWithLineAndColumn) {
  EXPECT_EQ(complaint("height_px: 6\nintrinsics: { fx_px: 10 }\n").substr(0, 12), "tof.yaml:1:1");
  const std::string unknown = complaint(std::string(kSmall) + "pixel:\n  full_wel_e: 5\n");
  EXPECT_NE(unknown.find("tof.yaml:5:3"), std::string::npos) << unknown;
  EXPECT_NE(unknown.find("did you mean full_well_e"), std::string::npos) << unknown;
  const std::string large = complaint("width_px: 5000\nheight_px: 6\nintrinsics: { fx_px: 10 }\n");
  EXPECT_NE(large.find("tof.yaml:1:11"), std::string::npos) << large;
  EXPECT_NE(large.find("4096"), std::string::npos) << large;
  const std::string many =
      complaint(std::string(kSmall) + "modulation: { frequencies_mhz: [1, 2, 3, 4, 5, 6, 7, 8, 9] }\n");
  EXPECT_NE(many.find("tof.yaml:4:"), std::string::npos) << many;
  EXPECT_NE(many.find("1 to 8"), std::string::npos) << many;
  EXPECT_NE(complaint(std::string(kSmall) + "sampling: { samples: 5 }\n").find("samples"), std::string::npos);
  EXPECT_NE(complaint(std::string(kSmall) + "modulation: { waveform: square }\n").find("triangle"),
            std::string::npos);
  // What only the whole shows has the place of the document.
  EXPECT_NE(
      complaint(std::string(kSmall) + "modulation: { frequencies_mhz: [30, 30] }\n").find("tof.yaml:1:1"),
      std::string::npos);
  EXPECT_EQ(load_tof_model("/nowhere/at/all.yaml").error().code, ErrorCode::not_found);
}

TEST(TofYaml, TheSensorsOfTheHouseLoad) {
  const std::filesystem::path sensors =
      std::filesystem::path(rigor::test::source_dir()) / "configs" / "sensors";
  const auto sr4000 = load_tof_model(sensors / "sr4000.yaml");
  ASSERT_TRUE(sr4000) << sr4000.error().text();
  EXPECT_NEAR(sr4000->unambiguous_range_m(), 5.00, 0.005);
  for (const char* name : {"azure-kinect-nfov.yaml", "azure-kinect-nfov-binned.yaml"}) {
    const auto kinect = load_tof_model(sensors / name);
    ASSERT_TRUE(kinect) << kinect.error().text();
    EXPECT_GT(kinect->unambiguous_range_m(), 6);
    // The published range at 17 % reflectance is within what the amplitude limit lets through.
    const double range_m = std::string(name).find("binned") == std::string::npos ? 3.86 : 5.46;
    EXPECT_GT(kinect->active_electrons(range_m, 0.17) * kinect->modulation.contrast / 2,
              kinect->limits.min_amplitude_e)
        << name;
  }
}

TEST(AzureKinect, NoiseFollowsTheMeasuredLawOfAmplitude) {
  const auto m = load_tof_model(std::filesystem::path(rigor::test::source_dir()) /
                                "configs/sensors/azure-kinect-nfov.yaml");
  ASSERT_TRUE(m) << m.error().text();
  const double step = m->pixel.full_well_e / (std::ldexp(1.0, m->pixel.adc_bits) - 1);
  const double floor_e = std::sqrt(m->pixel.read_noise_e * m->pixel.read_noise_e + step * step / 12);
  for (const double counts : {60, 100, 200, 400, 700, 1200}) {
    const double amplitude_e = counts / 0.038;
    const double signal_e = amplitude_e / m->modulation.contrast;
    double weight = 0;
    for (const double f : m->modulation.frequencies_hz)
      weight += std::pow(
          TofMath<double>::tof_range_sigma(2 * f / 299792458.0, signal_e, 0, floor_e, m->modulation.contrast),
          -2);
    const double measured_m = (0.295 + 144 / counts) * 1e-3;
    EXPECT_NEAR(1 / std::sqrt(weight) / measured_m, 1, 0.12) << counts;
  }
}

}  // namespace
}  // namespace rigor::models
