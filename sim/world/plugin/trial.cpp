#include "sim/world/plugin/trial.h"

#include <algorithm>
#include <exception>
#include <utility>

#include "sim/world/graph/database_state.h"

namespace rigor::world {
namespace {

bool same(const AttributeSpec& a, const AttributeSpec& b) {
  return a.name == b.name && same_value(a.default_value, b.default_value) && a.unit == b.unit &&
         a.transient == b.transient && a.min == b.min && a.max == b.max &&
         a.nan_is_unknown == b.nan_is_unknown && a.choices == b.choices;
}

bool same(const Schema& schema, TypeId t, const TypeSpec& spec) {
  const auto& known = schema.type(t);
  std::vector<AttributeSpec> own;
  for (const auto a : schema.attributes(t))
    if (schema.attribute(a).owner == t) own.push_back(schema.attribute(a).spec);
  return known.base == spec.base && known.abstract == spec.abstract &&
         known.place_attribute == spec.place_attribute &&
         std::equal(own.begin(), own.end(), spec.attributes.begin(), spec.attributes.end(),
                    [](const auto& a, const auto& b) { return same(a, b); });
}

bool same(const EdgeSpec& a, const EdgeSpec& b) {
  return a.from == b.from && a.to == b.to && a.targets_per_source == b.targets_per_source &&
         a.sources_per_target == b.sources_per_target && a.acyclic == b.acyclic &&
         a.removes_sources == b.removes_sources;
}

Status moved(const std::string& what) {
  return fail(ErrorCode::internal, what, "the database gave another number than the trial; report this");
}

}  // namespace

PluginHost::Impl::Impl(Database& db, const std::vector<Importer>& importers, std::string plugin)
    : db_(db), importers_(importers), plugin_(std::move(plugin)), trial_(Database::create()) {
  trial_->state().schema = db.schema();
  trial_->state().schema_grew();
  for (const auto& rule : db.state().rules)
    if (auto s = trial_->add_rule(rule); !s) (void)refuse(s.error());
}

tl::unexpected<Error> PluginHost::Impl::refuse(Error e) {
  if (!error_) error_ = e;
  return tl::unexpected<Error>(std::move(e));
}

Result<TypeId> PluginHost::Impl::define(const TypeSpec& spec) {
  if (const auto t = schema().find_type(spec.name); t && same(schema(), *t, spec)) return *t;
  auto made = trial_->define(spec);
  if (!made) return refuse(made.error());
  types_.push_back(spec.name);
  steps_.emplace_back([spec, id = *made](Database& db) -> Status {
    auto t = db.define(spec);
    if (!t) return tl::unexpected<Error>(t.error());
    return *t == id ? Status{} : moved(spec.name);
  });
  return made;
}

Result<EdgeTypeId> PluginHost::Impl::define(const EdgeSpec& spec) {
  if (const auto e = schema().find_edge(spec.name); e && same(schema().edge(*e), spec)) return *e;
  auto made = trial_->define(spec);
  if (!made) return refuse(made.error());
  edges_.push_back(spec.name);
  steps_.emplace_back([spec, id = *made](Database& db) -> Status {
    auto e = db.define(spec);
    if (!e) return tl::unexpected<Error>(e.error());
    return *e == id ? Status{} : moved(spec.name);
  });
  return made;
}

Result<AttributeId> PluginHost::Impl::add_attribute(TypeId type, const AttributeSpec& spec) {
  if (type.value >= schema().type_count())
    return refuse({ErrorCode::bad_input, spec.name, "expected a type of this world, got an unknown number"});
  if (const auto a = schema().find_attribute(type, spec.name); a && same(schema().attribute(*a).spec, spec))
    return *a;
  auto made = trial_->add_attribute(type, spec);
  if (!made) return refuse(made.error());
  steps_.emplace_back([type, spec, id = *made](Database& db) -> Status {
    auto a = db.add_attribute(type, spec);
    if (!a) return tl::unexpected<Error>(a.error());
    return *a == id ? Status{} : moved(spec.name);
  });
  return made;
}

Status PluginHost::Impl::add_rule(Rule rule) {
  if (!rule.run)
    return refuse({ErrorCode::bad_input, rule.name, "expected a rule with a function, got none"});
  rule.run = [run = std::move(rule.run)](Transaction& tx, std::span<const Change> mine) -> Status {
    try {
      return run(tx, mine);
    } catch (const std::exception& e) {
      return fail(ErrorCode::bad_input, "", std::string("the rule threw an exception: ") + e.what());
    } catch (...) {
      return fail(ErrorCode::bad_input, "", "the rule threw an exception of an unknown type");
    }
  };
  if (auto s = trial_->add_rule(rule); !s) return refuse(s.error());
  rules_.push_back(rule.name);
  steps_.emplace_back([rule = std::move(rule)](Database& db) { return db.add_rule(rule); });
  return {};
}

Status PluginHost::Impl::add_importer(Importer importer) {
  const auto same_name = [&](const Importer& i) { return i.name == importer.name; };
  const std::string where = "importer " + importer.name;
  if (importer.name.empty() || !importer.run)
    return refuse({ErrorCode::bad_input, where, "expected an importer with a name and a function"});
  if (std::any_of(importers_.begin(), importers_.end(), same_name) ||
      std::any_of(new_importers_.begin(), new_importers_.end(), same_name))
    return refuse({ErrorCode::bad_input, where, "expected each importer once, got this name again"});
  for (const auto& s : importer.suffixes)
    if (s.size() < 2 || s.front() != '.' ||
        s.find_first_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ/") != std::string::npos)
      return refuse(
          {ErrorCode::bad_input, where, "expected suffixes such as .csv in small letters, got '" + s + "'"});
  new_importers_.push_back(std::move(importer));
  return {};
}

Status PluginHost::Impl::apply() {
  for (const auto& step : steps_)
    if (auto s = step(db_); !s) return s;
  return {};
}

// ---------------------------------------------------------------- what the plugin sees

const Schema& PluginHost::schema() const noexcept { return impl_.schema(); }
Result<TypeId> PluginHost::define(const TypeSpec& spec) { return impl_.define(spec); }
Result<EdgeTypeId> PluginHost::define(const EdgeSpec& spec) { return impl_.define(spec); }
Result<AttributeId> PluginHost::add_attribute(TypeId type, const AttributeSpec& spec) {
  return impl_.add_attribute(type, spec);
}
Status PluginHost::add_rule(Rule rule) { return impl_.add_rule(std::move(rule)); }
Status PluginHost::add_importer(Importer importer) { return impl_.add_importer(std::move(importer)); }

}  // namespace rigor::world
