#include "bench/application/turn_application.h"

#include <nlohmann/json.hpp>
#include <optional>

#include "bench/application/setup_message.h"
#include "bench/application/turns.h"
#include "sensor-hal/config/json_text.h"

namespace rigor {
namespace application {
namespace {

constexpr std::size_t kRoom = std::size_t{1} << 20;  ///< of a turn's samples

class TurnApplication final : public Application {
 public:
  TurnApplication(const RigConfig& rig, std::unique_ptr<TurnHandler> handler)
      : rig_(rig), handler_(std::move(handler)) {}

  Status configure(ConfigNode params, const ApplicationPorts& ports, Period loop_period) override {
    double rate_hz = 0;
    nlohmann::json own;
    const auto read = catch_config([&] {
      // What chose this application; whoever made it has read it.
      for (const char* key : {"name", "library"})
        if (params.has(key)) {
          where_ = params.error(key, "").error().where;
          (void)params.text(key);
        }
      rate_hz = params.number_or("rate_hz", 0, {.min = 0.001, .max = loop_period.hz()});
      own = nlohmann::json::parse(params.map_or_absent("params").json());
      params.finish();
      return 0;
    });
    if (!read) return tl::unexpected<Error>(read.error());
    turns_.emplace(ports, kRoom, [](const Sample& sample) noexcept {
      return static_cast<std::uint64_t>(reinterpret_cast<std::uintptr_t>(sample.bytes().data()));
    });
    const auto said = handler_->start(setup_message(rig_, ports, loop_period, own)
                                          .dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
    if (!said) return tl::unexpected<Error>(placed(said.error()));
    const auto ready = parse_json(*said).value_or(nlohmann::json());  // it need not say anything
    const auto rate = rate_of_turns(rate_hz, ready, loop_period, where_);
    if (!rate) return tl::unexpected<Error>(rate.error());
    every_ = cycles_of_turn(*rate, loop_period);
    return {};
  }

  void step(std::uint64_t cycle, BenchTime t) noexcept override {
    if (failed_) return;
    turns_->collect();
    if (cycle % every_ != 0) return;
    const auto body = turns_->make(cycle, t).subspan(sizeof(MessageHeader));
    const MonotonicTime began = monotonic_now();
    const auto answer = handler_->turn(body);
    turns_->given();
    turns_->facts.answer.record(monotonic_now() - began);
    refused_ = !answer;
    failed_ = refused_ || !turns_->is_answer(*answer, cycle);
    if (failed_) return;
    ++turns_->facts.answered;
    turns_->command(*answer, t);
  }

  Status finish() override {
    if (!turns_) return {};
    turns_->end();
    if (failed_ && !refused_)
      return fail(ErrorCode::protocol, where_,
                  "the application gave an answer that the protocol does not know");
    const Status s = handler_->finish();
    return s ? Status{} : tl::unexpected<Error>(placed(s.error()));
  }
  bool failed() const noexcept override { return failed_; }
  std::optional<ApplicationFacts> facts() const override {
    return turns_ ? std::optional(turns_->facts) : std::nullopt;
  }

 private:
  [[nodiscard]] Error placed(Error error) const {
    if (error.where.empty()) error.where = where_;
    return error;
  }

  const RigConfig& rig_;
  std::unique_ptr<TurnHandler> handler_;
  std::string where_;
  std::optional<Turns> turns_;
  std::uint64_t every_ = 1;
  bool refused_ = false, failed_ = false;
};

}  // namespace
}  // namespace application

std::unique_ptr<Application> make_turn_application(const RigConfig& rig,
                                                   std::unique_ptr<application::TurnHandler> handler) {
  return std::make_unique<application::TurnApplication>(rig, std::move(handler));
}

}  // namespace rigor
