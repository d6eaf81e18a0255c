#include "bench/live/hub.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "sensor-hal/config/json_text.h"

namespace rigor::live {
namespace {

using nlohmann::json;

std::string bytes_text(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace

Hub::Hub(std::string name, std::string session_id, RunInBackground run_in_background)
    : name_(std::move(name)),
      session_id_(std::move(session_id)),
      run_in_background_(std::move(run_in_background)) {}

// ------------------------------------------------------------------ what there is

std::uint32_t Hub::add_channel(ChannelInfo channel, Delivery delivery) {
  channel.id = static_cast<std::uint32_t>(channels_.size() + 1);
  delivery_.push_back(delivery);
  latched_.emplace_back();
  channels_.push_back(std::move(channel));
  subscribers_.push_back(0);
  subscribed_.push_back(0);
  return channels_.back().id;
}

void Hub::add_service(ServiceInfo service, Service answer) {
  service.id = static_cast<std::uint32_t>(services_.size() + 1);
  services_.push_back({std::move(service), std::move(answer)});
}

void Hub::advertise_new() {
  const auto channels = std::span(channels_).subspan(advertised_channels_);
  std::vector<ServiceInfo> services;
  for (std::size_t i = advertised_services_; i < services_.size(); ++i) services.push_back(services_[i].info);
  advertised_channels_ = channels_.size();
  advertised_services_ = services_.size();
  for (auto& [link, client] : clients_) {
    if (!channels.empty()) say(client, advertise(channels));
    if (!services.empty()) say(client, advertise_services(services));
  }
}

void Hub::serve_parameters(std::function<json()> values,
                           std::function<bool(const std::string&, const json&)> set) {
  parameters_ = std::move(values);
  set_parameter_ = std::move(set);
}

// ------------------------------------------------------------------ to clients

bool Hub::overfull(Client& client) {
  if (client.leaving) return true;
  if (client.link->backlog_bytes() <= kMaxBacklog) return false;
  client.leaving = true;
  client.link->close("it does not read what it asked for");
  return true;
}

void Hub::say(Client& client, std::string text) {
  if (overfull(client)) return;
  counters_.bytes_sent.fetch_add(text.size(), std::memory_order_relaxed);
  client.link->send_text(std::move(text));
}

void Hub::say(Client& client, std::string head, Bytes body) {
  if (overfull(client)) return;
  counters_.bytes_sent.fetch_add(head.size() + (body ? body->size() : 0), std::memory_order_relaxed);
  client.link->send_binary(std::move(head), std::move(body));
}

void Hub::complain(Client& client, const std::string& text) {
  say(client, status_message(StatusLevel::error, text));
}

Result<std::vector<MessageHistory::Kept>> Hub::history(std::string_view topic) const {
  for (const ChannelInfo& c : channels_)
    if (c.topic == topic && history_.keeps(c.id)) return history_.messages(c.id);
  return fail(ErrorCode::bad_input, "topic",
              "expected a topic whose messages are kept, got \"" + std::string(topic.substr(0, 80)) + "\"");
}

void Hub::publish(std::uint32_t channel, std::uint64_t time_ns, const Bytes& message) {
  history_.add(channel, time_ns, message);
  const Delivery delivery = delivery_[channel - 1];
  if (delivery == Delivery::latched) latched_[channel - 1] = {time_ns, message};
  for (auto& [link, client] : clients_) {
    const auto it = client.subscription_of.find(channel);
    if (it == client.subscription_of.end() || client.leaving) continue;
    Subscription& to = it->second;
    if (delivery == Delivery::newest && to.period_ns > 0) {
      if (to.waiting) {
        counters_.frames_thinned.fetch_add(1, std::memory_order_relaxed);
        to.waiting.reset();
      }
      if (time_ns < to.next_ns) {
        to.waiting = message;
        to.waiting_time_ns = time_ns;
        continue;
      }
      take_turn(to, time_ns);
    }
    deliver(client, channel, to, time_ns, message);
  }
}

void Hub::take_turn(Subscription& to, std::uint64_t time_ns) {
  // On a grid, so that messages that come a little late do not make the rate lower than was asked for.
  const std::uint64_t late_ns = time_ns - to.next_ns;
  to.next_ns = late_ns < to.period_ns ? to.next_ns + to.period_ns : time_ns + to.period_ns;
}

void Hub::advance(std::uint64_t now_ns) {
  for (auto& [link, client] : clients_) {
    if (client.leaving) continue;
    for (auto& [channel, to] : client.subscription_of) {
      if (!to.waiting || now_ns < to.next_ns) continue;
      const Bytes message = std::move(to.waiting);
      to.waiting.reset();
      take_turn(to, to.next_ns);
      deliver(client, channel, to, to.waiting_time_ns, message);
    }
  }
}

void Hub::deliver(Client& client, std::uint32_t channel, Subscription& to, std::uint64_t time_ns,
                  const Bytes& message) {
  const std::size_t backlog = client.link->backlog_bytes(), size = message->size();
  const std::size_t room = size <= kSmall ? 2 * kBacklog : kBacklog;
  if ((backlog > 0 && backlog + size > room) || (size > kNumbers && client.link->behind())) {
    counters_.frames_dropped.fetch_add(1, std::memory_order_relaxed);
    if (!client.reported_drops)
      say(client, status_message(StatusLevel::warning,
                                 "this client does not read as fast as it subscribed; messages are dropped, "
                                 "of " +
                                     channels_[channel - 1].topic + " the first"));
    client.reported_drops = true;
    return;
  }
  counters_.frames_sent.fetch_add(1, std::memory_order_relaxed);
  say(client, bytes_text(message_head(to.id, time_ns)), message);
}

void Hub::publish_time(std::uint64_t time_ns) {
  for (auto& [link, client] : clients_)
    if (!client.leaving && client.link->backlog_bytes() <= kBacklog)
      say(client, bytes_text(time_message(time_ns)), nullptr);
}

// ------------------------------------------------------------------ from clients

void Hub::opened(Link& link, double max_rate_hz) {
  Client& client = clients_[&link];
  client.max_rate_hz = max_rate_hz;
  client.link = &link;
  client.serial = next_serial_++;
  counters_.clients.store(static_cast<std::uint32_t>(clients_.size()), std::memory_order_relaxed);
  say(client, server_info(name_, session_id_));
  say(client, advertise(std::span(channels_).first(advertised_channels_)));
  std::vector<ServiceInfo> services;
  for (std::size_t i = 0; i < advertised_services_; ++i) services.push_back(services_[i].info);
  if (!services.empty()) say(client, advertise_services(services));
}

void Hub::closed(Link& link) {
  Client* client = client_of(&link);
  if (!client) return;
  for (const auto& [channel, subscription] : client->subscription_of) --subscribers_[channel - 1];
  client->here->store(false, std::memory_order_relaxed);
  clients_.erase(&link);
  counters_.clients.store(static_cast<std::uint32_t>(clients_.size()), std::memory_order_relaxed);
}

Hub::Client* Hub::client_of(const Link* link) {
  const auto it = clients_.find(link);
  return it == clients_.end() ? nullptr : &it->second;
}

void Hub::text(Link& link, std::string_view message) {
  if (Client* client = client_of(&link)) handle(*client, parse_text(message));
}

void Hub::binary(Link& link, std::span<const std::byte> message) {
  if (Client* client = client_of(&link)) handle(*client, parse_binary(message));
}

void Hub::handle(Client& client, Result<ClientMessage> message) {
  if (client.leaving) return;
  if (!message) return complain(client, message.error().text());
  std::visit([&](const auto& m) { on(client, m); }, *message);
}

void Hub::on(Client& client, const Subscribe& message) {
  for (const Subscribe::Entry& e : message.entries) {
    const std::string what =
        "subscription " + std::to_string(e.id) + " of channel " + std::to_string(e.channel);
    if (e.channel == 0 || e.channel > advertised_channels_)
      complain(client, what + ": there is no such channel");
    else if (client.channel_of.contains(e.id))
      complain(client, what + ": this client has a subscription with this id");
    else if (client.subscription_of.contains(e.channel))
      complain(client, what + ": this client has subscribed to this channel");
    else {
      client.channel_of[e.id] = e.channel;
      Subscription& to = client.subscription_of[e.channel];
      to.id = e.id;
      if (const double rate_hz = e.rate_hz > 0 ? e.rate_hz : client.max_rate_hz; rate_hz > 0)
        to.period_ns = static_cast<std::uint64_t>(1e9 / rate_hz);
      ++subscribers_[e.channel - 1];
      ++subscribed_[e.channel - 1];
      // A new subscriber is no slow one: what is latched goes out whatever waits for it.
      if (const Latched& last = latched_[e.channel - 1]; last.message) {
        counters_.frames_sent.fetch_add(1, std::memory_order_relaxed);
        say(client, bytes_text(message_head(to.id, last.time_ns)), last.message);
      }
    }
  }
}

void Hub::on(Client& client, const Unsubscribe& message) {
  for (const std::uint32_t id : message.ids) {
    const auto it = client.channel_of.find(id);
    if (it == client.channel_of.end()) {
      complain(client, "there is no subscription " + std::to_string(id) + " of this client");
      continue;
    }
    --subscribers_[it->second - 1];
    client.subscription_of.erase(it->second);
    client.channel_of.erase(it);
  }
}

void Hub::on(Client& client, const GetParameters& message) {
  json all = parameters_ ? parameters_() : json::array();
  if (!message.names.empty()) {
    json some = json::array();
    for (const json& p : all)
      if (std::find(message.names.begin(), message.names.end(), p["name"].get<std::string>()) !=
          message.names.end())
        some.push_back(p);
    all = std::move(some);
  }
  say(client, parameter_values(all, message.id));
}

void Hub::on(Client& client, const SetParameters& message) {
  std::vector<std::string> names;
  for (const SetParameters::Entry& e : message.entries) {
    names.push_back(e.name);
    const auto value = parse_json(e.value);
    if (!set_parameter_ || !value || !set_parameter_(e.name, *value))
      complain(client, e.name + ": there is no such parameter, or it cannot have this value");
  }
  on(client, GetParameters{names, message.id});
}

void Hub::on(Client& client, const ServiceCall& m) {
  const auto refuse = [&](const std::string& why) {
    say(client, service_call_failure(m.service, m.call, why));
  };
  if (m.service == 0 || m.service > advertised_services_) return refuse("there is no such service");
  if (m.encoding != "json")
    return refuse("expected the encoding json, got \"" + m.encoding.substr(0, 40) + "\"");
  if (const auto request = parse_json(m.request, "request", kMaxMessageBytes); !request)
    return refuse(request.error().text());
  if (client.calls >= kCalls)
    return refuse("expected at most " + std::to_string(kCalls) + " calls at a time; wait for their answers");
  if (calls_ >= kAllCalls) return refuse("this server is busy with calls of other clients; ask again");
  ++client.calls;
  ++calls_;
  auto answer = std::make_shared<std::string>();
  run_in_background_(
      [service = services_[m.service - 1].answer, request = m.request, answer, here = client.here] {
        if (here->load(std::memory_order_relaxed)) *answer = service(request);
      },
      [this, link = client.link, serial = client.serial, id = m.service, call = m.call, answer] {
        --calls_;
        Client* c = client_of(link);
        if (!c || c->serial != serial) return;
        --c->calls;
        say(*c, service_response(id, call, "json", *answer), nullptr);
      });
}

void Hub::on(Client& client, const NotOffered& m) {
  complain(client, "this server does not offer what \"" + m.what + "\" needs");
}

}  // namespace rigor::live
