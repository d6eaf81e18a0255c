#include "bench/sensing/device_signals.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <numbers>
#include <set>

#include "rt-core/numbers.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/replay_source.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor {
namespace {

/// One signal's law; `write` only of commanded ones.
class Law {
 public:
  virtual ~Law() = default;
  [[nodiscard]] virtual double read(BenchTime t) = 0;
  [[nodiscard]] virtual bool write(double, BenchTime) { return false; }
};

class Constant final : public Law {
 public:
  explicit Constant(double value) : value_(value) {}
  double read(BenchTime) override { return value_; }

 private:
  double value_;
};

class Commanded final : public Law {
 public:
  explicit Commanded(double value) : value_(value) {}
  double read(BenchTime) override { return value_; }
  bool write(double value, BenchTime) override {
    value_ = value;
    return std::isfinite(value);
  }

 private:
  double value_;
};

class Sine final : public Law {
 public:
  Sine(const ConfigNode& n)
      : amplitude_(n.number("amplitude")),
        period_ns_(n.number("period_s", {.min = 1e-6, .max = 1e9}) * 1e9),
        offset_(n.number_or("offset", 0)),
        phase_rad_(n.number_or("phase_deg", 0) * std::numbers::pi / 180) {
    n.finish();
  }
  double read(BenchTime t) override {
    // The turn first: the sine of years in radians would have lost its digits.
    const double turns = std::fmod(static_cast<double>(t.ns()), period_ns_) / period_ns_;
    return offset_ + amplitude_ * std::sin(2 * std::numbers::pi * turns + phase_rad_);
  }

 private:
  double amplitude_, period_ns_, offset_, phase_rad_;
};

class Joint final : public Law {
 public:
  Joint(std::shared_ptr<const MotionSource> motion, std::size_t index, bool rate, double scale)
      : motion_(std::move(motion)), index_(index), rate_(rate), scale_(scale) {}
  double read(BenchTime t) override {
    const WorldMotion m = motion_->motion_at(t);
    if (index_ >= m.count) return kNaN;
    return (rate_ ? m.joint[index_].rate_at(t) : m.joint[index_].at(t)) * scale_;
  }

 private:
  std::shared_ptr<const MotionSource> motion_;
  std::size_t index_;
  bool rate_;
  double scale_;
};

class Recorded final : public Law {
 public:
  Recorded(const ConfigNode& n) {
    const auto file = n.base_dir() / n.text("recording");
    const auto channel = n.text("channel"), value = n.text("value");
    repeat_ = n.flag_or("repeat", false);
    n.finish();
    const auto loaded = load(file.string(), "/" + channel + "/registers", value);
    if (!loaded) throw n.error("recording", loaded.error().text());
    if (points_.empty())
      throw n.error("channel", "expected a register channel of " + file.string() + " with a value \"" +
                                   value + "\", found no sample of one");
  }
  double read(BenchTime t) override {
    if (!started_) start_ = t, started_ = true;
    std::int64_t since = (t - start_).ns();
    const std::int64_t length = points_.back().first - points_.front().first;
    if (repeat_ && length > 0)
      since %= length;
    else if (since > length)
      return kNaN;
    const std::int64_t at = points_.front().first + since;
    const auto next = std::upper_bound(points_.begin(), points_.end(), at,
                                       [](std::int64_t x, const auto& point) { return x < point.first; });
    return next == points_.begin() ? kNaN : std::prev(next)->second;
  }

