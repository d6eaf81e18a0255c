// What a plugin wants of a database, collected and tried before any of it is done.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sim/world/plugin/plugin.h"

namespace rigor::world {

/// Works on a database of its own that has the same schema and the same rules, so that every number that it
/// hands out is the one that the real database will give.
struct PluginHost::Impl {
 public:
  Impl(Database& db, const std::vector<Importer>& importers, std::string plugin);

  [[nodiscard]] const Schema& schema() const noexcept { return trial_->schema(); }
  Result<TypeId> define(const TypeSpec& spec);
  Result<EdgeTypeId> define(const EdgeSpec& spec);
  Result<AttributeId> add_attribute(TypeId type, const AttributeSpec& spec);
  Status add_rule(Rule rule);
  Status add_importer(Importer importer);

  /// To the real database.
  [[nodiscard]] Status apply();
  [[nodiscard]] const std::optional<Error>& first_error() const noexcept { return error_; }
  [[nodiscard]] const std::vector<std::string>& types() const noexcept { return types_; }
  [[nodiscard]] const std::vector<std::string>& edges() const noexcept { return edges_; }
  [[nodiscard]] const std::vector<std::string>& rules() const noexcept { return rules_; }
  [[nodiscard]] std::vector<Importer>& new_importers() noexcept { return new_importers_; }

 private:
  /// Keeps the first error.
  tl::unexpected<Error> refuse(Error e);

  Database& db_;
  const std::vector<Importer>& importers_;
  std::string plugin_;
  std::unique_ptr<Database> trial_;
  std::vector<std::function<Status(Database&)>> steps_;
  std::vector<std::string> types_, edges_, rules_;
  std::vector<Importer> new_importers_;
  std::optional<Error> error_;
};

}  // namespace rigor::world
