#include "sim/world/store/tables.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <set>

#include "sim/world/store/value_codec.h"

namespace rigor::world::store {
namespace {

constexpr const char* kTables = R"sql(
CREATE TABLE meta(key TEXT PRIMARY KEY, value) WITHOUT ROWID;
CREATE TABLE types(id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, base INTEGER REFERENCES types(id),
  abstract INTEGER NOT NULL, place_attribute TEXT NOT NULL, meaning TEXT NOT NULL, table_name TEXT UNIQUE);
CREATE TABLE attributes(id INTEGER PRIMARY KEY, type INTEGER NOT NULL REFERENCES types(id), name TEXT NOT NULL,
  kind TEXT NOT NULL, unit TEXT NOT NULL, meaning TEXT NOT NULL, transient INTEGER NOT NULL,
  min REAL NOT NULL, max REAL NOT NULL, nan_is_unknown INTEGER NOT NULL, default_value, UNIQUE(type, name));
CREATE TABLE attribute_choices(attribute INTEGER NOT NULL REFERENCES attributes(id), position INTEGER NOT NULL,
  word TEXT NOT NULL, PRIMARY KEY(attribute, position)) WITHOUT ROWID;
CREATE TABLE edge_types(id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, from_type TEXT NOT NULL,
  to_type TEXT NOT NULL, targets_per_source TEXT NOT NULL, sources_per_target TEXT NOT NULL,
  acyclic INTEGER NOT NULL, removes_sources INTEGER NOT NULL, meaning TEXT NOT NULL);
CREATE TABLE nodes(id INTEGER PRIMARY KEY, type INTEGER NOT NULL REFERENCES types(id));
CREATE TABLE edges(source INTEGER NOT NULL, type INTEGER NOT NULL REFERENCES edge_types(id),
  position INTEGER NOT NULL, target INTEGER NOT NULL, PRIMARY KEY(source, type, position)) WITHOUT ROWID;
CREATE INDEX edges_by_target ON edges(target, type);
CREATE TABLE dynamic_attributes(node INTEGER NOT NULL, name TEXT NOT NULL, kind TEXT NOT NULL, value,
  PRIMARY KEY(node, name));
)sql";

constexpr const char* kLayout =
    "number: REAL, NULL is NaN, a BLOB of 8 bytes is -0.0; vector3: NAME.x .y .z; pose: the rows of [R t], "
    "NAME.r11 .r12 .r13 .x .r21 … .z; numbers: BLOB of little-endian float64; blob: BLOB. In default_value "
    "and "
    "dynamic_attributes vector3 and pose are BLOBs of little-endian float64.";

constexpr std::array<const char*, 9> kOwnTables = {
    "meta",  "types", "attributes",      "attribute_choices", "edge_types",
    "nodes", "edges", "edges_by_target", "dynamic_attributes"};

std::string lower(std::string s) {
  for (auto& c : s)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c + 32);
  return s;
}

/// The type's name where SQLite, which does not tell capitals from small letters, can have it.
std::string free_table_name(const std::string& type, std::int64_t number, std::set<std::string>& taken) {
  const auto name = lower(type);
  if (!name.starts_with("sqlite_") && taken.insert(name).second) return type;
  const auto other = fmt::format("type_{}_{}", number, name.starts_with("sqlite_") ? "" : type);
  taken.insert(lower(other));
  return other;
}

const char* word(Cardinality c) { return c == Cardinality::one ? "one" : "many"; }

// ---------------------------------------------------------------- migrations

/// Version 1 kept no order among a node's targets, gave ids of removed nodes again, and had no names of its
/// own for tables.
void from_1_to_2(Sqlite& db) {
  db.run(R"sql(
ALTER TABLE types ADD COLUMN table_name TEXT;
UPDATE types SET table_name = name WHERE abstract = 0;
CREATE UNIQUE INDEX types_by_table ON types(table_name);
ALTER TABLE edges RENAME TO edges_1;
CREATE TABLE edges(source INTEGER NOT NULL, type INTEGER NOT NULL REFERENCES edge_types(id),
  position INTEGER NOT NULL, target INTEGER NOT NULL, PRIMARY KEY(source, type, position)) WITHOUT ROWID;
INSERT INTO edges SELECT source, type, row_number() OVER (PARTITION BY source, type ORDER BY rowid) - 1, target
  FROM edges_1;
DROP TABLE edges_1;
CREATE INDEX edges_by_target ON edges(target, type);
INSERT OR REPLACE INTO meta VALUES('next_node_id', (SELECT ifnull(max(id), 0) + 1 FROM nodes));
INSERT OR REPLACE INTO meta VALUES('generation', 1);
)sql");
  auto layout = db.prepare("INSERT OR REPLACE INTO meta VALUES('layout', ?)");
  layout.bind(0, std::string_view(kLayout)).run();
}