 private:
  Status load(const std::string& file, const std::string& topic, const std::string& value) {
    auto reader = record::McapReader::open(file);
    if (!reader) return tl::unexpected<Error>(reader.error());
    record::SampleDecoder decoder(topic);
    std::set<std::string> topics;
    for (const auto& [id, channel] : (*reader)->channels())
      if (decoder.wants(channel.topic)) topics.insert(channel.topic);
    if (topics.empty()) {
      std::vector<std::string> there;
      for (const auto& [id, channel] : (*reader)->channels())
        if (channel.topic.ends_with("/registers")) there.push_back(channel.topic);
      return fail(ErrorCode::bad_input, file,
                  fmt::format("expected a topic {}, found none; channels of registers have the topics: {}",
                              topic, there.empty() ? "none" : fmt::format("{}", fmt::join(there, ", "))));
    }
    auto cursor = (*reader)->messages({.topics = topics, .order = record::MessageOrder::file});
    record::MessageView view;
    record::msg::RegisterBlock names;
    std::ptrdiff_t index = -1;
    Sample sample;
    while (true) {
      const auto more = cursor.next(view);
      if (!more) return tl::unexpected<Error>(more.error());
      if (!*more) return {};
      if (index < 0 && view.channel->topic == topic) {
        if (auto s = record::CdrReader::read(view.data, names); !s) return s;
        const auto found = std::find(names.names.begin(), names.names.end(), value);
        if (found == names.names.end())
          return fail(ErrorCode::bad_input, file,
                      fmt::format("expected one of the channel's values {}, got \"{}\"",
                                  fmt::join(names.names, ", "), value));
        index = found - names.names.begin();
      }
      const auto whole = decoder.take(view);
      if (!whole) return tl::unexpected<Error>(whole.error());
      if (!*whole) continue;
      if (auto s = decoder.fill(sample); !s) return s;
      const auto* block = sample.as<RegisterBlock>();
      if (!block || index < 0 || static_cast<std::uint32_t>(index) >= block->count) continue;
      const std::int64_t t = decoder.stamp().t_capture.ns();
      if (points_.empty() || t > points_.back().first)
        points_.emplace_back(t, block->value[static_cast<std::size_t>(index)]);
    }
  }

  std::vector<std::pair<std::int64_t, double>> points_;  // capture in ns, value
  BenchTime start_;
  bool started_ = false, repeat_ = false;
};

class Composed final : public SignalModel {
 public:
  explicit Composed(std::shared_ptr<SignalModel> base) : base_(std::move(base)) {
    if (base_) all_ = base_->signals();
    base_count_ = all_.size();
  }
  void add(Signal signal, std::unique_ptr<Law> law) {
    all_.push_back(std::move(signal));
    laws_.push_back(std::move(law));
  }
  [[nodiscard]] const std::vector<Signal>& signals() const override { return all_; }
  [[nodiscard]] double read(std::size_t i, BenchTime t) override {
    if (i < base_count_) return base_->read(i, t);
    const std::lock_guard lock(mutex_);
    return i - base_count_ < laws_.size() ? laws_[i - base_count_]->read(t) : kNaN;
  }
  [[nodiscard]] bool write(std::size_t i, double value, BenchTime t) override {
    if (i < base_count_) return base_->write(i, value, t);
    const std::lock_guard lock(mutex_);
    return i - base_count_ < laws_.size() && laws_[i - base_count_]->write(value, t);
  }

 private:
  std::shared_ptr<SignalModel> base_;
  std::size_t base_count_ = 0;
  std::vector<Signal> all_;
  std::vector<std::unique_ptr<Law>> laws_;
  std::mutex mutex_;  // one device may be on two buses
};

}  // namespace

std::shared_ptr<SignalModel> read_device_signals(const ConfigNode& params, std::shared_ptr<SignalModel> base,
                                                 std::shared_ptr<const MotionSource> motion,
                                                 const JointFinder& joint) {
  const ConfigNode map = params.map_or_absent("signals");
  if (!map.present()) return base;
  auto model = std::make_shared<Composed>(base);
  for (const auto& name : map.keys()) {
    for (const auto& known : model->signals())
      if (known.name == name)
        throw map.error(name, "expected a name of its own, got that of a signal that the model has");
    const ConfigNode n = map.map(name);
    SignalModel::Signal signal{name, n.text_or("unit", ""), false};
    std::unique_ptr<Law> law;
    if (n.has("constant")) {
      law = std::make_unique<Constant>(n.number("constant"));
    } else if (n.has("commanded")) {
      law = std::make_unique<Commanded>(n.number("commanded"));
      signal.commanded = true;
    } else if (n.has("sine")) {
      law = std::make_unique<Sine>(n.map("sine"));
    } else if (n.has("joint")) {
      (void)n.text("joint");
      const auto index = joint(n, "joint");
      const bool rate = n.choice_or("quantity", {"position", "rate"}, "position") == "rate";
      const bool degrees = n.choice_or("unit", {"deg", "rad"}, "deg") == "deg";
      signal.unit = std::string(degrees ? "deg" : "rad") + (rate ? "/s" : "");
      law = std::make_unique<Joint>(motion, index, rate, degrees ? 180 / std::numbers::pi : 1.0);
    } else if (n.has("recording")) {
      law = std::make_unique<Recorded>(n);
    } else {
      throw map.error(name, "expected one of constant, commanded, sine, joint, recording, got none of them");
    }
    n.finish();
    model->add(std::move(signal), std::move(law));
  }
  return model;
}

}  // namespace rigor
