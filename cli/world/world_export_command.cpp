#include <fmt/format.h>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "cli/terminal.h"
#include "cli/world/world_assembly.h"
#include "cli/world/world_commands.h"
#include "sim/world/store/world_file.h"

namespace rigor {

int world_export_command(const WorldExportOptions& options) {
  namespace fs = std::filesystem;
  std::error_code ec;
  if (auto s = check_output(options.output, ".yaml", options.force); !s)
    return report_error(s.error(), options.json);
  const auto opened = open_world(options.world);
  if (!opened) return report_error(opened.error(), options.json);
  fs::path part = options.output;
  part += fmt::format(".{}.part", ::getpid());
  if (auto s = world::export_world_yaml(opened->db->snapshot(), part); !s) {
    fs::remove(part, ec);
    return report_error(s.error(), options.json);
  }
  fs::rename(part, options.output, ec);
  if (ec) {
    const std::string why = ec.message();
    fs::remove(part, ec);
    return report_error(
        {ErrorCode::not_writable, options.output.string(), "expected to write the world, got: " + why},
        options.json);
  }
  const auto bytes = fs::file_size(options.output, ec);
  const auto nodes = opened->db->snapshot().node_count();
  if (options.json)
    fmt::print("{}\n",
               nlohmann::json{{"world", options.output.string()}, {"nodes", nodes}, {"bytes", bytes}}.dump(
                   2, ' ', false, nlohmann::json::error_handler_t::replace));
  else
    fmt::print("{}: {} nodes, {:.1f} MB\n", options.output.string(), nodes, static_cast<double>(bytes) / 1e6);
  return 0;
}

}  // namespace rigor
