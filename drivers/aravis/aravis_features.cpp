#include "drivers/aravis/aravis_features.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string_view>
#include <utility>
#include <vector>

#include <arv.h>

#include "drivers/aravis/gige_registers.h"
#include "drivers/aravis/payload_size.h"

namespace rigor {

std::string GLibError::text() const { return error_ == nullptr ? std::string() : error_->message; }

void GLibError::clear() { g_clear_error(&error_); }

tl::unexpected<Error> GLibError::as_error(std::string where, std::string what) const {
  ErrorCode code = ErrorCode::protocol;
  std::string cure;
  if (g_error_matches(error_, ARV_DEVICE_ERROR, ARV_DEVICE_ERROR_TIMEOUT)) {
    code = ErrorCode::timeout;
  } else if (g_error_matches(error_, ARV_DEVICE_ERROR, ARV_DEVICE_ERROR_PROTOCOL_ERROR_ACCESS_DENIED) ||
             g_error_matches(error_, ARV_DEVICE_ERROR, ARV_DEVICE_ERROR_NOT_CONTROLLER)) {
    code = ErrorCode::unavailable;
    cure = "; another client may hold the camera: end it and try again";
  }
  return fail(code, std::move(where), std::move(what) + ": " + text() + cure);
}

namespace {

/// A setting that the camera does not take: the error carries the place of `key`.
ConfigError refused(const ChannelConfig& config, std::string_view key, const std::string& message) {
  return config.params.error(key, message);
}
/// The camera did not answer as it should while `what` was done.
[[noreturn]] void broken(const ChannelConfig& config, const GLibError& e, const std::string& what) {
  throw ConfigError(e.as_error(config.name, what).value());
}

std::string join(const char** names, unsigned n) {
  std::string all;
  for (unsigned i = 0; i < n; ++i) all += (i ? ", " : "") + std::string(names[i]);
  return all.empty() ? "none" : all;
}

void set_pixel_format(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config,
                      bool multipart) {
  GLibError e;
  const std::string wanted(pfnc_name(s.format));
  unsigned n = 0;
  const char** names = arv_camera_dup_available_pixel_formats_as_strings(camera, &n, e.out());
  if (e) broken(config, e, "asking for the pixel formats");
  const bool offered = std::any_of(names, names + n, [&](const char* name) { return wanted == name; });
  const std::string all = join(names, n);
  g_free(names);
  // The formats of the parts may be fixed, or each part's own: what comes says which.
  if (!offered && multipart) return;
  if (!offered && s.range)
    throw refused(config, "kind",
                  fmt::format("expected image, or a camera that gives range ({}), got one that offers {}",
                              wanted, all));
  if (!offered)
    throw refused(config, "pixel_format",
                  fmt::format("expected a format that the camera offers ({}), got {}", all, wanted));
  arv_camera_set_pixel_format_from_string(camera, wanted.c_str(), e.out());
  if (e) broken(config, e, "setting the pixel format to " + wanted);
}

struct Axis {
  const char *size, *offset, *size_key, *offset_key;
};
constexpr Axis kX{"Width", "OffsetX", "width_px", "x_px"};
constexpr Axis kY{"Height", "OffsetY", "height_px", "y_px"};

void check_steps(const ChannelConfig& config, const char* key, std::int64_t value, std::int64_t min,
                 std::int64_t max, std::int64_t step) {
  if (value >= min && value <= max && (step <= 1 || (value - min) % step == 0)) return;
  throw refused(config, "region",
                fmt::format("{}: expected {} … {} px in steps of {}, as the camera offers, got {}", key, min,
                            max, std::max<std::int64_t>(1, step), value));
}

void set_axis(ArvCamera* camera, const ChannelConfig& config, const Axis& axis,
              std::optional<std::int64_t> size, std::int64_t offset) {
  GLibError e;
  const bool has_offset = arv_camera_is_feature_available(camera, axis.offset, nullptr) != FALSE;
  if (has_offset) {
    arv_camera_set_integer(camera, axis.offset, 0, e.out());  // so that every size is free to choose
    if (e) broken(config, e, fmt::format("setting {}", axis.offset));
  }
  gint64 min = 0, max = 0;
  arv_camera_get_integer_bounds(camera, axis.size, &min, &max, e.out());
  if (e) broken(config, e, fmt::format("asking for the bounds of {}", axis.size));
  GLibError no_step;
  gint64 step = arv_camera_get_integer_increment(camera, axis.size, no_step.out());
  if (no_step) step = 1;
  if (size) check_steps(config, axis.size_key, *size, min, max, step);
  arv_camera_set_integer(camera, axis.size, size.value_or(max), e.out());
  if (e) broken(config, e, fmt::format("setting {} to {}", axis.size, size.value_or(max)));
  if (offset == 0) return;
  if (!has_offset)
    throw refused(config, "region", fmt::format("{}: expected 0, the camera has no offset", axis.offset_key));
  arv_camera_get_integer_bounds(camera, axis.offset, &min, &max, e.out());
  if (e) broken(config, e, fmt::format("asking for the bounds of {}", axis.offset));
  step = arv_camera_get_integer_increment(camera, axis.offset, no_step.out());
  if (no_step) step = 1;
  check_steps(config, axis.offset_key, offset, min, max, step);
  arv_camera_set_integer(camera, axis.offset, offset, e.out());
  if (e) broken(config, e, fmt::format("setting {} to {}", axis.offset, offset));
}

void set_region(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  std::optional<std::int64_t> width, height;
  if (s.region) width = s.region->width_px, height = s.region->height_px;
  set_axis(camera, config, kX, width, s.region ? s.region->x_px : 0);
  set_axis(camera, config, kY, height, s.region ? s.region->y_px : 0);
}

void check_period(Duration exposure, const AravisSettings& s, const ChannelConfig& config) {
  if (s.triggered_by_bench() || config.period.ns() <= 0 || exposure <= config.period) return;
  throw refused(config, "exposure_us",
                fmt::format("expected an exposure within the channel's period of {:g} µs, got {:g}{}",
                            config.period.seconds() * 1e6, exposure.seconds() * 1e6,
                            s.exposure_us ? "" : ", which the camera was left with: set `exposure_us`"));
}

void set_exposure(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  GLibError e;
  if (arv_camera_is_exposure_auto_available(camera, nullptr) != FALSE)
    arv_camera_set_exposure_time_auto(camera, ARV_AUTO_OFF, nullptr);
  if (!s.exposure_us) return;
  if (arv_camera_is_exposure_time_available(camera, e.out()) == FALSE)
    throw refused(config, "exposure_us", "the camera's exposure time cannot be set; leave this key out");
  double min = 0, max = 0;
  arv_camera_get_exposure_time_bounds(camera, &min, &max, e.out());
  if (e) broken(config, e, "asking for the bounds of the exposure time");
  if (*s.exposure_us < min || *s.exposure_us > max)
    throw refused(
        config, "exposure_us",
        fmt::format("expected {:g} … {:g} µs, as the camera offers, got {:g}", min, max, *s.exposure_us));
  arv_camera_set_exposure_time(camera, *s.exposure_us, e.out());
  if (e) broken(config, e, fmt::format("setting the exposure time to {:g} µs", *s.exposure_us));
}

void set_gain(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  GLibError e;
  if (arv_camera_is_gain_auto_available(camera, nullptr) != FALSE)
    arv_camera_set_gain_auto(camera, ARV_AUTO_OFF, nullptr);
  if (!s.gain_db) return;
  if (arv_camera_is_gain_available(camera, e.out()) == FALSE)
    throw refused(config, "gain_db", "the camera's gain cannot be set; leave this key out");
  double min = 0, max = 0;
  arv_camera_get_gain_bounds(camera, &min, &max, e.out());
  if (e) broken(config, e, "asking for the bounds of the gain");
  if (*s.gain_db < min || *s.gain_db > max)
    throw refused(
        config, "gain_db",
        fmt::format("expected {:g} … {:g} dB, as the camera offers, got {:g}", min, max, *s.gain_db));
  arv_camera_set_gain(camera, *s.gain_db, e.out());
  if (e) broken(config, e, fmt::format("setting the gain to {:g} dB", *s.gain_db));
}

/// Each exposure waits for the first of the camera's trigger sources that `wanted` takes; its name.
template <class F>
std::string set_trigger_source(ArvCamera* camera, const ChannelConfig& config, std::string_view key,
                               const std::string& expected, F&& wanted) {
  GLibError e;
  unsigned n = 0;
  const char** names = arv_camera_dup_available_trigger_sources(camera, &n, e.out());
  if (e) broken(config, e, "asking for the trigger sources");
  const auto* at = std::find_if(names, names + n, wanted);
  const std::string source = at == names + n ? "" : *at;
  const std::string all = join(names, n);
  g_free(names);
  if (source.empty())
    throw refused(config, key,
                  fmt::format("expected a source that the camera offers ({}), got {}", all, expected));
  arv_camera_set_trigger(camera, source.c_str(), e.out());
  if (e) broken(config, e, "setting the trigger to " + source);
  return source;
}

/// Each exposure waits for an edge on one of the camera's lines.
void set_line_trigger(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  GLibError e;
  (void)set_trigger_source(camera, config, "trigger_line", s.trigger_line,
                           [&](const char* name) { return s.trigger_line == name; });
  const char* edge = s.falling_edge ? "FallingEdge" : "RisingEdge";
  if (s.falling_edge || arv_camera_is_feature_available(camera, "TriggerActivation", nullptr) != FALSE) {
    arv_camera_set_string(camera, "TriggerActivation", edge, e.out());
    if (e)
      throw refused(config, "trigger_edge",
                    std::string("the camera does not take ") + edge + ": " + e.text());
  }
  if (s.trigger_delay_us == 0 && arv_camera_is_feature_available(camera, "TriggerDelay", nullptr) == FALSE)
    return;
  // The names that cameras give to one and the same feature.
  const char* delay = arv_camera_is_feature_available(camera, "TriggerDelay", nullptr) != FALSE
                          ? "TriggerDelay"
                          : "TriggerDelayAbs";
  arv_camera_set_float(camera, delay, s.trigger_delay_us, e.out());
  if (e) throw refused(config, "trigger_delay_us", "the camera does not take this delay: " + e.text());
}

/// Each exposure waits for an action command with these keys.
void set_action_trigger(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  GLibError e;
  if (arv_camera_is_gv_device(camera) == FALSE)
    throw refused(config, "trigger", "expected a GigE Vision camera, as action commands are for these alone");
  guint32 capability = 0;
  arv_device_read_register(arv_camera_get_device(camera), gige::reg::kGvcpCapability, &capability, e.out());
  if (e) broken(config, e, "reading the camera's capabilities");
  if ((capability & gige::reg::kScheduledAction) == 0)
    throw refused(
        config, "trigger",
        "expected a camera that obeys scheduled action commands, which this one says it does not; use "
        "software or hardware");
  const std::string source = set_trigger_source(camera, config, "trigger", "action", [](const char* name) {
    return std::string_view(name).starts_with("Action");
  });
  // Signals are numbered as the sources' names are. A camera with one signal need not have a selector.
  if (const auto digit = source.find_first_of("0123456789"); digit != std::string::npos)
    arv_camera_set_integer(camera, "ActionSelector", source[digit] - '0', nullptr);
  // Status codes of version 2.0: that a command came too late, or that the clock has no master.
  arv_camera_set_string(camera, "GevGVCPExtendedStatusCodesSelector", "Version2_0", nullptr);
  arv_camera_set_boolean(camera, "GevGVCPExtendedStatusCodes", TRUE, nullptr);
  const std::pair<const char*, std::uint32_t> keys[] = {{"ActionDeviceKey", s.action->device_key},
                                                        {"ActionGroupKey", s.action->group_key},
                                                        {"ActionGroupMask", s.action->group_mask}};
  for (const auto& [name, value] : keys) {
    arv_camera_set_integer(camera, name, value, e.out());
    if (e)
      throw refused(config, "action",
                    fmt::format("the camera does not take {} {}: {}", name, value, e.text()));
  }
}

/// What the camera can say with each picture, as far as it is of use here.
void set_chunks(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  const bool there = arv_camera_are_chunks_available(camera, nullptr) != FALSE;
  if (!s.chunks) {
    if (there) arv_camera_set_chunk_mode(camera, FALSE, nullptr);
    return;
  }
  if (!there) throw refused(config, "chunks", "the camera sends no chunk data; leave this key out");
  GLibError e;
  arv_camera_set_chunk_mode(camera, TRUE, e.out());
  if (e) broken(config, e, "switching chunk data on");
  for (const char* chunk : {"Timestamp", "ExposureTime", "Gain"})  // a camera need not have all of them
    arv_camera_set_chunk_state(camera, chunk, TRUE, nullptr);
}

void set_ptp(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  if (!s.ptp) return;
  // The name of SFNC 2.3 and later, and the one before.
  for (const char* name : {"PtpEnable", "GevIEEE1588"}) {
    if (arv_camera_is_feature_available(camera, name, nullptr) == FALSE) continue;
    GLibError e;
    arv_camera_set_boolean(camera, name, TRUE, e.out());
    if (e) broken(config, e, "switching PTP on");
    return;
  }
  throw refused(config, "ptp", "the camera has no PTP clock; leave this key out");
}

std::vector<std::string> components(ArvCamera* camera) {
  std::vector<std::string> all;
  if (arv_camera_is_feature_available(camera, "ComponentSelector", nullptr) == FALSE) return all;
  unsigned n = 0;
  const char** names =
      arv_camera_dup_available_enumerations_as_strings(camera, "ComponentSelector", &n, nullptr);
  all.assign(names, names + n);
  g_free(names);
  return all;
}

/// Switches multi-part frames on or off, and chooses what they are made of. True where frames come in parts.
bool set_parts(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  GLibError e;
  const bool can = arv_camera_is_gv_device(camera) != FALSE &&
                   arv_camera_gv_is_multipart_supported(camera, nullptr) != FALSE;
  if (can) {
    arv_camera_gv_set_multipart(camera, s.parts() ? TRUE : FALSE, e.out());
    if (e) broken(config, e, "switching multi-part frames on or off");
  }
  if (!s.parts()) return false;
  if (!can && !s.part.empty())
    throw refused(
        config, "part",
        "expected a camera that sends frames of several parts (GigE Vision 2.1), which this one says it "
        "does not; leave this key out");
  const auto all = components(camera);
  const auto has = [&](const std::string& name) {
    return std::find(all.begin(), all.end(), name) != all.end();
  };
  const bool by_number = !s.part.empty() && s.part.find_first_not_of("0123456789") == std::string::npos;
  if (all.empty()) return can;
  const std::string first = s.range ? "Range" : s.part;
  const auto enable = [&](const std::string& name, bool on) {
    arv_camera_set_string(camera, "ComponentSelector", name.c_str(), e.out());
    if (e) broken(config, e, "selecting the component " + name);
    if (arv_camera_is_feature_available(camera, "ComponentEnable", nullptr) == FALSE) return;
    arv_camera_set_boolean(camera, "ComponentEnable", on ? TRUE : FALSE, e.out());
    if (e && on) broken(config, e, "switching the component " + name + " on");
  };
  if (by_number) {  // of all that there are
    for (const auto& c : all) enable(c, true);
    return can;
  }
  if (!has(first)) {
    std::string offered;
    for (const auto& c : all) offered += (offered.empty() ? "" : ", ") + c;
    throw refused(config, s.range ? "kind" : "part",
                  fmt::format("expected a component that the camera offers ({}), got {}", offered, first));
  }
  // The amplitude of a range image; cameras that have none have a confidence.
  const std::string second = !s.range || !can ? "" : has("Intensity") ? "Intensity" : "Confidence";
  enable(first, true);
  for (const auto& c : all)
    if (c != first) enable(c, c == second);
  enable(first, true);  // selected from here on: its pixel format is what is set next
  return can;
}

/// What the counts of the range part mean, as the camera says it (SFNC, 3D scan control).
RangeScale read_range_scale(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config,
                            const CameraFacts& f) {
  const auto there = [&](const char* name) {
    return arv_camera_is_feature_available(camera, name, nullptr) != FALSE;
  };
  const auto number = [&](const char* name, double fallback) {
    if (!there(name)) return fallback;
    GLibError e;
    const double v = arv_camera_get_float(camera, name, e.out());
    if (e) broken(config, e, fmt::format("reading {}", name));
    return std::isfinite(v) ? v : fallback;
  };
  const auto word = [&](const char* name) -> std::string {
    if (!there(name)) return {};
    GLibError e;
    const char* v = arv_camera_get_string(camera, name, e.out());
    return v == nullptr || e ? std::string() : std::string(v);
  };
  if (there("Scan3dCoordinateSelector"))
    arv_camera_set_string(camera, "Scan3dCoordinateSelector", "CoordinateC", nullptr);
  const std::string unit = word("Scan3dDistanceUnit");
  if (!unit.empty() && unit != "Millimeter" && unit != "Inch" && !s.range_scale_mm)
    throw refused(config, "range_scale_mm",
                  "expected the millimetres of a count: the camera's unit of distance is " + unit);
  const double unit_m = unit == "Inch" ? 25.4e-3 : 1e-3;
  RangeScale scale;
  scale.amplitude_scale = s.amplitude_scale;
  scale.scale_m = s.range_scale_mm ? *s.range_scale_mm * 1e-3 : number("Scan3dCoordinateScale", 1) * unit_m;
  scale.offset_m =
      s.range_offset_mm ? *s.range_offset_mm * 1e-3 : number("Scan3dCoordinateOffset", 0) * unit_m;
  scale.invalid = 0;
  if (there("Scan3dInvalidDataFlag")) {
    const bool flagged = arv_camera_get_boolean(camera, "Scan3dInvalidDataFlag", nullptr) != FALSE;
    scale.invalid = flagged ? std::optional(number("Scan3dInvalidDataValue", 0)) : std::nullopt;
  }
  const std::string system = word("Scan3dCoordinateSystem");
  if (system == "Spherical") return scale;
  const double focal_px = number("Scan3dFocalLength", 0);
  if (!(focal_px > 0))
    throw refused(
        config, "kind",
        fmt::format("expected a camera that gives range (Scan3dCoordinateSystem Spherical) or says its "
                    "Scan3dFocalLength, to make range of depth; got {}; `kind: image` with `part: Range` "
                    "hands its counts on as they are",
                    system.empty() ? "neither" : system));
  scale.set_pinhole({f.offset_x_px, f.offset_y_px, f.width_px, f.height_px}, focal_px,
                    number("Scan3dPrincipalPointU", 0), number("Scan3dPrincipalPointV", 0));
  return scale;
}

void set_trigger(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  GLibError e;
  arv_camera_set_acquisition_mode(camera, ARV_ACQUISITION_MODE_CONTINUOUS, e.out());
  if (e) broken(config, e, "setting continuous acquisition");
  if (s.hardware_trigger) return set_line_trigger(camera, s, config);
  if (s.action) return set_action_trigger(camera, s, config);
  if (!s.software_trigger) {
    arv_camera_clear_triggers(camera, e.out());
    if (e) broken(config, e, "switching the triggers off");
    return;
  }
  if (arv_camera_is_software_trigger_supported(camera, e.out()) == FALSE)
    throw refused(config, "trigger", "the camera has no software trigger; use free_run");
  arv_camera_set_trigger(camera, "Software", e.out());
  if (e) broken(config, e, "setting the software trigger");
}

/// The rate of a free-running camera is the channel's.
void set_frame_rate(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config, bool check) {
  if (s.triggered_by_bench() || s.hardware_trigger || config.period.ns() <= 0) return;
  if (arv_camera_is_frame_rate_available(camera, nullptr) == FALSE) return;
  GLibError e;
  const double rate_hz = config.period.hz();
  double min = 0, max = 0;
  arv_camera_get_frame_rate_bounds(camera, &min, &max, e.out());
  if (e) broken(config, e, "asking for the bounds of the frame rate");
  const bool inside = rate_hz >= min * (1 - 1e-9) && rate_hz <= max * (1 + 1e-9);
  if (!inside) {
    if (!check) return;
    throw refused(
        config, "rate_hz",
        fmt::format("expected {:g} … {:g} Hz, as the camera offers with this region and exposure, got {:g}",
                    min, max, rate_hz));
  }
  arv_camera_set_frame_rate(camera, rate_hz, e.out());
  if (e && check) broken(config, e, fmt::format("setting the frame rate to {:g} Hz", rate_hz));
}

void set_packets(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  if (arv_camera_is_gv_device(camera) == FALSE) return;
  GLibError e;
  if (s.packet_size) {
    arv_camera_gv_set_packet_size_adjustment(camera, ARV_GV_PACKET_SIZE_ADJUSTMENT_NEVER);
    arv_camera_gv_set_packet_size(camera, static_cast<gint>(*s.packet_size), e.out());
    if (e) broken(config, e, fmt::format("setting the packet size to {}", *s.packet_size));
    const unsigned is = arv_camera_gv_get_packet_size(camera, e.out());
    if (!e && is != *s.packet_size)
      throw refused(config, "packet_size",
                    fmt::format("expected a size that the camera takes (it made {} of it), got {}", is,
                                *s.packet_size));
  } else {
    arv_camera_gv_auto_packet_size(camera, e.out());
    arv_camera_gv_set_packet_size_adjustment(camera, ARV_GV_PACKET_SIZE_ADJUSTMENT_NEVER);
    if (e) broken(config, e, "looking for the largest packet size; set `packet_size` to leave that out");
  }
  if (s.packet_delay_ns > 0) {
    arv_camera_gv_set_packet_delay(camera, s.packet_delay_ns, e.out());
    if (e) broken(config, e, fmt::format("setting the packet delay to {} ns", s.packet_delay_ns));
  }
}

CameraFacts read_back(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config,
                      bool multipart) {
  GLibError e;
  CameraFacts f;
  f.multipart = multipart;
  gint x = 0, y = 0, width = 0, height = 0;
  arv_camera_get_region(camera, &x, &y, &width, &height, e.out());
  if (e) broken(config, e, "reading the region back");
  if (width < 0 || height < 0 || x < 0 || y < 0)
    throw ConfigError(
        {ErrorCode::protocol, config.name,
         fmt::format("the camera says that its region is {}x{} at {},{}", width, height, x, y)});
  f.width_px = static_cast<std::uint32_t>(width), f.height_px = static_cast<std::uint32_t>(height);
  f.offset_x_px = static_cast<std::uint32_t>(x), f.offset_y_px = static_cast<std::uint32_t>(y);
  const double exposure_us = arv_camera_get_exposure_time(camera, e.out());
  if (!e && std::isfinite(exposure_us) && exposure_us > 0 && exposure_us < 1e9)
    f.exposure = seconds_from(exposure_us * 1e-6);
  const double gain = arv_camera_get_gain(camera, e.out());
  if (!e && std::isfinite(gain)) f.gain_db = gain;
  f.payload_bytes = arv_camera_get_payload(camera, e.out());
  if (e) broken(config, e, "reading the payload size");
  check_payload({f.width_px, f.height_px, f.payload_bytes, multipart}, s, config);
  f.picture_bytes = s.range ? std::size_t{f.width_px} * f.height_px * 2 * sizeof(float)
                            : image_bytes(s.format, f.width_px, f.height_px);
  f.chunks = s.chunks;
  if (arv_camera_is_gv_device(camera) != FALSE) {
    f.packet_size = arv_camera_gv_get_packet_size(camera, e.out());
    if (e) broken(config, e, "reading the packet size");
  }
  if (const char* id = arv_camera_get_device_id(camera, e.out()); id != nullptr && !e) f.id = id;
  return f;
}

}  // namespace

Result<CameraFacts> apply_settings(ArvCamera* camera, const AravisSettings& s, const ChannelConfig& config) {
  return catch_config([&] {
    if (s.exposure_us) check_period(seconds_from(*s.exposure_us * 1e-6), s, config);
    arv_camera_stop_acquisition(camera, nullptr);  // left over from a client that went away; most say no
    set_chunks(camera, s, config);
    set_ptp(camera, s, config);
    const bool multipart = set_parts(camera, s, config);
    set_pixel_format(camera, s, config, multipart);
    set_region(camera, s, config);
    set_trigger(camera, s, config);
    set_frame_rate(camera, s, config,
                   false);            // on some cameras the rate bounds the exposure, on others it is
    set_exposure(camera, s, config);  // the other way round
    set_gain(camera, s, config);
    set_frame_rate(camera, s, config, true);
    set_packets(camera, s, config);
    CameraFacts f = read_back(camera, s, config, multipart);
    if (s.range) f.scale = read_range_scale(camera, s, config, f);
    check_period(f.exposure, s, config);  // where the rig leaves the exposure to the camera
    return f;
  });
}

}  // namespace rigor
