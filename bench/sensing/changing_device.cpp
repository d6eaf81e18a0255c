#include "bench/sensing/changing_device.h"

#include <algorithm>
#include <vector>

namespace rigor {
namespace {

template <class Provider>
struct Stage {
  Duration from;
  std::shared_ptr<Provider> device;
};

template <class Provider>
class Stages {
 public:
  explicit Stages(std::vector<Stage<Provider>> stages) : stages_(std::move(stages)) {}
  [[nodiscard]] Provider& first() const { return *stages_.front().device; }
  [[nodiscard]] Provider& at(Duration since_start) const {
    std::size_t i = stages_.size() - 1;
    while (i > 0 && stages_[i].from > since_start) --i;
    return *stages_[i].device;
  }
  [[nodiscard]] const std::vector<Stage<Provider>>& all() const { return stages_; }

 private:
  std::vector<Stage<Provider>> stages_;
};

class ChangingCamera final : public ImageProvider {
 public:
  explicit ChangingCamera(Stages<ImageProvider> stages) : stages_(std::move(stages)) {}
  [[nodiscard]] Geometry geometry() const override { return stages_.first().geometry(); }
  [[nodiscard]] Status capture(const ImageRequest& r, std::span<std::byte> pixels) override {
    return stages_.at(r.t_capture - r.t_start).capture(r, pixels);
  }

 private:
  Stages<ImageProvider> stages_;
};

class ChangingSampler final : public SampleProvider {
 public:
  explicit ChangingSampler(Stages<SampleProvider> stages) : stages_(std::move(stages)) {}
  [[nodiscard]] Geometry geometry() const override {
    Geometry g = stages_.first().geometry();
    for (const auto& s : stages_.all()) g.max_bytes = std::max(g.max_bytes, s.device->geometry().max_bytes);
    return g;
  }
  [[nodiscard]] const models::LidarScan* scan() const override { return stages_.first().scan(); }
  [[nodiscard]] Status capture(const Request& r, Sample& sample) override {
    return stages_.at(r.t_capture - r.t_start).capture(r, sample);
  }

 private:
  Stages<SampleProvider> stages_;
};

template <class Changing, class Provider, class Make>
Result<std::shared_ptr<Provider>> device_of(const ConfigNode& params, const Make& make) {
  auto first = make(params);
  const auto items = params.list_or_empty("model_schedule");
  if (!first || items.empty()) return first;
  std::vector<Stage<Provider>> stages{{Duration(), std::move(*first)}};
  for (const ConfigNode& item : items) {
    const Duration from = seconds_from(item.number("from_s", {.min = 0, .max = 1e7}));
    if (from < stages.back().from) throw item.error("from_s", "expected the devices in the order of time");
    auto next = make(item);
    if (!next) return next;
    const auto a = stages.front().device->geometry(), b = (*next)->geometry();
    if (a.width_px != b.width_px || a.height_px != b.height_px)
      throw item.error("sensor", "expected a sensor of as many pixels as that which it takes the place of");
    item.finish();
    stages.push_back({from, std::move(*next)});
  }
  return std::shared_ptr<Provider>(std::make_shared<Changing>(Stages<Provider>(std::move(stages))));
}

}  // namespace

Result<std::shared_ptr<ImageProvider>> changing_camera(
    const ConfigNode& params,
    const std::function<Result<std::shared_ptr<ImageProvider>>(const ConfigNode&)>& make) {
  return device_of<ChangingCamera, ImageProvider>(params, make);
}

Result<std::shared_ptr<SampleProvider>> changing_sampler(
    const ConfigNode& params,
    const std::function<Result<std::shared_ptr<SampleProvider>>(const ConfigNode&)>& make) {
  return device_of<ChangingSampler, SampleProvider>(params, make);
}

}  // namespace rigor
