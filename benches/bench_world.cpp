// The world database against plain C++ structs in vectors and against SQLite in memory: the same operations
// on the same nodes in one run, each with its result checked beside its time.
//
//   bench_world [--nodes N,N,…] [--rounds R] [--json FILE]
//
// A node is an Item with eight attributes: a place, five numbers, an integer and a word, all of them set.
// Items stand evenly in a flat box, 0.04 to the square metre at every size, so that a radius query finds as
// many whatever the size. Medians over the rounds; every system does each operation in turn within a round.
//
//   create           N nodes with all attributes, one transaction; time of one node
//   set, one big     a number of a random node, within one transaction of kSets, its commit and its signals
//   in
//                    it; subscribers 0, 1, 10; time of one
//   set, its own     the same, each in a transaction of its own; the subscriber has heard when it returns
//   scan             the sum of one number over all nodes; time of one node
//   radius           the nodes within 20 m of a random place (some 50)
//   1000 changes     one transaction that sets 1000 random nodes, with a reader that holds the world before
//   snapshot         after 10 changes: the commit and the snapshot, with all earlier ones of the round held;
//                    plain: a copy of the vector; SQLite: sqlite3_backup into another memory database
#include <sqlite3.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <vector>

#include "rt-core/time.h"
#include "sim/world/graph/database.h"

