#include "sensor-hal/channel/measurer.h"

#include <utility>

#include "sensor-hal/channel/named_values.h"

namespace rigor {
namespace {

tl::unexpected<Error> wrong_kind(const ChannelConfig& config, const char* expected) {
  return fail(ErrorCode::bad_input, config.params.place(),
              config.name + ": expected `kind: " + expected +
                  "`, which is what this simulator makes; got another kind");
}

/// Of the kinds that simulators make.
const char* name_of(SampleKind kind) {
  switch (kind) {
    case SampleKind::point_cloud:
      return "point_cloud";
    case SampleKind::range_image:
      return "range_image";
    case SampleKind::imu:
      return "imu";
    case SampleKind::nav_fix:
      return "nav_fix";
    case SampleKind::odometry:
      return "odometry";
    default:
      return "image";
  }
}

class ImageMeasurer final : public Measurer {
 public:
  explicit ImageMeasurer(std::shared_ptr<ImageProvider> provider) : provider_(std::move(provider)) {}

  Status configure(const ChannelConfig& config, ChannelDescription& description) override {
    if (config.kind != SampleKind::image) return wrong_kind(config, "image");
    const ConfigNode& n = config.params;
    const auto sensor = provider_->geometry();
    ImageRequest r;
    const double default_us = static_cast<double>(sensor.exposure.ns()) * 1e-3;
    r.exposure = seconds_from(
        n.number_or("exposure_us", default_us, {.min = 0, .max = 60e6, .exclusive_min = true}) * 1e-6);
    r.gain_db = n.number_or("gain_db", 0, {.min = -40, .max = 80});
    std::vector<std::string> formats;
    for (unsigned i = 0; pfnc_name(static_cast<PixelFormat>(i)) != "?"; ++i)
      if (!is_depth(static_cast<PixelFormat>(i)))
        formats.emplace_back(pfnc_name(static_cast<PixelFormat>(i)));
    r.format =
        *pixel_format_from(n.choice_or("pixel_format", formats, std::string(pfnc_name(sensor.format))));
    r.width_px = sensor.width_px;
    r.height_px = sensor.height_px;
    if (const ConfigNode region = n.map_or_absent("region"); region.present()) {
      const auto pixels = [&](const char* key, std::int64_t min, std::int64_t max) {
        return static_cast<std::uint32_t>(
            region.integer(key, {.min = static_cast<double>(min), .max = static_cast<double>(max)}));
      };
      r.offset_x_px = pixels("x_px", 0, std::int64_t{sensor.width_px} - 1);
      r.offset_y_px = pixels("y_px", 0, std::int64_t{sensor.height_px} - 1);
      r.width_px = pixels("width_px", 1, std::int64_t{sensor.width_px} - r.offset_x_px);
      r.height_px = pixels("height_px", 1, std::int64_t{sensor.height_px} - r.offset_y_px);
      region.finish();
    }
    prototype_ = r;
    description.kind = SampleKind::image;
    description.frame_id = sensor.frame_id.empty() ? config.name + "_optical" : sensor.frame_id;
    description.width_px = r.width_px;
    description.height_px = r.height_px;
    description.format = r.format;
    description.max_bytes = image_bytes(r.format, r.width_px, r.height_px);
    return {};
  }

  Status measure(const SampleProvider::Request& request, Sample& sample) override {
    ImageRequest r = prototype_;
    r.index = request.index;
    r.t_capture = request.t_capture;
    r.t_start = request.t_start;
    r.motion = request.motion;
    sample.size_bytes = image_bytes(r.format, r.width_px, r.height_px);
    if (auto s = provider_->capture(r, sample.memory().first(sample.size_bytes)); !s) return s;
    ImageInfo info;
    info.format = r.format;
    info.width_px = r.width_px;
    info.height_px = r.height_px;
    info.offset_x_px = r.offset_x_px;
    info.offset_y_px = r.offset_y_px;
    info.exposure = r.exposure;
    info.gain_db = r.gain_db;
    sample.info = info;
    return {};
  }

 private:
  std::shared_ptr<ImageProvider> provider_;
  ImageRequest prototype_;
};

class SampleMeasurer final : public Measurer {
 public:
  explicit SampleMeasurer(std::shared_ptr<SampleProvider> provider) : provider_(std::move(provider)) {}

  Status configure(const ChannelConfig& config, ChannelDescription& description) override {
    const auto sensor = provider_->geometry();
    if (config.kind != sensor.kind) return wrong_kind(config, name_of(sensor.kind));
    description.kind = sensor.kind;
    description.frame_id = sensor.frame_id.empty() ? config.name : sensor.frame_id;
    description.width_px = sensor.width_px;
    description.height_px = sensor.height_px;
    description.max_bytes = sensor.max_bytes;
    if (const auto* named = dynamic_cast<const NamedValues*>(provider_.get()))
      description.names = named->names(), description.units = named->units();
    return {};
  }

  [[nodiscard]] bool immediate() const override { return provider_->immediate(); }
  Status measure(const SampleProvider::Request& request, Sample& sample) override {
    return provider_->capture(request, sample);
  }

 private:
  std::shared_ptr<SampleProvider> provider_;
};

}  // namespace

std::unique_ptr<Measurer> make_measurer(std::shared_ptr<ImageProvider> provider) {
  if (!provider) return nullptr;
  return std::make_unique<ImageMeasurer>(std::move(provider));
}
std::unique_ptr<Measurer> make_measurer(std::shared_ptr<SampleProvider> provider) {
  if (!provider) return nullptr;
  return std::make_unique<SampleMeasurer>(std::move(provider));
}

}  // namespace rigor
