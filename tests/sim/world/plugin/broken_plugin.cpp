// Plugins with one thing wrong each: BROKEN_… says which.
#include <cstdlib>
#include <stdexcept>

#include "sim/world/plugin/plugin.h"

namespace {

using namespace rigor;
using namespace rigor::world;

/// Leaves a trace where any code of this object runs.
[[maybe_unused]] const int kTrace = ::setenv("RIGOR_TEST_PLUGIN_RAN", "yes", 1);

[[maybe_unused]] Status define(PluginHost& host) {
  const auto type = host.define(
      TypeSpec{.name = "Left",
               .attributes = {{.name = "x", .default_value = 1.0}, {.name = "y", .default_value = 1.0}}});
  if (!type) return tl::unexpected(type.error());
  (void)host.add_importer(
      {.name = "left", .suffixes = {".left"}, .run = [](const auto&, Transaction&) -> Status { return {}; }});
#if defined(BROKEN_THROWS)
  throw std::runtime_error("out of bees");
#elif defined(BROKEN_THROWS_A_NUMBER)
  throw 42;
#elif defined(BROKEN_FAILS)
  return fail(ErrorCode::unavailable, "", "no licence for bees");
#elif defined(BROKEN_HIDES_AN_ERROR)
  (void)host.define(TypeSpec{.name = "not a name"});
  return {};
#elif defined(BROKEN_RULES)
  const auto x = host.schema().require<double>("Left", "x"), y = host.schema().require<double>("Left", "y");
  const auto idle = [](Transaction&, std::span<const Change>) -> Status { return {}; };
  (void)host.add_rule({.name = "x_to_y", .when = {.attribute = x.id}, .writes = {y.id}, .run = idle});
  (void)host.add_rule({.name = "y_to_x", .when = {.attribute = y.id}, .writes = {x.id}, .run = idle});
  return {};
#elif defined(GOOD)
  return host.add_rule({.name = "left.throws_at_seven",
                        .when = {.type = *type},
                        .run = [x = host.schema().require<double>("Left", "x")](
                                   Transaction& tx, std::span<const Change> mine) -> Status {
                          for (const auto& c : mine)
                            if (const auto* v = tx.get(c.node, x); v && *v == 7)
                              throw std::runtime_error("seven");
                          return {};
                        }});
#else
  return {};
#endif
}

}  // namespace

#if defined(BROKEN_ABI)
extern "C" {
extern const PluginEntry<PluginHost> rigor_world_plugin;
const PluginEntry<PluginHost> rigor_world_plugin = {
    "rigor world plugin", "headers 0000000000000000; compiler 4.9", "broken", "1", "", define};
}
#elif defined(BROKEN_ENTRY)
extern "C" {
extern const char rigor_world_plugin[1000];
const char rigor_world_plugin[1000] = "something else";
}
#elif defined(BROKEN_NO_FUNCTION)
RIGOR_WORLD_PLUGIN("broken", "1", "", nullptr)
#elif !defined(BROKEN_NO_ENTRY)
RIGOR_WORLD_PLUGIN("broken", "1", "Has one thing wrong.", define)
#endif