namespace {

using namespace rigor;
using namespace rigor::world;

constexpr std::size_t kSets = 100'000, kOwnSets = 20'000, kQueries = 200, kChanges = 1000, kSnapshots = 20;
constexpr double kRadius_m = 20;
constexpr int kNumbers = 5;

[[noreturn]] void give_up(const std::string& what) {
  std::fprintf(stderr, "bench_world: %s\n", what.c_str());
  std::exit(1);
}
template <class T>
T must(Result<T> r) {
  if (!r) give_up(r.error().text());
  return std::move(*r);
}
void must(const Status& s) {
  if (!s) give_up(s.error().text());
}

struct Item {
  Vector3 position;
  double v[kNumbers];
  std::int64_t kind;
  std::string word;
};

std::vector<Item> make_items(std::size_t n) {
  std::vector<Item> items(n);
  std::mt19937_64 random(n);
  const double side_m = std::sqrt(static_cast<double>(n) / 0.04);
  std::uniform_real_distribution<double> along(0, side_m), up(0, 3);
  for (std::size_t i = 0; i < n; ++i) {
    Item& item = items[i];
    item.position = {along(random), along(random), up(random)};
    for (double& v : item.v) v = static_cast<double>(random() % 1000 + 1);
    item.kind = static_cast<std::int64_t>(random() % 7 + 1);
    item.word = "word" + std::to_string(i % 97);
  }
  return items;
}

/// What all three can do. Nodes are told by their index; values are whole numbers, so that sums are exact.
class System {
 public:
  virtual ~System() = default;
  virtual void create(const std::vector<Item>& items) = 0;
  virtual void subscribers(int n) = 0;
  virtual void set_in_one(std::span<const std::uint32_t> nodes, double base) = 0;
  virtual void set_each(std::span<const std::uint32_t> nodes, double base) = 0;
  virtual double scan() = 0;
  virtual std::size_t radius(const Vector3& centre) = 0;
  virtual void hold() {}
  virtual void let_go() {}
  /// Ten changes that are seen, and a view of the world that stays; the sum of the numbers that changed.
  virtual void snapshot(std::span<const std::uint32_t> nodes, double base) = 0;
  std::uint64_t heard = 0;  ///< by all subscribers together
};

// ---------------------------------------------------------------- rigor

class Rigor final : public System {
 public:
  Rigor() {
    std::vector<AttributeSpec> attributes = {{.name = "position", .default_value = Vector3(0, 0, 0)}};
    for (int i = 0; i < kNumbers; ++i)
      attributes.push_back({.name = "v" + std::to_string(i), .default_value = 0.0});
    attributes.push_back({.name = "kind", .default_value = std::int64_t{0}});
    attributes.push_back({.name = "word", .default_value = std::string()});
    type_ =
        must(db_->define(TypeSpec{.name = "Item", .attributes = attributes, .place_attribute = "position"}));
    const Schema& s = db_->schema();
    position_ = s.require<Vector3>("Item", "position");
    for (int i = 0; i < kNumbers; ++i) v_[i] = s.require<double>("Item", "v" + std::to_string(i));
    kind_ = s.require<std::int64_t>("Item", "kind");
    word_ = s.require<std::string>("Item", "word");
  }
  void create(const std::vector<Item>& items) override {
    Transaction tx = db_->begin("create");
    for (const Item& item : items) {
      const NodeId n = must(tx.create(type_));
      must(tx.set(n, position_, item.position));
      for (int i = 0; i < kNumbers; ++i) must(tx.set(n, v_[i], item.v[i]));
      must(tx.set(n, kind_, item.kind));
      must(tx.set(n, word_, item.word));
    }
    must(tx.commit());
  }
  void subscribers(int n) override {
    watches_.clear();
    for (int i = 0; i < n; ++i)
      watches_.push_back(
          db_->subscribe({.type = type_, .attribute = v_[0].id},
                         [this](const ChangeSet&, std::span<const Change> mine) { heard += mine.size(); }));
  }
  void set_in_one(std::span<const std::uint32_t> nodes, double base) override {
    Transaction tx = db_->begin();
    for (std::size_t i = 0; i < nodes.size(); ++i)
      must(tx.set(NodeId{nodes[i] + 1}, v_[0], base + static_cast<double>(i)));
    must(tx.commit());
  }
  void set_each(std::span<const std::uint32_t> nodes, double base) override {
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      Transaction tx = db_->begin();
      must(tx.set(NodeId{nodes[i] + 1}, v_[0], base + static_cast<double>(i)));
      must(tx.commit());
    }
  }
  double scan() override {
    double sum = 0;
    db_->snapshot().scan(type_, v_[0], [&](std::span<const NodeId>, std::span<const double> v) {
      for (const double x : v) sum += x;
    });
    return sum;
  }
  std::size_t radius(const Vector3& centre) override {
    return db_->snapshot().in_radius(type_, centre, kRadius_m).size();
  }
  void hold() override { held_.push_back(db_->snapshot()); }
  void let_go() override { held_.clear(); }
  void snapshot(std::span<const std::uint32_t> nodes, double base) override {
    set_in_one(nodes, base);
    hold();
  }
  Database& db() { return *db_; }

 private:
  std::unique_ptr<Database> db_ = Database::create();
  TypeId type_;
  Attribute<Vector3> position_;
  Attribute<double> v_[kNumbers];
  Attribute<std::int64_t> kind_;
  Attribute<std::string> word_;
  std::vector<Subscription> watches_;
  std::vector<Snapshot> held_;
};

// ---------------------------------------------------------------- plain structs

class Plain final : public System {
 public:
  void create(const std::vector<Item>& items) override {
    for (const Item& i : items) items_.push_back(i);
  }
  void subscribers(int n) override {
    calls_.assign(static_cast<std::size_t>(n), [this](std::uint32_t) { ++heard; });
  }
  void set_in_one(std::span<const std::uint32_t> nodes, double base) override {
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      items_[nodes[i]].v[0] = base + static_cast<double>(i);
      for (const auto& call : calls_) call(nodes[i]);
    }
  }
  void set_each(std::span<const std::uint32_t> nodes, double base) override { set_in_one(nodes, base); }
  double scan() override {
    double sum = 0;
    for (const Item& i : items_) sum += i.v[0];
    return sum;
  }
  std::size_t radius(const Vector3& centre) override {
    std::size_t n = 0;
    for (const Item& i : items_) n += (i.position - centre).norm() <= kRadius_m;
    return n;
  }
  void let_go() override { held_.clear(); }
  void snapshot(std::span<const std::uint32_t> nodes, double base) override {
    set_in_one(nodes, base);
    held_.clear();  // one copy at a time: a million strings each
    held_.push_back(items_);
  }

 private:
  std::vector<Item> items_;
  std::vector<std::function<void(std::uint32_t)>> calls_;
  std::vector<std::vector<Item>> held_;
};

