#include "bench/live/live_view.h"

#include <cmath>
#include <mutex>
#include <nlohmann/json.hpp>

#include "bench/live/channels.h"
#include "bench/live/estimate.h"
#include "bench/live/pairs.h"
#include "bench/live/parameters.h"
#include "bench/live/status.h"
#include "bench/live/world.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/record/recorder.h"
#include "sim/world/store/value_codec.h"

namespace rigor::live {
namespace {

using nlohmann::json;

constexpr Duration kStatusPeriod = milliseconds(200);
constexpr const char* kNoMoreCommands =
    R"({"ok":false,"error":{"code":"wrong_state","message":"the run has ended; nothing can be changed in it any more"}})";

Bytes text_bytes(const json& j) {
  return std::make_shared<const std::string>(j.dump(-1, ' ', false, json::error_handler_t::replace));
}

/// {"topic": …}: what is kept of its messages, in base64.
Result<json> history(const Hub& hub, const json& request) {
  const auto kept = hub.history(request.at("topic").get<std::string>());
  if (!kept) return tl::unexpected<Error>(kept.error());
  json list = json::array();
  for (const MessageHistory::Kept& k : *kept)
    list.push_back({{"utc_ns", std::to_string(k.time_ns)},
                    {"data", world::store::base64(std::as_bytes(std::span(*k.message)))}});
  return json{{"messages", std::move(list)}};
}

json to_json(const LiveEstimate::At& at, BenchTime t0) {
  const auto known = [](double v) { return std::isfinite(v) ? json(v) : json(); };
  return {{"t_s", (at.t - t0).seconds()},
          {"x_m", at.x_m},
          {"y_m", at.y_m},
          {"distance_m", std::hypot(at.along_m, at.across_m)},
          {"along_m", at.along_m},
          {"across_m", at.across_m},
          {"yaw_rad", known(at.yaw_rad)},
          {"sigma_m", known(at.sigma_m)}};
}

}  // namespace

struct LiveView::Impl {
  Impl(Server& s, const Context& c)
      : server(s),
        context(c),
        tap(stream_specs(c.parts), c.parts.rig.clock == ClockKind::virtual_time),
        channels(c.parts, c.epoch),
        status(c.parts, c.counters, c.commands, tap, c.epoch, c.replay),
        estimate(LiveEstimate::of(c.parts)),
        pairs(c.parts) {
    if (c.simulation) world.emplace(*c.simulation, c.parts, tap);
  }

