#include "apps/script/script.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace rigor {
namespace {

class Script final : public Application {
 public:
  Status configure(ConfigNode params, const ApplicationPorts& ports, Period loop_period) override {
    tracks_.clear();
    auto read = catch_config([&] {
      const ConfigNode sinks = params.map("sinks");
      for (const std::string& name : sinks.keys()) read_track(sinks, name, ports, loop_period);
      params.finish();
      return 0;
    });
    return read ? Status{} : Status(tl::unexpected<Error>(read.error()));
  }

  void step(std::uint64_t cycle, BenchTime t_cycle) noexcept override {
    if (!started_) t_start_ = t_cycle;
    started_ = true;
    for (Track& track : tracks_) {
      if (cycle % track.every != 0) continue;
      std::int64_t since = (t_cycle - t_start_).ns();
      if (track.repeat.ns() > 0) since %= track.repeat.ns();
      const Step* now = nullptr;
      for (const Step& s : track.steps)
        if (s.at.ns() <= since) now = &s;
      if (now) (void)track.port->send(t_cycle, std::span(now->values).first(track.count));
    }
  }

 private:
  struct Step {
    Duration at;
    std::array<double, 16> values{};
  };
  struct Track {
    CommandPort* port = nullptr;
    std::size_t count = 0;
    std::uint64_t every = 1;  ///< cycles
    Duration repeat;
    std::vector<Step> steps;
  };

  void read_track(const ConfigNode& sinks, const std::string& name, const ApplicationPorts& ports,
                  Period loop_period) {
    const auto port = ports.outputs.find(name);
    if (port == ports.outputs.end()) {
      std::string names;
      for (const auto& [known, p] : ports.outputs) names += (names.empty() ? "" : ", ") + known;
      throw sinks.error(name, "expected the name of a sink (" + (names.empty() ? "there is none" : names) +
                                  "), got \"" + name + "\"");
    }
    const ConfigNode n = sinks.map(name);
    Track track;
    track.port = port->second;
    track.count = track.port->describe().names.size();
    const double loop_hz = loop_period.hz();
    const double rate_hz = n.number_or("rate_hz", std::min(20.0, loop_hz), {.min = 0.001, .max = loop_hz});
    track.every = static_cast<std::uint64_t>(std::llround(loop_hz / rate_hz));
    track.repeat = seconds_from(n.number_or("repeat_s", 0, {.min = 0, .max = 1e6}));
    for (const ConfigNode& item : n.list("steps")) {
      Step s;
      s.at = seconds_from(item.number("at_s", {.min = 0, .max = 1e6}));
      const std::vector<double> values = item.numbers("values", track.count);
      std::copy(values.begin(), values.end(), s.values.begin());
      item.finish();
      if (!track.steps.empty() && s.at < track.steps.back().at)
        throw item.error("at_s", "expected the steps in the order of time");
      track.steps.push_back(s);
    }
    n.finish();
    tracks_.push_back(std::move(track));
  }

  std::vector<Track> tracks_;
  BenchTime t_start_;
  bool started_ = false;
};

}  // namespace

std::unique_ptr<Application> make_script() { return std::make_unique<Script>(); }

}  // namespace rigor