// ---------------------------------------------------------------- SQLite

class Sqlite final : public System {
 public:
  Sqlite() {
    if (sqlite3_open(":memory:", &db_) != SQLITE_OK) give_up("SQLite does not open");
    run("CREATE TABLE item(id INTEGER PRIMARY KEY, x REAL, y REAL, z REAL, v0 REAL, v1 REAL, v2 REAL, v3 "
        "REAL, "
        "v4 REAL, kind INTEGER, word TEXT)");
    run("CREATE VIRTUAL TABLE place USING rtree(id, x0, x1, y0, y1)");
    insert_ = prepare("INSERT INTO item VALUES(?,?,?,?,?,?,?,?,?,?,?)");
    place_ = prepare("INSERT INTO place VALUES(?,?,?,?,?)");
    update_ = prepare("UPDATE item SET v0=? WHERE id=?");
    sum_ = prepare("SELECT sum(v0) FROM item");
    near_ = prepare(
        "SELECT i.x,i.y,i.z FROM place p JOIN item i ON i.id=p.id WHERE p.x1>=?1 AND p.x0<=?2 AND p.y1>=?3 "
        "AND "
        "p.y0<=?4");
  }
  ~Sqlite() override {
    for (sqlite3_stmt* s : {insert_, place_, update_, sum_, near_}) sqlite3_finalize(s);
    sqlite3_close(db_);
  }
  Sqlite(const Sqlite&) = delete;
  Sqlite& operator=(const Sqlite&) = delete;
  void create(const std::vector<Item>& items) override {
    run("BEGIN");
    for (std::size_t k = 0; k < items.size(); ++k) {
      const Item& i = items[k];
      const auto id = static_cast<sqlite3_int64>(k + 1);
      sqlite3_bind_int64(insert_, 1, id);
      for (int c = 0; c < 3; ++c) sqlite3_bind_double(insert_, 2 + c, i.position[c]);
      for (int c = 0; c < kNumbers; ++c) sqlite3_bind_double(insert_, 5 + c, i.v[c]);
      sqlite3_bind_int64(insert_, 10, i.kind);
      sqlite3_bind_text(insert_, 11, i.word.c_str(), -1, SQLITE_STATIC);
      step(insert_);
      sqlite3_bind_int64(place_, 1, id);
      for (int c = 0; c < 4; ++c) sqlite3_bind_double(place_, 2 + c, i.position[c / 2]);
      step(place_);
    }
    run("COMMIT");
  }
  void subscribers(int n) override {
    calls_ = n;
    const auto tell = [](void* self, int, const char*, const char*, sqlite3_int64) {
      auto* s = static_cast<Sqlite*>(self);
      for (int i = 0; i < s->calls_; ++i) ++s->heard;
    };
    sqlite3_update_hook(db_, n == 0 ? nullptr : +tell, this);
  }
  void set_in_one(std::span<const std::uint32_t> nodes, double base) override {
    run("BEGIN");
    set_each(nodes, base);
    run("COMMIT");
  }
  void set_each(std::span<const std::uint32_t> nodes, double base) override {
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      sqlite3_bind_double(update_, 1, base + static_cast<double>(i));
      sqlite3_bind_int64(update_, 2, nodes[i] + 1);
      step(update_);
    }
  }
  double scan() override {
    if (sqlite3_step(sum_) != SQLITE_ROW) give_up(sqlite3_errmsg(db_));
    const double sum = sqlite3_column_double(sum_, 0);
    sqlite3_reset(sum_);
    return sum;
  }
  std::size_t radius(const Vector3& c) override {
    for (int i = 0; i < 2; ++i) {
      sqlite3_bind_double(near_, 1 + 2 * i, c[i] - kRadius_m);
      sqlite3_bind_double(near_, 2 + 2 * i, c[i] + kRadius_m);
    }
    std::size_t n = 0;
    while (sqlite3_step(near_) == SQLITE_ROW) {
      const Vector3 p(sqlite3_column_double(near_, 0), sqlite3_column_double(near_, 1),
                      sqlite3_column_double(near_, 2));
      n += (p - c).norm() <= kRadius_m;
    }
    sqlite3_reset(near_);
    return n;
  }
  void snapshot(std::span<const std::uint32_t> nodes, double base) override {
    set_in_one(nodes, base);
    sqlite3* copy = nullptr;
    sqlite3_open(":memory:", &copy);
    sqlite3_backup* b = sqlite3_backup_init(copy, "main", db_, "main");
    if (!b || sqlite3_backup_step(b, -1) != SQLITE_DONE) give_up("sqlite3_backup fails");
    sqlite3_backup_finish(b);
    sqlite3_close(copy);
  }

 private:
  void run(const char* sql) {
    if (sqlite3_exec(db_, sql, nullptr, nullptr, nullptr) != SQLITE_OK) give_up(sqlite3_errmsg(db_));
  }
  sqlite3_stmt* prepare(const char* sql) {
    sqlite3_stmt* s = nullptr;
    if (sqlite3_prepare_v2(db_, sql, -1, &s, nullptr) != SQLITE_OK) give_up(sqlite3_errmsg(db_));
    return s;
  }
  void step(sqlite3_stmt* s) {
    if (sqlite3_step(s) != SQLITE_DONE) give_up(sqlite3_errmsg(db_));
    sqlite3_reset(s);
  }
  sqlite3* db_ = nullptr;
  sqlite3_stmt *insert_ = nullptr, *place_ = nullptr, *update_ = nullptr, *sum_ = nullptr, *near_ = nullptr;
  int calls_ = 0;
};