struct Migration {
  std::int64_t from;
  void (*step)(Sqlite&);
};
constexpr std::array<Migration, 1> kMigrations = {{{1, from_1_to_2}}};
static_assert(kMigrations.back().from + 1 == kFileVersion);

void write_version(Sqlite& db, std::int64_t version) {
  db.run(fmt::format("PRAGMA user_version = {0}; INSERT OR REPLACE INTO meta VALUES('schema_version', {0})",
                     version));
}

}  // namespace

void create_tables(Sqlite& db) {
  db.run(fmt::format("PRAGMA application_id = {}", kApplicationId));
  db.run(kTables);
  db.run("INSERT INTO meta VALUES('generation', 0), ('next_node_id', 1)");
  auto layout = db.prepare("INSERT INTO meta VALUES('layout', ?)");
  layout.bind(0, std::string_view(kLayout)).run();
  write_version(db, kFileVersion);
}

void check_is_world(Sqlite& db) {
  const auto application = db.integer("PRAGMA application_id");
  const auto version = db.integer("PRAGMA user_version");
  const auto tables = db.integer("SELECT count(*) FROM sqlite_schema");
  if (!db.ok()) return;
  if (application == 0 && tables == 0)
    return db.refuse(ErrorCode::bad_input,
                     "expected a Rigor world, got an empty file: nothing was ever written to it; remove it");
  if (application != kApplicationId)
    return db.refuse(ErrorCode::bad_input,
                     "expected a Rigor world, got an SQLite file of another program; give a file that Rigor "
                     "wrote");
  if (version > kFileVersion)
    return db.refuse(
        ErrorCode::bad_input,
        fmt::format("expected a world of version {} or older, got version {}, written by a newer "
                    "Rigor; open it with that one, or export it there as YAML and import it here",
                    kFileVersion, version));
  if (version < 1)
    return db.refuse(
        ErrorCode::bad_input,
        fmt::format("expected a world of version 1 to {}, got version {}; restore it from a copy",
                    kFileVersion, version));
  // SQLite fills up a last page of which a part is missing with zeros and says nothing.
  const auto page = db.integer("PRAGMA page_size");
  const std::string path = db.text("SELECT file FROM pragma_database_list WHERE name = 'main'");
  std::error_code ec;
  if (const auto size = path.empty() ? 0 : std::filesystem::file_size(path, ec);
      db.ok() && !ec && page > 0 && size % static_cast<std::uintmax_t>(page) != 0)
    return db.refuse(
        ErrorCode::bad_input,
        fmt::format("the world is damaged or cut short ({} bytes are no whole pages); restore it from a copy",
                    size));
  if (const auto found = db.text("PRAGMA quick_check(1)"); db.ok() && found != "ok")
    db.refuse(ErrorCode::bad_input, "the world is damaged (" + found + "); restore it from a copy");
}

void migrate(Sqlite& db) {
  const auto version = db.integer("PRAGMA user_version");
  for (const auto& m : kMigrations) {
    if (m.from < version) continue;
    m.step(db);
    write_version(db, m.from + 1);
  }
}

// ---------------------------------------------------------------- schema

std::vector<std::string> column_names(const std::string& attribute, ValueKind kind) {
  std::vector<std::string> out;
  for (const auto& c : columns_of(kind)) out.push_back(sql_name(attribute + std::string(c.suffix)));
  return out;
}

