#include "calibration/procedures/shading_calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "calibration/core/twin_figures.h"
#include "calibration/procedures/photon_input.h"
#include "calibration/shading/shading_fit.h"
#include "calibration/shading/shading_twin.h"
#include "sensor-hal/config/json_text.h"
#include "sensor-hal/models/camera_yaml.h"

namespace rigor {
namespace {

using namespace calibration;

struct ShadingInput {
  std::vector<ShadingCell> cells;
  int columns = 0;
  std::vector<std::filesystem::path> files;
  std::vector<std::string> warnings;
};

/// The first `luminance_lut` in a camera tuning file.
const nlohmann::json* find_table(const nlohmann::json& j) {
  if (j.is_object()) {
    if (j.contains("luminance_lut") && j["luminance_lut"].is_array()) return &j["luminance_lut"];
    for (const auto& item : j.items())
      if (const auto* t = find_table(item.value())) return t;
  } else if (j.is_array()) {
    for (const auto& item : j)
      if (const auto* t = find_table(item)) return t;
  }
  return nullptr;
}

Result<ShadingInput> read_table(const std::filesystem::path& file, const CameraModel& camera) {
  std::ifstream in(file);
  if (!in) return fail(ErrorCode::not_found, file.string(), "expected a table of gains, got no such file");
  std::vector<double> gains;
  int columns = 0;
  if (file.extension() == ".json") {
    std::string text(kMaxJsonBytes + 1, '\0');
    in.read(text.data(), static_cast<std::streamsize>(text.size()));
    text.resize(static_cast<std::size_t>(in.gcount()));
    const auto json = parse_json(text, file.string());
    if (!json) return tl::unexpected<Error>(json.error());
    const auto* table = find_table(*json);
    if (!table)
      return fail(ErrorCode::bad_input, file.string(),
                  "expected JSON with a `luminance_lut` (a camera tuning file of libcamera), found none");
    for (const auto& g : *table) gains.push_back(g.is_number() ? g.get<double>() : 0);
    // libcamera: 16 x 12 on older chips, 32 x 32 on newer ones.
    columns = gains.size() == 192 ? 16 : static_cast<int>(std::lround(std::sqrt(double(gains.size()))));
  } else {
    std::string line;
    while (std::getline(in, line)) {
      std::replace(line.begin(), line.end(), ',', ' ');
      std::istringstream row(line);
      int n = 0;
      for (double g; row >> g; ++n) gains.push_back(g);
      if (n == 0) continue;
      if (columns != 0 && n != columns)
        return fail(ErrorCode::bad_input, file.string(),
                    fmt::format("expected rows of {} gains each, got one of {}", columns, n));
      columns = n;
    }
  }
  auto cells = gain_table_cells(gains, columns, camera.width_px, camera.height_px);
  if (!cells) {
    Error e = cells.error();
    e.where = file.string();
    return tl::unexpected<Error>(e);
  }
  return ShadingInput{std::move(*cells), columns, {file}, {}};
}

Result<ShadingInput> read_flats(const ShadingCalibrationOptions& options, const CameraModel& camera) {
  ShadingInput out;
  std::vector<double> light, dark;
  std::size_t lights = 0, darks = 0, white = 0;
  bool mosaic = options.mosaic;
  int bits = 0;
  PhotonInputOptions how = options.input;
  how.exposure_needed = false;
  const auto input = read_photon_pictures(options, how, [&](const PhotonPicture& p) -> Status {
    if (p.width_px != camera.width_px || p.height_px != camera.height_px)
      return fail(ErrorCode::bad_input, p.frame.name,
                  fmt::format("expected pictures of {}x{}, the size of the base sensor model, got {}x{}",
                              camera.width_px, camera.height_px, p.width_px, p.height_px));
    auto& sum = p.frame.light ? light : dark;
    sum.resize(p.pixels.size(), 0);
    for (std::size_t i = 0; i < sum.size(); ++i) sum[i] += p.pixels[i];
    ++(p.frame.light ? lights : darks);
    mosaic = mosaic || p.mosaic;
    bits = std::max(bits, p.bits);
    const int top = p.bits > 0 ? (1 << p.bits) - 1 : 65535;
    for (const std::uint16_t v : p.pixels) white += p.frame.light && v >= top;
    return {};
  });
  if (!input) return tl::unexpected<Error>(input.error());
  if (lights == 0)
    return fail(ErrorCode::bad_input, "", "expected pictures of an even light, got dark ones alone");
  if (white > light.size() * lights / 1000)
    return fail(
        ErrorCode::bad_input, "",
        fmt::format("expected flat fields below saturation, got {:.1f} % of the pixels at the largest value: "
                    "shorten the exposure",
                    100.0 * double(white) / double(light.size() * lights)));
  double black = options.black_dn;
  for (std::size_t i = 0; i < light.size(); ++i) {
    light[i] /= static_cast<double>(lights);
    if (darks > 0) light[i] -= dark[i] / static_cast<double>(darks);
  }
  if (darks > 0) {
    black = 0;
  } else if (black < 0) {
    const int shown = bits > 0 ? bits : camera.noise.adc_bits;
    black = std::ldexp(camera.noise.black_level_dn, std::min(0, shown - camera.noise.adc_bits));
    out.warnings.push_back(fmt::format(
        "no dark frames and no --black: the base sensor model's black level, {:.4g} DN, is taken off; a "
        "wrong one bends the fall-off",
        black));
  }
  out.columns = std::clamp(camera.width_px / 12, 8, 32);
  auto cells = flat_field_cells(light, camera.width_px, camera.height_px, black, mosaic, out.columns);
  if (!cells) return tl::unexpected<Error>(cells.error());
  out.cells = std::move(*cells);
  out.files = input->files;
  for (const std::string& w : input->warnings) out.warnings.push_back(w);
  return out;
}

/// In percent of the light on the axis; cells that were left out are in neither.
TwinValues twin_values(const ShadingInput& input, const ShadingFit& fit) {
  TwinValues v{"residual of the cells", "% of the axis", {}, {}};
  const auto twin = shading_twin(input.cells, fit, 1);
  for (std::size_t i = 0; i < twin.size(); ++i)
    if (std::isfinite(twin[i]) && std::isfinite(fit.residual[i]))
      v.real.push_back(100 * fit.residual[i]), v.twin.push_back(100 * twin[i]);
  return v;
}

std::vector<Figure> figures_of(const ShadingInput& input, const ShadingFit& fit, const CameraModel& camera) {
  std::vector<Figure> figures;
  const double scale = fit.result.find("scale")->value;
  const auto map = [&](const char* title, const char* caption, const char* label, const auto& value) {
    Figure f{.kind = Figure::Kind::map,
             .title = title,
             .caption = caption,
             .x_label = "u [px]",
             .y_label = "v [px]",
             .columns = input.columns,
             .x_to = double(camera.width_px),
             .y_to = double(camera.height_px),
             .value_label = label};
    // A cell that was left out leaves a hole.
    const double side = double(camera.width_px) / input.columns;
    double bottom = 0;
    for (const ShadingCell& c : input.cells) bottom = std::max(bottom, c.v_px);
    const int rows = static_cast<int>(std::lround((bottom + 0.5) / side + 0.5));
    double row_side = double(camera.height_px) / std::max(1, rows);
    f.values.assign(static_cast<std::size_t>(rows * input.columns), std::nan(""));
    for (std::size_t i = 0; i < input.cells.size(); ++i) {
      const int c = std::clamp(static_cast<int>(input.cells[i].u_px / side), 0, input.columns - 1);
      const int r = std::clamp(static_cast<int>(input.cells[i].v_px / row_side), 0, rows - 1);
      f.values[static_cast<std::size_t>(r * input.columns + c)] = value(i);
    }
    figures.push_back(f);
  };
  map("Before: light over the picture", "What an even light gives, the axis is 1.", "light",
      [&](std::size_t i) { return input.cells[i].light / scale; });
  map("After: light over the fit", "What is left once the fitted fall-off is taken out.", "light",
      [&](std::size_t i) { return input.cells[i].light / scale / fit.fitted[i]; });
  map("Residual",
      "Measured less fitted, in percent of the light on the axis. Rings: the polynomial is too short. A "
      "tilt: the "
      "light was not even, or its centre is elsewhere.",
      "%", [&](std::size_t i) { return 100 * fit.residual[i]; });
  Figure profile{
      .kind = Figure::Kind::series,
      .title = "Fall-off",
      .caption = "Over the distance from the principal point; the simulated camera has the fitted one.",
      .x_label = "distance from the principal point [px]",
      .y_label = "light"};
  Series at{"measured", {}, {}, false}, line{"simulated twin", {}, {}, false};
  for (std::size_t i = 0; i < input.cells.size(); ++i) {
    const double r = std::hypot(input.cells[i].u_px - camera.cx_px, input.cells[i].v_px - camera.cy_px);
    at.x.push_back(r), at.y.push_back(input.cells[i].light / scale);
    line.x.push_back(r), line.y.push_back(fit.fitted[i]);
  }
  profile.series = {at, line};
  figures.push_back(profile);
  Figure quantiles{
      .kind = Figure::Kind::quantiles,
      .title = "Q–Q plot",
      .caption = "Residuals of the cells. On the line: normal; a lens that is not the model's bends away."};
  quantiles.series = {{"", {}, fit.residual, false}};
  figures.push_back(quantiles);
  const bool noisy =
      std::any_of(input.cells.begin(), input.cells.end(), [](const ShadingCell& c) { return c.sigma > 0; });
  if (noisy) {
    const TwinValues values = twin_values(input, fit);
    figures.push_back(twin_histogram(values));
    figures.push_back(twin_quantiles({values}));
    figures.back().caption +=
        " The twin has the noise of the cells alone: what the recording has more is what the model cannot "
        "express.";
  }
  // The light itself, noise or not: how much of the picture is how dark.
  TwinValues light{"light of the cells", "of the axis", {}, {}};
  const auto twin = shading_twin(input.cells, fit, 1);
  for (std::size_t i = 0; i < twin.size(); ++i)
    if (std::isfinite(twin[i]))
      light.real.push_back(input.cells[i].light / scale), light.twin.push_back(fit.fitted[i] + twin[i]);
  figures.push_back(twin_histogram(light));
  figures.back().title = "Light over the picture, recording and twin";
  figures.back().caption =
      "How much of the picture gets how much light. Points: the recording; line: the twin.";
  figures.back().x_label = "light, 1 on the axis";
  figures.back().y_label = "share per unit";
  return figures;
}

}  // namespace

Result<CalibrationResult> calibrate_shading(const ShadingCalibrationOptions& options, const StopToken& stop) {
  if (options.base.empty())
    return fail(
        ErrorCode::bad_input, "--base",
        "expected the sensor model of the camera: the fall-off counts from the principal point, over the "
        "angle to the "
        "axis. `rigor calibrate camera` makes one");
  const auto base = load_camera(options.base);
  if (!base) return tl::unexpected<Error>(base.error());
  if (options.inputs.empty())
    return fail(ErrorCode::bad_input, "INPUT", "expected pictures or a table of gains, got none");
  const auto extension = options.inputs.front().extension();
  const bool table =
      options.inputs.size() == 1 && (extension == ".json" || extension == ".csv" || extension == ".txt");
  const auto input =
      table ? read_table(options.inputs.front(), base->model) : read_flats(options, base->model);
  if (!input) return tl::unexpected<Error>(input.error());
  ShadingFitOptions fit_options;
  fit_options.stop = stop;
  if (options.model != "auto") {
    const auto model = parse_shading_model(options.model);
    if (!model) return tl::unexpected<Error>(model.error());
    fit_options.models = {*model};
  }
  auto fit = fit_shading(input->cells, base->model, fit_options);
  if (!fit) return tl::unexpected<Error>(fit.error());

  CalibrationResult result;
  result.title = "Lens shading";
  nlohmann::json& details = result.details.json();
  result.inputs = input->files;
  result.fit = fit->result;
  result.fit.warnings.insert(result.fit.warnings.begin(), input->warnings.begin(), input->warnings.end());
  result.recipe.kind = "camera";
  for (const auto& [key, value] : {std::pair{"cos4_weight", fit->vignetting.cos4_weight},
                                   {"a2", fit->vignetting.a2},
                                   {"a4", fit->vignetting.a4},
                                   {"a6", fit->vignetting.a6}})
    result.recipe.set.emplace_back(std::string("vignetting.") + key, exact_text(value));
  for (const Parameter& p : fit->result.parameters)
    if (p.name != "scale") result.recipe.places.push_back({p.name, "vignetting." + p.name, 1});
  result.figures = figures_of(*input, *fit, base->model);
  // Beside its twin, whose cells have their noise alone (a table of gains has none).
  TwinValues twin = twin_values(*input, *fit);
  std::sort(twin.real.begin(), twin.real.end()), std::sort(twin.twin.begin(), twin.twin.end());
  constexpr std::array kQuantiles{0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99};
  auto& to = details["twin"] = {{"unit", "percent of the light on the axis"}, {"quantiles", kQuantiles}};
  for (const double q : kQuantiles) {
    const auto at = [&](const std::vector<double>& v) {
      return v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1))];
    };
    to["residuals"].push_back(at(twin.real));
    to["twin_residuals"].push_back(at(twin.twin));
  }
  details["rms_of_axis_percent"] = 100 * fit->rms;
  details["rms_relative_percent"] = 100 * fit->rms_relative;
  details["centre_du_px"] = fit->centre_du_px;
  details["centre_dv_px"] = fit->centre_dv_px;
  details["centre_sigma_px"] = fit->centre_sigma_px;
  details["rms_with_own_centre_percent"] = 100 * fit->centred_rms;
  result.base = options.base;
  return result;
}

}  // namespace rigor