// ---------------------------------------------------------------- the bench

double resident_mib() {
  std::ifstream f("/proc/self/statm");
  std::size_t total = 0, resident = 0;
  f >> total >> resident;
  return static_cast<double>(resident) * static_cast<double>(sysconf(_SC_PAGESIZE)) / (1 << 20);
}

/// Of a world of n nodes, in a process of its own: after the commit, history and index in it.
double measure_memory(std::size_t n) {
  int ends[2];
  if (pipe(ends) != 0) give_up("no pipe");
  const pid_t child = fork();
  if (child == 0) {
    double mib = 0;
    {
      Rigor r;
      const double before = resident_mib();
      r.create(make_items(n));  // the items go before memory is read
      mib = resident_mib() - before;
    }
    const bool written = write(ends[1], &mib, sizeof mib) == sizeof mib;
    _exit(written ? 0 : 1);
  }
  double mib = 0;
  if (read(ends[0], &mib, sizeof mib) != sizeof mib) give_up("the memory of a world was not measured");
  waitpid(child, nullptr, 0);
  close(ends[0]);
  close(ends[1]);
  return mib;
}

double median(std::vector<double> v) {
  std::nth_element(v.begin(), v.begin() + static_cast<long>(v.size() / 2), v.end());
  return v[v.size() / 2];
}

struct Line {
  std::string operation, unit;
  std::map<std::string, std::vector<double>> times;  // ns of one, by system
  std::string check;
  bool agree = true;
};

