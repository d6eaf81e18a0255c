#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/world/world_assembly.h"
#include "cli/world/world_commands.h"
#include "sim/nature/trees/stem_shape.h"
#include "sim/world/semantic_types.h"
#include "sim/world/store/world_file.h"

namespace rigor {
namespace {

/// The stems as a map for those who find their way by them (docs/forest-localization.md).
std::string stem_map(const world::Snapshot& world, std::optional<double> height_m, std::size_t& count) {
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
  return text;
}

}  // namespace

int world_export_command(const WorldExportOptions& options) {
  std::error_code ec;
  const bool stems = options.output.extension() == ".csv";
  InputFiles inputs;
  inputs.add("the world", options.world);
  if (auto s = check_output(options.output, stems ? ".csv" : ".yaml", std::move(inputs), options.force); !s)
    return report_error(s.error(), options.json);
  const auto opened = open_world(options.world);
  if (!opened) return report_error(opened.error(), options.json);
  const world::Snapshot snapshot = opened->db->snapshot();
  std::size_t nodes = snapshot.node_count();
  const std::string text =
      stems ? stem_map(snapshot, options.at_height_m, nodes) : world::world_yaml(snapshot);
  if (auto s = write_output(options.output, text); !s) return report_error(s.error(), options.json);
  const auto bytes = std::filesystem::file_size(options.output, ec);
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
