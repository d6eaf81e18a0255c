#include "bench/dataset/dataset_device.h"

#include <fmt/format.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "bench/tune/engine_choices.h"
#include "sensor-hal/models/calibration_section.h"

namespace rigor::dataset {

Result<std::unique_ptr<Device>> Device::create(const Setup& setup) {
  if (setup.params.has("model_schedule"))
    return tl::unexpected<Error>(
        setup.params
            .error("model_schedule", "expected a device that stays the same, got one that changes with time")
            .error());
  std::unique_ptr<Device> device(new Device(setup));
  if (auto s = device->make(0); !s) return tl::unexpected<Error>(s.error());
  return device;
}

Status Device::can_be_drawn() const {
  const auto sensor_model = catch_config(
      [&] { return load_sensor_model(setup_.params.base_dir() / setup_.params.text("sensor"), 1); });
  if (!sensor_model) return tl::unexpected<Error>(sensor_model.error());
  if (!*sensor_model) return tl::unexpected<Error>(sensor_model->error());
  return {};
}

Status Device::become(std::uint64_t draw) { return draw == draw_ ? Status{} : make(draw); }

Status Device::make(std::uint64_t draw) {
  auto choice = sense_choice(setup_.rig, setup_.entry, setup_.simulation, setup_.renderer);
  if (!choice) return tl::unexpected<Error>(choice.error());
  SensorOptions how;
  how.mount = setup_.mount;
  if (draw != 0) how.draw = draw;
  how.choice = std::move(*choice);
  if (!how.choice && !setup_.params.has("renderer")) {
    how.choice.emplace();
    how.choice->engine = "rays";
  }
  // Another device has another pattern of noise, too.
  const std::string name =
      draw == 0 ? setup_.entry.name : fmt::format("{}.device{}", setup_.entry.name, draw);
  if (setup_.entry.kind == SampleKind::image) {
    auto made = setup_.simulation.sensed_camera(setup_.params, setup_.seed, name, how);
    if (!made) return tl::unexpected<Error>(made.error());
    camera_ = std::move(*made);
    lens_ = camera_->model();
  } else {
    auto made = setup_.simulation.sampler(setup_.entry.kind, setup_.params, setup_.seed, name, how);
    if (!made) return tl::unexpected<Error>(made.error());
    sampler_ = std::move(*made);
    lens_ = sampler_->lens();
    sample_.reserve(sampler_->geometry().max_bytes);
  }
  draw_ = draw;
  axial_.clear();
  if (!lens_ || !setup_.truth) return {};
  axial_.reserve(static_cast<std::size_t>(lens_->width_px) * static_cast<std::size_t>(lens_->height_px));
  for (int v = 0; v < lens_->height_px; ++v)
    for (int u = 0; u < lens_->width_px; ++u) {
      const auto ray = unproject_ray(*lens_, {static_cast<double>(u), static_cast<double>(v)});
      axial_.push_back(ray ? static_cast<float>(ray->z) : std::numeric_limits<float>::quiet_NaN());
    }
  return {};
}

Status Device::capture(std::uint64_t index, const WorldMotion& motion, const Exposure& exposure,
                       DatasetView& view) {
  view.channel = setup_.entry.name;
  view.kind = setup_.entry.kind;
  view.device = draw_;
  view.lens = lens_;
  GroundTruth* truth = setup_.truth ? &view.truth : nullptr;
  if (camera_) {
    camera_->set_truth(truth);
    const ImageProvider::Geometry geometry = camera_->geometry();
    ImageRequest r;
    r.index = index;
    r.motion = motion;
    r.format = geometry.format;
    r.width_px = view.width = geometry.width_px;
    r.height_px = view.height = geometry.height_px;
    const auto read = catch_config([&] {
      r.exposure = seconds_from(1e-6 * exposure.exposure_us.value_or(setup_.params.number_or(
                                           "exposure_us", geometry.exposure.seconds() * 1e6,
                                           {.min = 0, .max = 60e6, .exclusive_min = true})));
      r.gain_db = exposure.gain_db.value_or(setup_.params.number_or("gain_db", 0));
      return true;
    });
    if (!read) return tl::unexpected<Error>(read.error());
    view.pixels.resize(image_bytes(r.format, r.width_px, r.height_px));
    view.image = {r.format, r.width_px, r.height_px, 0, 0, r.exposure, r.gain_db};
    return camera_->capture(r, view.pixels);
  }
  sampler_->set_truth(truth);
  SampleProvider::Request r;
  r.index = index;
  r.motion = motion;
  if (auto s = sampler_->capture(r, sample_); !s) return s;
  if (const auto* cloud = sample_.as<PointCloudInfo>()) {
    view.width = cloud->count;
    view.height = 1;
    view.points.resize(cloud->count);
    if (cloud->count > 0) std::memcpy(view.points.data(), sample_.bytes().data(), sample_.size_bytes);
  } else if (const auto* info = sample_.as<RangeImageInfo>()) {
    view.width = info->width_px;
    view.height = info->height_px;
    const std::size_t n = std::size_t{view.width} * view.height;
    view.range_m.resize(n);
    view.amplitude.resize(n);
    std::memcpy(view.range_m.data(), sample_.bytes().data(), n * sizeof(float));
    std::memcpy(view.amplitude.data(), sample_.bytes().data() + n * sizeof(float), n * sizeof(float));
  }
  return {};
}

std::vector<float> Device::depth_of(const GroundTruth& truth) const {
  std::vector<float> depth(truth.range_m);
  for (std::size_t i = 0; i < depth.size() && i < axial_.size(); ++i)
    // Where nothing is, nothing is at any depth; the axial part of a fisheye's ray may be 0 or less.
    depth[i] = std::isinf(depth[i]) && !std::isnan(axial_[i]) ? depth[i] : depth[i] * axial_[i];
  return depth;
}

}  // namespace rigor::dataset