class Bench {
 public:
  explicit Bench(std::size_t n) : n_(n), random_(n + 1) {}
  void round() {
    std::vector<std::pair<std::string, std::unique_ptr<System>>> all;
    all.emplace_back("rigor", std::make_unique<Rigor>());
    all.emplace_back("plain", std::make_unique<Plain>());
    all.emplace_back("sqlite", std::make_unique<Sqlite>());
    const std::vector<Item> items = make_items(n_);
    measure(
        all, "create", n_,
        [&](System& s) {
          s.create(items);
          return 0.0;
        },
        [](System& s) { return s.scan(); });
    for (const int subscribers : {0, 1, 10}) {
      const std::string with = ", " + std::to_string(subscribers) + " subscribers";
      for (const bool own : {false, true}) {
        const auto nodes = some_nodes(own ? kOwnSets : kSets);
        const double base = next_base();
        for (auto& [name, s] : all) {
          s->subscribers(subscribers);
          s->heard = 0;
        }
        measure(
            all, std::string(own ? "set, its own" : "set, one big") + with, nodes.size(),
            [&](System& s) {
              if (own)
                s.set_each(nodes, base);
              else
                s.set_in_one(nodes, base);
              return 0.0;
            },
            [&](System& s) { return s.scan(); });
        // In one transaction a node that is set twice is told of once.
        std::vector<std::uint32_t> once(nodes);
        std::sort(once.begin(), once.end());
        once.erase(std::unique(once.begin(), once.end()), once.end());
        const std::size_t expected =
            static_cast<std::size_t>(subscribers) * (own ? nodes.size() : once.size());
        if (all[0].second->heard != expected) lines_.back().agree = false;
      }
    }
    for (auto& [name, s] : all) s->subscribers(0);
    measure(
        all, "scan", n_, [](System& s) { return s.scan(); }, nullptr);
    std::vector<Vector3> centres;
    for (std::size_t i = 0; i < kQueries; ++i) centres.push_back(items[random_() % n_].position);
    measure(
        all, "radius query", kQueries,
        [&](System& s) {
          std::size_t found = 0;
          for (const Vector3& c : centres) found += s.radius(c);
          return static_cast<double>(found);
        },
        nullptr);
    {
      const auto nodes = some_nodes(kChanges);
      const double base = next_base();
      for (auto& [name, s] : all) s->hold();
      measure(
          all, "transaction of 1000 changes", 1,
          [&](System& s) {
            s.set_in_one(nodes, base);
            return 0.0;
          },
          [](System& s) { return s.scan(); });
      for (auto& [name, s] : all) s->let_go();
    }
    const auto nodes = some_nodes(10 * kSnapshots);
    const double base = next_base();
    const std::size_t slow = n_ > 100'000 ? 2 : kSnapshots;  // a copy of a million strings each
    for (auto& [name, s] : all) {
      const std::size_t times = name == "rigor" ? kSnapshots : slow;
      const auto t0 = monotonic_now();
      for (std::size_t i = 0; i < times; ++i)
        s->snapshot(std::span(nodes).subspan(10 * i, 10), base + static_cast<double>(10 * i));
      line("snapshot after 10 changes")
          .times[name]
          .push_back(static_cast<double>((monotonic_now() - t0).ns()) / static_cast<double>(times));
      for (std::size_t i = times; i < kSnapshots; ++i)
        s->set_in_one(std::span(nodes).subspan(10 * i, 10), base + static_cast<double>(10 * i));
    }
    agree(all, line("snapshot after 10 changes"), [](System& s) { return s.scan(); });
    for (auto& [name, s] : all) s->let_go();
  }
  std::vector<Line>& lines() { return lines_; }

