#include "calibration/procedures/tof_lens.h"

#include <fmt/format.h>

#include <cmath>

#include "bench/console/progress.h"
#include "calibration/procedures/tof_inputs.h"
#include "calibration/tof/lens.h"

namespace rigor {
namespace {

using namespace calibration;

std::vector<Figure> figures_of(const CameraFit& fit) {
  const double w = fit.camera.width_px, h = fit.camera.height_px;
  Figure arrows{.kind = Figure::Kind::arrows,
                .title = "Lens: residuals over the picture",
                .caption = "Corners of the board that were used, their residuals drawn 20 times as long.",
                .x_label = "u [px]",
                .y_label = "v [px]",
                .x_to = w,
                .y_to = h,
                .stretch = 20};
  Series at, by;
  for (const auto& r : fit.residuals)
    if (r.used)
      at.x.push_back(r.u_px), at.y.push_back(r.v_px), by.x.push_back(r.du_px), by.y.push_back(r.dv_px);
  arrows.series = {at, by};
  return {arrows,
          {.kind = Figure::Kind::map,
           .title = "Lens: uncertainty of projection",
           .caption = "Standard deviation of where a ray falls, in its worst direction.",
           .x_label = "u [px]",
           .y_label = "v [px]",
           .values = fit.uncertainty.sigma_px,
           .columns = fit.uncertainty.columns,
           .x_to = w,
           .y_to = h,
           .value_label = "px"}};
}

}  // namespace

Result<TofLens> fit_tof_lens(const TofLensOptions& o) {
  const auto board = parse_board(o.target);
  if (!board) return tl::unexpected<Error>(board.error());
  TofInputs inputs;
  if (auto s = add_recordings(o.recordings, o.channel, "", inputs); !s)
    return tl::unexpected<Error>(s.error());
  TofLens out;
  out.notes = inputs.warnings;
  ProgressTask looking("look for boards", static_cast<double>(inputs.frames.size()), "pictures");
  std::vector<BoardView> seen;
  for (const TofFrame& f : inputs.frames) {
    if (f.width_px != o.width_px || f.height_px != o.height_px)
      return fail(ErrorCode::bad_input, f.name,
                  fmt::format("expected pictures of {}x{} px as the base sensor model has them, got {}x{}",
                              o.width_px, o.height_px, f.width_px, f.height_px));
    ++out.frames;
    auto view = find_board_in_amplitude(f, *board);
    if (view)
      seen.push_back(std::move(*view)), ++out.boards;
    else if (view.error().code != ErrorCode::not_found)
      return tl::unexpected<Error>(view.error());
    looking.set(static_cast<double>(out.frames));
    looking.note(fmt::format("{} found", out.boards));
    if (o.stop.stop_requested()) break;
  }
  looking.finish();
  if (seen.empty())
    return fail(
        ErrorCode::bad_input, inputs.frames.empty() ? "--board" : inputs.frames.front().name,
        fmt::format("expected a board {} in the amplitudes of at least one picture, found none in {}; "
                    "check the number of inner corners (--target) and that the whole board is in the "
                    "picture, its squares ten pixels or more",
                    board->text(), out.frames));
  const std::vector<BoardView> views = resting_views(seen);
  for (const BoardView& v : views) out.view_names.push_back(v.name);
  out.notes.push_back(fmt::format("lens: a board in {} of {} pictures, {} places of it", out.boards,
                                  out.frames, views.size()));
  CameraFitOptions options;
  options.stop = o.stop;
  auto fit = fit_camera(views, options);
  if (!fit) return tl::unexpected<Error>(fit.error());
  out.fit = std::move(*fit);
  out.figures = figures_of(out.fit);
  return out;
}

}  // namespace rigor