FileSchema read_schema(Sqlite& db) {
  FileSchema out;
  auto types = db.prepare(
      "SELECT t.id, t.name, b.name, t.abstract, t.place_attribute, t.meaning FROM types t "
      "LEFT JOIN types b ON b.id = t.base ORDER BY t.id");
  auto attributes = db.prepare(
      "SELECT id, name, kind, unit, meaning, transient, min, max, nan_is_unknown, default_value "
      "FROM attributes WHERE type = ? ORDER BY id");
  auto choices = db.prepare("SELECT word FROM attribute_choices WHERE attribute = ? ORDER BY position");
  while (types.step()) {
    TypeSpec t{.name = types.text(1),
               .base = types.text(2),
               .abstract = types.integer(3) != 0,
               .meaning = types.text(5),
               .place_attribute = types.text(4)};
    attributes.bind(0, types.integer(0));
    while (attributes.step()) {
      const auto kind = kind_named(attributes.text(2));
      auto value = kind ? read_cell(attributes, 9, *kind) : std::nullopt;
      if (!value) {
        db.refuse(
            ErrorCode::bad_input,
            fmt::format("table attributes: {}.{}: expected a default of a known kind, got the kind '{}' and "
                        "a value that does not fit it; restore the file from a copy",
                        t.name, attributes.text(1), attributes.text(2)));
        return out;
      }
      AttributeSpec a{.name = attributes.text(1),
                      .default_value = std::move(*value),
                      .unit = attributes.text(3),
                      .meaning = attributes.text(4),
                      .transient = attributes.integer(5) != 0,
                      .min = attributes.real(6),
                      .max = attributes.real(7),
                      .nan_is_unknown = attributes.integer(8) != 0};
      choices.bind(0, attributes.integer(0));
      while (choices.step()) a.choices.push_back(choices.text(0));
      choices.reset();
      t.attributes.push_back(std::move(a));
    }
    attributes.reset();
    out.types.push_back(std::move(t));
  }
  auto edges = db.prepare(
      "SELECT name, from_type, to_type, targets_per_source, sources_per_target, acyclic, removes_sources, "
      "meaning FROM edge_types ORDER BY id");
  while (edges.step())
    out.edges.push_back({.name = edges.text(0),
                         .from = edges.text(1),
                         .to = edges.text(2),
                         .targets_per_source = edges.text(3) == "one" ? Cardinality::one : Cardinality::many,
                         .sources_per_target = edges.text(4) == "one" ? Cardinality::one : Cardinality::many,
                         .acyclic = edges.integer(5) != 0,
                         .removes_sources = edges.integer(6) != 0,
                         .meaning = edges.text(7)});
  return out;
}

