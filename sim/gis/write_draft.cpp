#include "sim/gis/write_draft.h"

#include <map>

namespace rigor::gis {

Status write_draft(world::Database& db, const std::vector<DraftNode>& nodes, const std::string& label) {
  const world::Schema& schema = db.schema();
  struct Known {
    world::TypeId type;
    std::map<std::string, world::AttributeId, std::less<>> attributes;
  };
  std::map<std::string, Known, std::less<>> known;
  world::Transaction tx = db.begin(label);
  for (const DraftNode& node : nodes) {
    auto it = known.find(node.type);
    if (it == known.end()) {
      Known k{schema.require_type(node.type), {}};
      for (const auto a : schema.attributes(k.type)) k.attributes.emplace(schema.attribute(a).spec.name, a);
      it = known.emplace(node.type, std::move(k)).first;
    }
    auto id = tx.create(it->second.type);
    if (!id) return tl::unexpected(id.error());
    for (const auto& [name, value] : node.attributes)
      if (auto s = tx.set(*id, it->second.attributes.at(name), value); !s) {
        Error e = s.error();
        e.message = node.type + "." + name + ": " + e.message;
        return tl::unexpected(e);  // the transaction rolls back as it ends
      }
  }
  return tx.commit();
}

}  // namespace rigor::gis
