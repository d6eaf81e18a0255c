#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "cli/terminal.h"
#include "cli/world/world_assembly.h"
#include "cli/world/world_commands.h"
#include "sim/nature/trees/stem_shape.h"
#include "sim/world/semantic_types.h"
#include "sim/world/store/world_file.h"

namespace rigor {
namespace {

/// The stems as a map for those who find their way by them (docs/forest-localization.md).
Status export_stem_map(const world::Snapshot& world, const std::filesystem::path& file,
                       std::optional<double> height_m, std::size_t& count) {
  const world::types::Tree tree(world.schema());
  std::vector<world::NodeId> nodes = world.nodes(tree.type);
  std::sort(nodes.begin(), nodes.end());
  std::string text = "x_m,y_m,diameter_m,fell\n";
  count = 0;
  for (const world::NodeId node : nodes) {
    const world::Vector3& at = world.get_or_default(node, tree.position);
    nature::StemSection stem{at.x(), at.y(), world.get_or_default(node, tree.dbh_m)};
    if (!std::isfinite(at.x() + at.y()) || !(stem.diameter_m > 0)) continue;
    if (height_m) {
      const auto section = nature::stem_section(world, tree, node, *height_m);
      if (!section) continue;
      stem = *section;
    }
    text += fmt::format("{:.3f},{:.3f},{:.4g},{}\n", stem.x_m, stem.y_m, stem.diameter_m,
                        world.get_or_default(node, tree.marked));
    ++count;
  }
  std::ofstream out(file, std::ios::binary);
  out << text;
  out.close();
  if (!out) return fail(ErrorCode::not_writable, file.string(), "expected to write the stem map");
  return {};
}

}  // namespace

int world_export_command(const WorldExportOptions& options) {
  namespace fs = std::filesystem;
  std::error_code ec;
  const bool stems = options.output.extension() == ".csv";
  if (auto s = check_output(options.output, stems ? ".csv" : ".yaml", options.force); !s)
    return report_error(s.error(), options.json);
  const auto opened = open_world(options.world);
  if (!opened) return report_error(opened.error(), options.json);
  fs::path part = options.output;
  part += fmt::format(".{}.part", ::getpid());
  const world::Snapshot snapshot = opened->db->snapshot();
  std::size_t nodes = snapshot.node_count();
  if (auto s = stems ? export_stem_map(snapshot, part, options.at_height_m, nodes)
                     : world::export_world_yaml(snapshot, part);
      !s) {
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
  if (options.json)
    fmt::print("{}\n",
               nlohmann::json{
                   {"world", options.output.string()}, {stems ? "stems" : "nodes", nodes}, {"bytes", bytes}}
                   .dump(2, ' ', false, nlohmann::json::error_handler_t::replace));
  else
    fmt::print("{}: {} {}, {:.1f} MB\n", options.output.string(), nodes, stems ? "stems" : "nodes",
               static_cast<double>(bytes) / 1e6);
  return 0;
}

}  // namespace rigor