  void offer(Hub& hub) {
    channels.add_to(hub);
    status_id = hub.add_channel({0, "/rigor/live", "json", "rigor.Live", "jsonschema", LiveStatus::schema()});
    const std::string object = R"({"type":"object"})";
    const auto add_plotted = [&](const char* topic, const char* type) {
      const std::uint32_t id = hub.add_channel({0, topic, "json", type, "jsonschema", object});
      hub.keep(id, MessageHistory::Keep::thinned);
      return id;
    };
    if (estimate) estimate_id = add_plotted("/rigor/estimate", "rigor.Estimate");
    if (!pairs.none()) pairs_id = add_plotted("/rigor/pairs", "rigor.Pairs");
    hub.add_service({0, "rigor/history", object, object}, [&hub](const std::string& request) {
      return service_answer(request, [&hub](const json& j) { return history(hub, j); });
    });
    hub.add_service({0, "rigor/control", object, object}, [this](const std::string& request) {
      const std::lock_guard lock(command_mutex);
      return no_more_commands ? std::string(kNoMoreCommands) : context.commands.answer(request);
    });
    if (world) offer_world(hub);
    serve_parameters(hub, context.parts);
    hub.advertise_new();
  }
  void offer_world(Hub& hub) {
    const std::string object = R"({"type":"object"})";
    world_id = hub.add_channel({0, "/rigor/world", "json", "rigor.World", "jsonschema",
                                R"({"type":"object","title":"rigor.World"})"});
    const auto serve = [&](const char* name, Result<json> (LiveWorld::*answer)(const json&) const) {
      hub.add_service({0, name, object, object}, [this, answer](const std::string& request) {
        return service_answer(request, [this, answer](const json& j) { return ((*world).*answer)(j); });
      });
    };
    serve("rigor/world/map", &LiveWorld::map);
    serve("rigor/world/pick", &LiveWorld::pick);
    serve("rigor/world/node", &LiveWorld::node);
    hub.add_service({0, "rigor/world/set", object, object}, [this](const std::string& request) {
      return service_answer(request, [this](const json& j) { return world->set(j); });
    });
  }
  /// When something moved since, or somebody is new.
  void show_world(Hub& hub) {
    if (!world || !hub.wanted(world_id)) return;
    tap.want_motion();
    const std::uint64_t subscribed = hub.subscribed(world_id);
    std::string key = world->moving_key();
    if (subscribed == world_subscribed && key == world_key) return;
    world_subscribed = subscribed;
    world_key = std::move(key);
    hub.publish(world_id, channels.utc_ns(tap.now()), text_bytes(world->moving()));
  }
  void pump(Hub& hub) {
    channels.pump(hub, tap, estimate ? &*estimate : nullptr);
    if (!estimate) return;
    while (const auto at = estimate->next())
      hub.publish(estimate_id, channels.utc_ns(at->t), text_bytes(to_json(*at, tap.t0())));
  }
  void show_pairs(Hub& hub) {
    if (pairs_id == 0) return;
    if (const auto j = pairs.changed(tap)) hub.publish(pairs_id, channels.utc_ns(tap.now()), text_bytes(*j));
  }
  void show_status(Hub& hub) {
    hub.publish_time(channels.utc_ns(tap.now()));
    if (!hub.wanted(status_id)) return;
    json j = status(hub.counters());
    if (ended) j["ended"] = true;
    hub.publish(status_id, channels.utc_ns(tap.now()), text_bytes(j));
  }

  Server& server;
  Context context;
  LiveTap tap;
  LiveChannels channels;
  LiveStatus status;
  std::optional<LiveEstimate> estimate;
  LivePairs pairs;
  std::optional<LiveWorld> world;
  bool ended = false;  ///< server's thread
  std::mutex command_mutex;
  bool no_more_commands = false;  ///< guarded by command_mutex
  std::uint32_t status_id = 0, world_id = 0, estimate_id = 0, pairs_id = 0;
  std::uint64_t world_subscribed = 0;
  std::string world_key;
};

LiveView::LiveView(Server& server, const Context& context) : impl_(std::make_unique<Impl>(server, context)) {
  Impl* i = impl_.get();
  server.run_there([i] { i->offer(i->server.hub()); });
  server.every(LiveChannels::kTick, [i] { i->pump(i->server.hub()); });
  server.every(kStatusPeriod, [i] {
    i->show_status(i->server.hub());
    i->show_pairs(i->server.hub());
    i->show_world(i->server.hub());
  });
}

void LiveView::ended() {
  Impl* i = impl_.get();
  {
    const std::lock_guard lock(i->command_mutex);  // waits for the command that is being carried out
    i->no_more_commands = true;
  }
  i->server.run_there([i] {
    i->pump(i->server.hub());
    i->server.hub().advance(~std::uint64_t{0});  // what waited for its turn is the run's last
    i->ended = true;
    i->show_status(i->server.hub());
  });
}

LiveView::~LiveView() {
  Impl* i = impl_.get();
  i->server.end([i] {
    i->pump(i->server.hub());
    i->server.hub().advance(~std::uint64_t{0});
    i->ended = true;
    i->show_status(i->server.hub());
  });
  for (const auto& c : i->context.parts.channels)
    if (c->pair) c->pair->observe(nullptr);
}

void LiveView::attach(Recorder* recorder) {
  auto& channels = impl_->context.parts.channels;
  for (std::size_t i = 0; i < channels.size(); ++i)
    if (PairSource* pair = channels[i]->pair)
      pair->observe(
          impl_->tap.observer(i, recorder ? recorder->observer(channels[i]->recorder_id) : nullptr));
}

LiveTap& LiveView::tap() { return impl_->tap; }

}  // namespace rigor::live
