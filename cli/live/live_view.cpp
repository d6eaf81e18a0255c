#include "cli/live/live_view.h"

#include <nlohmann/json.hpp>

#include "cli/live/channels.h"
#include "cli/live/parameters.h"
#include "cli/live/status.h"
#include "cli/live/world.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/record/recorder.h"

namespace rigor::live {
namespace {

using nlohmann::json;

constexpr Duration kStatusPeriod = milliseconds(200);

Bytes text_bytes(const json& j) {
  return std::make_shared<const std::string>(j.dump(-1, ' ', false, json::error_handler_t::replace));
}

}  // namespace

struct LiveView::Impl {
  Impl(Server& s, const Context& c)
      : server(s),
        context(c),
        tap(stream_specs(c.parts), c.parts.rig.clock == ClockKind::virtual_time),
        channels(c.parts, c.epoch),
        status(c.parts, c.counters, c.commands, tap, c.epoch, c.replay) {
    if (c.simulation) world.emplace(*c.simulation, c.parts, tap);
  }

  void offer(Hub& hub) {
    channels.add_to(hub);
    status_id = hub.add_channel({0, "/rigor/live", "json", "rigor.Live", "jsonschema", LiveStatus::schema()});
    const std::string object = R"({"type":"object"})";
    hub.add_service({0, "rigor/control", object, object},
                    [this](const std::string& request) { return context.commands.answer(request); });
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
  void show_status(Hub& hub, bool ended) {
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
  std::optional<LiveWorld> world;
  std::uint32_t status_id = 0, world_id = 0;
  std::uint64_t world_subscribed = 0;
  std::string world_key;
};

LiveView::LiveView(Server& server, const Context& context) : impl_(std::make_unique<Impl>(server, context)) {
  Impl* i = impl_.get();
  server.run_there([i] { i->offer(i->server.hub()); });
  server.every(LiveChannels::kTick, [i] { i->channels.pump(i->server.hub(), i->tap); });
  server.every(kStatusPeriod, [i] {
    i->show_status(i->server.hub(), false);
    i->show_world(i->server.hub());
  });
}

LiveView::~LiveView() {
  Impl* i = impl_.get();
  i->server.end([i] {
    i->channels.pump(i->server.hub(), i->tap);
    i->show_status(i->server.hub(), true);
  });
  for (const auto& c : i->context.parts.channels)
    if (c->pair) c->pair->observe(nullptr);
}

void LiveView::attach(Recorder* recorder, BenchTime t0) {
  auto& channels = impl_->context.parts.channels;
  for (std::size_t i = 0; i < channels.size(); ++i)
    if (PairSource* pair = channels[i]->pair)
      pair->observe(
          impl_->tap.observer(i, recorder ? recorder->observer(channels[i]->recorder_id) : nullptr));
  impl_->tap.set_t0(t0);
}

LiveTap& LiveView::tap() { return impl_->tap; }

}  // namespace rigor::live