 private:
  Line& line(const std::string& operation) {
    for (Line& l : lines_)
      if (l.operation == operation) return l;
    lines_.push_back({operation, "", {}, "", true});
    return lines_.back();
  }
  template <class All, class Check>
  void agree(All& all, Line& l, const Check& check) {
    const double expected = check(*all[1].second);  // plain vectors know
    for (auto& [name, s] : all)
      if (check(*s) != expected) {
        l.agree = false;
        l.check = name + " differs";
      }
    if (l.agree) l.check = "sum " + std::to_string(static_cast<long long>(expected));
  }
  template <class All>
  void measure(All& all, const std::string& operation, std::size_t count,
               const std::function<double(System&)>& run, const std::function<double(System&)>& check) {
    Line& l = line(operation);
    std::vector<double> results;
    for (auto& [name, s] : all) {
      const auto t0 = monotonic_now();
      results.push_back(run(*s));
      l.times[name].push_back(static_cast<double>((monotonic_now() - t0).ns()) / static_cast<double>(count));
    }
    if (check) {
      agree(all, l, check);
    } else {
      l.check = "sum " + std::to_string(static_cast<long long>(results[1]));
      for (const double r : results)
        if (r != results[1]) l.agree = false;
    }
  }
  std::vector<std::uint32_t> some_nodes(std::size_t count) {
    std::vector<std::uint32_t> nodes(count);
    for (auto& n : nodes) n = static_cast<std::uint32_t>(random_() % n_);
    return nodes;
  }
  double next_base() { return base_ += 1e6; }
  std::size_t n_;
  std::mt19937_64 random_;
  double base_ = 0;
  std::vector<Line> lines_;
};

std::string in_words(double ns) {
  char text[32];
  const char* unit = ns < 1e3 ? "ns" : ns < 1e6 ? "us" : "ms";
  std::snprintf(text, sizeof text, "%.3g %s", ns < 1e3 ? ns : ns < 1e6 ? ns / 1e3 : ns / 1e6, unit);
  return text;
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<std::size_t> sizes = {10'000, 100'000, 1'000'000};
  int rounds = 3;
  std::string json_file;
  for (int i = 1; i < argc; ++i) {
    const std::string_view a = argv[i];
    if (i + 1 >= argc) give_up("usage: bench_world [--nodes N,N,...] [--rounds R] [--json FILE]");
    if (a == "--nodes") {
      sizes.clear();
      for (const char* p = argv[++i]; *p; p += *p == ',') {
        char* end = nullptr;
        sizes.push_back(std::strtoull(p, &end, 10));
        if (end == p || sizes.back() < 100)
          give_up("--nodes: expected numbers from 100 on, with commas between");
        p = end;
        if (!*p) break;
      }
    } else if (a == "--rounds") {
      rounds = std::max(1, std::atoi(argv[++i]));
    } else if (a == "--json") {
      json_file = argv[++i];
    } else {
      give_up("unknown option " + std::string(a));
    }
  }
  nlohmann::json report;
  bool all_agree = true;
  for (const std::size_t n : sizes) {
    const double mib = measure_memory(n);
    Bench bench(n);
    for (int r = 0; r < rounds; ++r) bench.round();
    std::printf("\n%zu nodes with 8 attributes; %.0f MiB resident, index and history in it\n", n, mib);
    std::printf("%-30s %12s %12s %12s  %s\n", "time of one", "rigor", "plain", "SQLite", "check");
    nlohmann::json& size = report[std::to_string(n)];
    size["resident_mib"] = mib;
    for (Line& l : bench.lines()) {
      std::printf("%-30s", l.operation.c_str());
      for (const char* system : {"rigor", "plain", "sqlite"}) {
        const double ns = median(l.times[system]);
        std::printf(" %12s", in_words(ns).c_str());
        size[l.operation][std::string(system) + "_ns"] = ns;
      }
      std::printf("  %s%s\n", l.agree ? "equal, " : "NOT EQUAL, ", l.check.c_str());
      size[l.operation]["equal"] = l.agree;
      all_agree = all_agree && l.agree;
    }
    std::fflush(stdout);
  }
  if (!json_file.empty()) {
    std::ofstream f(json_file);
    f << report.dump(2) << "\n";
    if (!f) give_up(json_file + " cannot be written");
  }
  return all_agree ? 0 : 1;
}
