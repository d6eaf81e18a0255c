#include "drivers/v4l2/video_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "drivers/v4l2/control_values.h"
#include "drivers/v4l2/negotiation.h"

namespace rigor::v4l2 {
namespace {

tl::unexpected<Error> at_key(const ChannelConfig& config, const Error& e) {
  const auto error = config.params.error(e.where, e.message).error();
  return fail(e.code, error.where, error.message);
}

}  // namespace

Result<Plan> set_up(CaptureDevice& device, const Settings& settings, const ChannelConfig& config) {
  Plan plan;
  auto table = device.table();
  if (!table) return tl::unexpected<Error>(table.error());
  plan.table = std::move(*table);
  const auto choice = negotiate(plan.table, settings.format);
  if (!choice) return at_key(config, choice.error());
  auto actual = device.set_format(*choice);
  if (!actual) return tl::unexpected<Error>(actual.error());
  plan.format = *actual;
  if (actual->code != choice->code || actual->width_px != choice->width_px ||
      actual->height_px != choice->height_px)
    return at_key(
        config, {ErrorCode::bad_input, "width_px",
                 fmt::format("expected a format and size that {} takes, got {} {}x{}; it took {} {}x{} "
                             "instead",
                             plan.table.card, fourcc_text(choice->code), choice->width_px, choice->height_px,
                             fourcc_text(actual->code), actual->width_px, actual->height_px)});
  const double wanted_hz = config.period.ns() > 0 ? 1.0 / config.period.seconds() : 0;
  const double actual_hz = actual->interval.rate_hz();
  if (wanted_hz > 0 && actual_hz > 0 && std::abs(actual_hz - wanted_hz) > kRateTolerance * wanted_hz)
    return at_key(
        config, {ErrorCode::bad_input, "rate_hz",
                 fmt::format("expected the rate at which {} captures {} {}x{}, {:.6g} Hz; got {:.6g} Hz",
                             plan.table.card, fourcc_text(actual->code), actual->width_px, actual->height_px,
                             actual_hz, wanted_hz)});
  if (wanted_hz > 0 && actual_hz == 0)
    plan.notes.push_back(
        fmt::format("{} does not tell its rate; {:.6g} Hz is taken on trust", plan.table.card, wanted_hz));

  auto values = catch_config([&] { return check_controls(settings.controls, plan.table); });
  if (!values) return tl::unexpected<Error>(values.error());
  for (const ControlValue& v : *values)
    if (auto s = device.set_control(v.id, v.value); !s) {
      const auto error =
          settings.controls.error(v.name, "expected a value that the device takes now: " + s.error().message)
              .error();
      return fail(ErrorCode::bad_input, error.where, error.message);
    }

  Shutter& shutter = plan.shutter;
  shutter.readout = settings.readout;
  shutter.global = settings.global_shutter;
  shutter.period = config.period.ns() > 0 ? Duration(config.period) : actual->interval.duration();
  shutter.exposure_known = true;
  if (settings.exposure) {
    shutter.exposure = *settings.exposure;
  } else if (plan.table.control(kExposureAbsolute)) {
    if (auto value = device.get_control(kExposureAbsolute))
      shutter.exposure = microseconds(*value * 100);
    else
      shutter.exposure_known = false;
  } else {
    shutter.exposure_known = false;
  }
  if (!shutter.exposure_known)
    plan.notes.push_back(
        fmt::format("the exposure of {} is not known: t_capture is that of its timestamps, within half a "
                    "period; say exposure_us",
                    plan.table.card));
  return plan;
}

Status VideoSource::do_configure(const ChannelConfig& config) {
  settings_ = read_settings(config);
  description_.kind = SampleKind::image;
  description_.frame_id = settings_.frame_id;
  description_.format = settings_.format.format;
  description_.width_px = settings_.format.width_px, description_.height_px = settings_.format.height_px;
  description_.max_bytes = image_bytes(description_.format, description_.width_px, description_.height_px);
  return {};
}

void VideoSource::open_samples(Plan plan, bool virtual_time) {
  plan_ = std::move(plan);
  virtual_time_ = virtual_time;
  description_.width_px = plan_.format.width_px, description_.height_px = plan_.format.height_px;
  description_.max_bytes = image_bytes(description_.format, description_.width_px, description_.height_px);
  converter_ = std::make_unique<FrameConverter>(plan_.format, settings_.format.format);
  count_ = CaptureCount(plan_.shutter.period);
  in_run_.reset();
  open_stream(settings_.buffers, description_.max_bytes, virtual_time);
}

void VideoSource::give_up_until(BenchTime t) noexcept {
  const std::uint64_t lost = count_.give_up_until(t);
  const auto t0 = origin().get();
  const Duration period = plan_.shutter.period;
  if (!t0 || period.ns() <= 0 || t < *t0) return;
  count_lost(std::min(lost, static_cast<std::uint64_t>((t - *t0) / period + 1)));
}

void VideoSource::deliver(const RawFrame& frame, BenchTime arrival) {
  const Duration realtime_ahead =
      virtual_time_ ? Duration{} : Duration(realtime_now().ns() - monotonic_now().ns());
  const FrameInstant instant = frame_instant(frame, plan_.shutter, realtime_ahead);
  const CaptureCount::Step step = count_.step(frame.sequence, instant.t);
  if (step.late) return;
  const auto place = in_run_.place(origin(), instant.t, plan_.shutter.period, step.sequence, step.lost);
  if (!place) return;
  count_lost(place->lost);
  SampleSlot slot = take_slot();
  if (!slot) return hand_over(std::move(slot));
  Sample& s = *slot;
  s.size_bytes = description_.max_bytes;
  const Converted converted = converter_->convert(frame.bytes, s.memory().first(s.size_bytes));
  const bool incomplete = frame.error || converted == Converted::incomplete;
  if (incomplete) health_.incomplete.fetch_add(1, std::memory_order_relaxed);
  if (converted == Converted::refused) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  if (converted == Converted::refused || (incomplete && settings_.drop_incomplete)) return count_lost(1);
  s.stamp = {};
  s.stamp.sequence = place->sequence;
  s.stamp.t_capture = instant.t;
  s.stamp.sigma_capture = virtual_time_ && plan_.shutter.exposure_known ? Duration{} : instant.sigma;
  s.stamp.t_release = instant.t + config().latency;
  s.stamp.t_arrival = virtual_time_ ? s.stamp.t_release : arrival != BenchTime{} ? arrival : bench_now();
  s.stamp.validity = (incomplete ? kIncomplete : kValid) | (instant.sure ? kValid : kClockUnsure);
  s.info = ImageInfo{.format = description_.format,
                     .width_px = description_.width_px,
                     .height_px = description_.height_px,
                     .exposure = plan_.shutter.exposure};
  hand_over(std::move(slot));
}

}  // namespace rigor::v4l2