namespace {

/// Rows of types; gives the number of each in the file.
std::map<std::string, std::int64_t> write_types(Sqlite& db, const Schema& schema) {
  std::map<std::string, std::int64_t> numbers;
  std::set<std::string> taken(kOwnTables.begin(), kOwnTables.end());
  std::int64_t next = 1;
  auto read = db.prepare("SELECT id, name, table_name FROM types");
  while (read.step()) {
    numbers[read.text(1)] = read.integer(0);
    taken.insert(lower(read.text(2)));
    next = std::max(next, read.integer(0) + 1);
  }
  auto write = db.prepare("INSERT INTO types VALUES(?, ?, ?, ?, ?, ?, ?)");
  for (std::uint32_t i = 0; i < schema.type_count() && db.ok(); ++i) {
    const auto& t = schema.type(TypeId{i});
    if (numbers.contains(t.name)) continue;
    const auto number = next++;
    write.bind(0, number).bind(1, t.name).bind(3, std::int64_t{t.abstract}).bind(4, t.place_attribute);
    write.bind(5, t.meaning);
    if (i == 0)
      write.bind_null(2);
    else
      write.bind(2, numbers.at(t.base));
    if (t.abstract) {
      write.bind_null(6).run();
    } else {
      const auto table = free_table_name(t.name, number, taken);
      write.bind(6, table).run();
      db.run("CREATE TABLE " + sql_name(table) + "(id INTEGER PRIMARY KEY)");
    }
    numbers[t.name] = number;
  }
  return numbers;
}

void write_attribute(Sqlite& db, std::int64_t number, std::int64_t type, const AttributeSpec& a) {
  auto write = db.prepare("INSERT INTO attributes VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)");
  std::vector<double> scratch;
  write.bind(0, number).bind(1, type).bind(2, a.name).bind(3, name_of(kind_of(a.default_value)));
  write.bind(4, a.unit).bind(5, a.meaning).bind(6, std::int64_t{a.transient});
  write.bind_number(7, a.min).bind_number(8, a.max).bind(9, std::int64_t{a.nan_is_unknown});
  bind_cell(write, 10, a.default_value, scratch);
  write.run();
  auto choice = db.prepare("INSERT INTO attribute_choices VALUES(?, ?, ?)");
  for (std::size_t i = 0; i < a.choices.size(); ++i)
    choice.bind(0, number).bind(1, static_cast<std::int64_t>(i)).bind(2, a.choices[i]).run();
}

void write_attributes(Sqlite& db, const Schema& schema, const std::map<std::string, std::int64_t>& types) {
  std::set<std::pair<std::int64_t, std::string>> known;
  std::int64_t next = 1;
  auto read = db.prepare("SELECT id, type, name FROM attributes");
  while (read.step()) {
    known.emplace(read.integer(1), read.text(2));
    next = std::max(next, read.integer(0) + 1);
  }
  for (std::uint32_t i = 0; i < schema.attribute_count() && db.ok(); ++i) {
    const auto& a = schema.attribute(AttributeId{i});
    const auto type = types.at(schema.type(a.owner).name);
    if (!known.contains({type, a.spec.name})) write_attribute(db, next++, type, a.spec);
  }
}

/// The columns that a type's table lacks, filled with defaults.
void write_columns(Sqlite& db, const Schema& schema, TypeId t, const std::string& table) {
  std::set<std::string> known;
  auto read = db.prepare("SELECT name FROM pragma_table_info(?)");
  read.bind(0, table);
  while (read.step()) known.insert(sql_name(read.text(0)));
  const bool has_rows = db.integer("SELECT EXISTS(SELECT 1 FROM " + sql_name(table) + ")") != 0;
  for (const auto id : schema.attributes(t)) {
    const auto& a = schema.attribute(id).spec;
    const auto kind = schema.attribute(id).kind();
    const auto names = column_names(a.name, kind);
    if (a.transient || known.contains(names.front())) continue;
    std::string set;
    for (std::size_t c = 0; c < names.size(); ++c) {
      db.run("ALTER TABLE " + sql_name(table) + " ADD COLUMN " + names[c] + " " +
             std::string(columns_of(kind)[c].declared));
      set += (c ? ", " : "") + names[c] + " = ?";
    }
    if (!has_rows) continue;
    auto fill = db.prepare("UPDATE " + sql_name(table) + " SET " + set);
    bind_columns(fill, 0, a.default_value);
    fill.run();
  }
}

void write_edge_types(Sqlite& db, const Schema& schema) {
  auto write = db.prepare(
      "INSERT INTO edge_types(name, from_type, to_type, targets_per_source, sources_per_target, acyclic, "
      "removes_sources, meaning) VALUES(?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT(name) DO NOTHING");
  for (std::uint32_t i = 0; i < schema.edge_type_count(); ++i) {
    const auto& e = schema.edge(EdgeTypeId{i});
    write.bind(0, e.name).bind(1, e.from).bind(2, e.to);
    write.bind(3, std::string_view(word(e.targets_per_source)));
    write.bind(4, std::string_view(word(e.sources_per_target)));
    write.bind(5, std::int64_t{e.acyclic}).bind(6, std::int64_t{e.removes_sources}).bind(7, e.meaning).run();
  }
}

}  // namespace

void write_schema(Sqlite& db, const Schema& schema) {
  const auto types = write_types(db, schema);
  write_attributes(db, schema, types);
  auto table = db.prepare("SELECT table_name FROM types WHERE name = ?");
  for (std::uint32_t i = 0; i < schema.type_count() && db.ok(); ++i) {
    if (schema.type(TypeId{i}).abstract) continue;
    table.bind(0, schema.type(TypeId{i}).name);
    if (table.step()) {
      const auto name = table.text(0);
      table.reset();
      write_columns(db, schema, TypeId{i}, name);
    }
    table.reset();
  }
  write_edge_types(db, schema);
}

FileNumbers read_numbers(Sqlite& db, const Schema& schema) {
  FileNumbers out;
  auto type = db.prepare("SELECT id, ifnull(table_name, '') FROM types WHERE name = ?");
  for (std::uint32_t i = 0; i < schema.type_count(); ++i) {
    FileNumbers::Type t;
    type.bind(0, schema.type(TypeId{i}).name);
    if (type.step()) t.number = type.integer(0), t.table = type.text(1);
    type.reset();
    for (const auto a : schema.attributes(TypeId{i}))
      if (const auto& info = schema.attribute(a); !info.spec.transient)
        t.attributes.push_back({a, info.kind(), info.spec.name});
    out.types.push_back(std::move(t));
  }
  auto edge = db.prepare("SELECT id FROM edge_types WHERE name = ?");
  for (std::uint32_t i = 0; i < schema.edge_type_count(); ++i) {
    edge.bind(0, schema.edge(EdgeTypeId{i}).name);
    out.edges.push_back(edge.step() ? edge.integer(0) : 0);
    edge.reset();
  }
  return out;
}

}  // namespace rigor::world::store
