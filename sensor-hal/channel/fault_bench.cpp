#include "sensor-hal/channel/fault_bench.h"

#include <algorithm>

namespace rigor {
namespace {

std::string or_nearest(const std::string& word, const std::vector<std::string>& all) {
  const std::string near = nearest(word, all);
  return "got " + word + (near.empty() ? "" : "; did you mean '" + near + "'?");
}

}  // namespace

void FaultBench::add(FaultySource& source, std::uint32_t channel) {
  entries_.push_back({source.config().name, channel, &source.faults(), &source, nullptr});
}
void FaultBench::add(FaultySink& sink) {
  entries_.push_back({sink.config().name, kNoChannel, &sink.faults(), nullptr, &sink});
}

bool FaultBench::any_scheduled() const noexcept {
  return std::any_of(entries_.begin(), entries_.end(),
                     [](const Entry& e) { return !e.injector->scheduled().empty(); });
}

Status FaultBench::bind(const std::vector<InputPort>& ports) {
  std::vector<std::string> names;
  for (const InputPort& p : ports) names.push_back(p.name);
  for (const Entry& entry : entries_)
    for (const auto& fault : entry.injector->scheduled()) {
      const FaultTrigger& t = fault->spec.trigger;
      if (t.when == FaultTrigger::When::always) continue;
      const ConfigNode when = fault->node.map("when");
      const auto refuse = [&](std::string_view key, const std::string& message) {
        return tl::unexpected<Error>(when.error(key, message).error());
      };
      const auto port =
          std::find_if(ports.begin(), ports.end(), [&](const auto& p) { return p.name == t.channel; });
      if (port == ports.end())
        return refuse("channel",
                      "expected one of " + joined_or_none(names) + ", " + or_nearest(t.channel, names));
      fault->trigger_port = port->port;
      if (t.when == FaultTrigger::When::overdue || t.when == FaultTrigger::When::disconnected) continue;
      std::vector<std::string> values;
      if (!has_elements(port->description->kind))
        for (const FaultComponent& c : fault_components(port->description->kind, *port->description))
          values.push_back(c.name);
      const auto value = std::find(values.begin(), values.end(), t.value);
      if (value == values.end())
        return refuse("value",
                      "expected one of " + joined_or_none(values) + ", " + or_nearest(t.value, values));
      fault->trigger_component = static_cast<int>(value - values.begin());
    }
  return {};
}

Result<const FaultBench::Entry*> FaultBench::find(const std::string& name) const {
  std::vector<std::string> names;
  for (const Entry& e : entries_) {
    if (e.name == name) return &e;
    names.push_back(e.name);
  }
  return fail(ErrorCode::bad_input, "channel",
              "expected one of " + joined_or_none(names) + ", " + or_nearest(name, names));
}

Result<std::uint32_t> FaultBench::inject(const std::string& name, const ConfigNode& node) {
  const auto entry = find(name);
  if (!entry) return tl::unexpected<Error>(entry.error());
  auto fault = (*entry)->injector->make_live(node);
  if (!fault) return tl::unexpected<Error>(fault.error());
  if (!orders_.try_push({(*entry)->injector, *fault})) {
    (*fault)->over = (*fault)->left = true;
    return fail(ErrorCode::unavailable, name, "the loop has not taken up the last 256 faults yet; try again");
  }
  return (*fault)->index;
}

Status FaultBench::clear(const std::string& name) {
  if (!name.empty())
    if (const auto entry = find(name); !entry) return tl::unexpected<Error>(entry.error());
  for (const Entry& e : entries_)
    if ((name.empty() || e.name == name) && !orders_.try_push({e.injector, nullptr}))
      return fail(ErrorCode::unavailable, e.name,
                  "the loop has not taken up the last 256 orders yet; try again");
  return {};
}

void FaultBench::begin_cycle(BenchTime now) noexcept {
  for (Order order; orders_.try_pop(order);) order.fault ? order.to->add(order.fault) : order.to->end_live();
  for (const Entry& e : entries_) e.injector->begin_cycle(now);
}

const FaultBench::Entry* FaultBench::poll_change(FaultChange& change) noexcept {
  for (const Entry& e : entries_) {
    change = e.injector->poll_change();
    if (change) return &e;
  }
  return nullptr;
}

}  // namespace rigor
