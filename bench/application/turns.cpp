#include "bench/application/turns.h"

#include <utility>

namespace rigor::application {

Turns::Turns(const ApplicationPorts& ports, std::size_t capacity_bytes, PlaceOf place_of)
    : place_of_(place_of), message_(ports.inputs.size(), capacity_bytes) {
  for (const auto& [name, input] : ports.inputs) {
    const SampleKind kind = input.description->kind;
    const bool by_place =
        kind == SampleKind::image || kind == SampleKind::range_image || kind == SampleKind::point_cloud;
    inputs_.push_back({input.port, by_place, false, {}, {}});
  }
  for (const auto& [name, output] : ports.outputs) {
    outputs_.push_back(output);
    values_of_output_.push_back(output->describe().names.size());
  }
}

void Turns::add(std::uint32_t i, const SampleLease& sample) noexcept {
  const std::uint64_t place = sample->size_bytes > 0 ? place_of_(*sample) : 0;
  if (message_.add(i, *sample, place)) return;
  facts.dropped += forget();
  (void)message_.add(i, *sample, place);
}

/// How many samples the message had that no one counted before.
std::uint64_t Turns::forget() noexcept { return message_.clear() - std::exchange(again_, 0); }

void Turns::collect() noexcept {
  for (std::uint32_t i = 0; i < inputs_.size(); ++i) {
    Input& input = inputs_[i];
    if (input.port->status() != PortStatus::fresh) continue;
    if (!input.by_place) {
      add(i, input.port->sample());
      continue;
    }
    if (input.next && !input.again) ++facts.superseded;
    input.again = false;
    input.next = input.port->sample();
  }
}

void Turns::restart() noexcept {
  release_samples();
  facts.dropped += forget();
  for (std::uint32_t i = 0; i < inputs_.size(); ++i) {
    Input& input = inputs_[i];
    if (!input.port->sample()) continue;
    if (input.by_place) {
      input.next = input.port->sample();
      input.again = true;
    } else {
      add(i, input.port->sample());
      ++again_;
    }
  }
}

std::span<const std::byte> Turns::make(std::uint64_t cycle, BenchTime t) noexcept {
  for (std::uint32_t i = 0; i < inputs_.size(); ++i) {
    Input& input = inputs_[i];
    message_.set_status(i, input.port->status());
    if (!input.next) continue;
    add(i, input.next);
    again_ += std::exchange(input.again, false);
    input.shown = std::move(input.next);
    input.next.reset();
  }
  return message_.finish(cycle, t);
}

void Turns::given() noexcept {
  ++facts.turns;
  facts.delivered += forget();
}

void Turns::release_samples() noexcept {
  for (Input& input : inputs_) {
    if (input.next && !std::exchange(input.again, false)) ++facts.dropped;
    input.next.reset();
    input.shown.reset();
  }
}

void Turns::end() noexcept {
  const std::uint64_t before = facts.dropped;
  release_samples();
  facts.after_last += facts.dropped - before + forget();
  facts.dropped = before;
}

bool Turns::is_answer(std::span<const std::byte> body, std::uint64_t cycle) const noexcept {
  AnswerReader reader;
  if (!reader.open(body) || reader.cycle() != cycle) return false;
  AnsweredCommand command;
  AnswerReader::Next next;
  while ((next = reader.next(values_of_output_, command)) == AnswerReader::Next::command) {
  }
  return next == AnswerReader::Next::end;
}

void Turns::command(std::span<const std::byte> body, BenchTime t) noexcept {
  AnswerReader reader;
  if (!reader.open(body)) return;
  AnsweredCommand command;
  while (reader.next(values_of_output_, command) == AnswerReader::Next::command)
    (void)outputs_[command.output]->send(t, std::span(command.value).first(command.count));
}

}  // namespace rigor::application
