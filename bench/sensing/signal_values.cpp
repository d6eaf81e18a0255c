#include "bench/sensing/signal_values.h"

#include <fmt/format.h>

#include "sensor-hal/channel/named_values.h"

namespace rigor {
namespace {

/// The joints of the request that is being answered: what is measured depends on it alone.
class RequestMotion final : public MotionSource {
 public:
  [[nodiscard]] WorldMotion motion_at(BenchTime) const noexcept override { return now; }
  WorldMotion now;
};

class SignalValues final : public SampleProvider, public NamedValues {
 public:
  SignalValues(std::shared_ptr<SignalModel> model, std::shared_ptr<RequestMotion> motion)
      : model_(std::move(model)), motion_(std::move(motion)) {
    for (const SignalModel::Signal& s : model_->signals()) names_.push_back(s.name), units_.push_back(s.unit);
  }
  [[nodiscard]] Geometry geometry() const override { return {SampleKind::register_block, 0, 0, 0, ""}; }
  [[nodiscard]] Status capture(const Request& request, Sample& sample) override {
    motion_->now = request.motion;
    RegisterBlock block;
    block.count = static_cast<std::uint32_t>(names_.size());
    for (std::uint32_t i = 0; i < block.count; ++i) block.value[i] = model_->read(i, request.t_capture);
    sample.info = block;
    sample.size_bytes = 0;
    return {};
  }
  [[nodiscard]] const std::vector<std::string>& names() const override { return names_; }
  [[nodiscard]] const std::vector<std::string>& units() const override { return units_; }

 private:
  std::shared_ptr<SignalModel> model_;
  std::shared_ptr<RequestMotion> motion_;
  std::vector<std::string> names_, units_;
};

}  // namespace

std::shared_ptr<SampleProvider> make_signal_values(const ConfigNode& params, const JointFinder& joint) {
  auto motion = std::make_shared<RequestMotion>();
  auto model = read_device_signals(params, nullptr, motion, joint);
  if (!model || model->signals().empty())
    throw params.error("signals", "expected what a simulated channel of registers tells, got nothing");
  if (model->signals().size() > RegisterBlock::kMax)
    throw params.error("signals", fmt::format("expected at most {} signals, got {}", RegisterBlock::kMax,
                                              model->signals().size()));
  for (const SignalModel::Signal& s : model->signals())
    if (s.commanded)
      throw params.map("signals").error(s.name, "expected a signal that nobody commands: nobody does here");
  return std::make_shared<SignalValues>(std::move(model), std::move(motion));
}

}  // namespace rigor
