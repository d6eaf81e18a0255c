#include "cli/open_live.h"

#include <fmt/format.h>

#include <cstdlib>

#include "bench/console/terminal.h"
#include "rt-core/affinity.h"

namespace rigor {

Result<std::unique_ptr<live::Server>> open_live(const LiveOptions& options, const RigConfig& rig) {
  const auto refuse = [](const char* where, const char* why) {
    return fail(ErrorCode::bad_input, where, why);
  };
  if (options.pace.value_or(0) > 0 && rig.clock == ClockKind::wall)
    return refuse("--pace",
                  "expected a run in virtual time, got one in wall-clock time, which has its own pace");
  if (!options.on) {
    if (!options.token.empty()) return refuse("--live-token", "expected --live with it");
    if (options.open) return refuse("--live-open", "expected --live with it");
    if (!options.page.empty()) return refuse("--live-page", "expected --live with it");
    if (options.ends) return refuse("--live-end", "expected --live with it");
    return std::unique_ptr<live::Server>();
  }
  if (options.open && !options.token.empty())
    return refuse("--live-open", "expected --live-open or --live-token, got both");
  live::ServerOptions server;
  auto endpoint = live::parse_endpoint(options.endpoint);
  if (!endpoint) return tl::unexpected<Error>(endpoint.error());
  server.endpoint = *endpoint;
  server.token = options.token;
  if (const char* token = std::getenv("RIGOR_LIVE_TOKEN"); token && server.token.empty() && !options.open)
    server.token = token;
  if (server.token.empty() && !options.open) {
    auto made = live::make_token();
    if (!made) return tl::unexpected<Error>(made.error());
    server.token = *made;
    server.token_in_url = true;  // nobody else knows it
  }
  server.page_dir = options.page;
  RealtimeConfig loop;
  loop.cpu = rig.loop.cpu < 0 ? RealtimeConfig::kAutoCpu : rig.loop.cpu;
  const AvoidCpu rest(rig.clock == ClockKind::virtual_time ? -1 : loop_cpu(loop));
  auto opened = live::Server::open(server, rig.name);
  if (opened) write_stderr(fmt::format("live      {}\n", (*opened)->url()));
  return opened;
}

}  // namespace rigor
