#include "sensor-hal/config/yaml.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "sensor-hal/config/renamed.h"
#include "sensor-hal/config/unit_limits.h"
#include "sensor-hal/config/yaml_tree.h"

namespace rigor {

using config::Place;
using config::Value;
using config::ValuePtr;
using Kind = config::Value::Kind;

namespace {

struct Document {
  std::string name;
  std::filesystem::path base_dir;
  [[nodiscard]] std::string place(Place p) const {
    return p.line == 0 ? "--set" : name + ":" + std::to_string(p.line) + ":" + std::to_string(p.column);
  }
};

std::string show(double x) {
  char text[32];
  const auto end = std::to_chars(text, text + sizeof text, x).ptr;
  return {text, end};
}

std::string show(const Range& r) {
  const bool low = std::isfinite(r.min), high = std::isfinite(r.max);
  std::string s;
  if (low && r.exclusive_min)
    s = " above " + show(r.min) + (high ? " and up to " + show(r.max) : "");
  else if (low && high)
    s = " from " + show(r.min) + " to " + show(r.max);
  else if (low)
    s = " of at least " + show(r.min);
  else if (high)
    s = " of at most " + show(r.max);
  return s;
}

template <class T>
bool inside(T x, const Range& r) {
  // long double: holds every int64 and every double exactly on the targets of this project.
  const auto v = static_cast<long double>(x);
  return (r.exclusive_min ? v > static_cast<long double>(r.min) : v >= static_cast<long double>(r.min)) &&
         v <= static_cast<long double>(r.max);
}

bool digits(std::string_view s) {
  return !s.empty() && std::all_of(s.begin(), s.end(), [](char c) { return c >= '0' && c <= '9'; });
}

std::string_view without_sign(std::string_view s) {
  if (!s.empty() && (s.front() == '+' || s.front() == '-')) s.remove_prefix(1);
  return s;
}

/// 010 is ten in YAML 1.2 and eight in YAML 1.1; nobody who writes it is sure to know.
bool ambiguous_zero(std::string_view s) {
  s = without_sign(s);
  return s.size() > 1 && s.front() == '0' && digits(s);
}

/// The number grammar of YAML 1.2's core schema, less infinity and NaN.
bool looks_like_number(std::string_view s) {
  s = without_sign(s);
  const auto e = s.find_first_of("eE");
  if (e != std::string_view::npos) {
    if (!digits(without_sign(s.substr(e + 1)))) return false;
    s = s.substr(0, e);
  }
  const auto dot = s.find('.');
  if (dot == std::string_view::npos) return digits(s);
  const auto whole = s.substr(0, dot), part = s.substr(dot + 1);
  return (digits(whole) && (part.empty() || digits(part))) || (whole.empty() && digits(part));
}

bool not_finite_word(std::string_view s) {
  std::string low(without_sign(s));
  std::transform(low.begin(), low.end(), low.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? char(c + 32) : c; });
  return low == ".inf" || low == ".nan";
}

enum class Parsed : std::uint8_t { good, not_one, too_big };

/// Decimal, 0x and 0o with an optional sign.
Parsed parse_integer(std::string_view s, std::int64_t& out) {
  const bool negative = !s.empty() && s.front() == '-';
  auto body = without_sign(s);
  int base = 10;
  if (body.starts_with("0x")) base = 16, body.remove_prefix(2);
  if (body.starts_with("0o")) base = 8, body.remove_prefix(2);
  if (body.empty() || body.front() == '-' || body.front() == '+') return Parsed::not_one;
  std::uint64_t magnitude = 0;
  const auto [end, ec] = std::from_chars(body.data(), body.data() + body.size(), magnitude, base);
  if (end != body.data() + body.size()) return Parsed::not_one;
  const auto limit = std::uint64_t{1} << 63;
  if (ec == std::errc::result_out_of_range || magnitude > limit - (negative ? 0 : 1)) return Parsed::too_big;
  if (ec != std::errc{}) return Parsed::not_one;
  out = static_cast<std::int64_t>(negative ? 0 - magnitude : magnitude);
  return Parsed::good;
}

Parsed parse_number(std::string_view s, double& out) {
  if (!looks_like_number(s)) {
    std::int64_t i = 0;  // 0x10 is a number too
    const auto r = s.find_first_of("xo") == std::string_view::npos ? Parsed::not_one : parse_integer(s, i);
    out = static_cast<double>(i);
    return r;
  }
  if (s.front() == '+') s.remove_prefix(1);
  const auto [end, ec] = std::from_chars(s.data(), s.data() + s.size(), out);
  if (ec == std::errc::result_out_of_range) {
    // from_chars reports underflow in the same way; what rounds to zero is zero.
    const auto e = s.find_first_of("eE");
    if (e != std::string_view::npos && s.substr(e + 1).starts_with('-')) {
      out = 0;
      return Parsed::good;
    }
    return Parsed::too_big;
  }
  return ec == std::errc{} && end == s.data() + s.size() ? Parsed::good : Parsed::not_one;
}

nlohmann::json to_json(const Value& v) {
  switch (v.kind) {
    case Kind::null:
      return nullptr;
    case Kind::list: {
      auto out = nlohmann::json::array();
      for (const ValuePtr& item : v.items) out.push_back(to_json(*item));
      return out;
    }
    case Kind::map: {
      auto out = nlohmann::json::object();
      for (const Value::Entry& e : v.entries) out[e.key] = to_json(*e.value);
      return out;
    }
    case Kind::scalar:
      break;
  }
  std::int64_t whole = 0;
  double number = 0;
  if (v.quoted) return v.text;
  if (v.text == "true" || v.text == "false") return v.text == "true";
  if (config::is_null_word(v.text)) return nullptr;
  if (parse_integer(v.text, whole) == Parsed::good) return whole;
  if (parse_number(v.text, number) == Parsed::good) return number;
  return v.text;
}

}  // namespace

struct ConfigNode::Impl {
  std::shared_ptr<const Document> document;
  ValuePtr value;  ///< null: absent
  Place place;     ///< of the value, or of the map that lacks it
  std::string path;
  std::set<std::string, std::less<>> asked, known;
  std::map<std::pair<std::string, int>, std::shared_ptr<Impl>> children;

  [[nodiscard]] std::string child_path(std::string_view key) const {
    return path.empty() ? std::string(key) : path + "." + std::string(key);
  }
  [[nodiscard]] ConfigError error_at(Place where, const std::string& at_path,
                                     const std::string& message) const {
    return ConfigError(
        {ErrorCode::bad_input, document->place(where), at_path.empty() ? message : at_path + ": " + message});
  }
  /// The value of `key`, and notes that it was asked for; null when there is none.
  [[nodiscard]] const Value* ask(std::string_view key) {
    known.emplace(key);
    asked.emplace(key);
    if (!value || value->kind != Kind::map) return nullptr;
    const auto* entry = value->find(key);
    return entry ? entry->value.get() : nullptr;
  }
  [[nodiscard]] ConfigError missing(std::string_view key, const std::string& expected) const {
    std::vector<std::string> unread;
    if (value)
      for (const auto& e : value->entries)
        if (!asked.contains(e.key)) unread.push_back(e.key);
    for (const std::string& old : unread)
      if (!renamed(old, {std::string(key)}).empty())
        return error_at(place, child_path(old), "now called " + std::string(key));
    const auto near = nearest(key, unread);
    return error_at(place, child_path(key),
                    "expected " + expected + ", got nothing: the key is missing" +
                        (near.empty() ? "" : "; did you mean it by '" + near + "'?"));
  }
  [[nodiscard]] ConfigError wrong(const Value& v, const std::string& at_path, const std::string& expected,
                                  const std::string& hint = {}) const {
    return error_at(v.place, at_path, "expected " + expected + ", got " + config::describe(v) + hint);
  }
  /// One node per place in the tree, so that all copies share what was asked for.
  [[nodiscard]] std::shared_ptr<Impl> child(std::string_view key, ValuePtr v, Place where, int item = -1) {
    auto& c = children[{std::string(key), item}];
    if (!c) {
      c = std::make_shared<Impl>();
      c->document = document;
      c->value = std::move(v);
      c->place = where;
      c->path = child_path(key) + (item < 0 ? "" : "." + std::to_string(item));
    }
    return c;
  }

  // The scalar readers: of a value, at a path.
  [[nodiscard]] std::string read_text(const Value& v, const std::string& p) const {
    if (v.kind != Kind::scalar) throw wrong(v, p, "text");
    return v.text;
  }
  [[nodiscard]] double read_number(const Value& v, const std::string& p, const Range& range) const {
    const auto expected = "a number" + show(range);
    if (v.kind != Kind::scalar) throw wrong(v, p, expected);
    if (v.quoted) throw wrong(v, p, expected, looks_like_number(v.text) ? "; remove the quotes" : "");
    if (not_finite_word(v.text)) throw wrong(v, p, "a finite number" + show(range));
    if (ambiguous_zero(v.text)) throw wrong(v, p, expected, "; write it without the leading zero");
    double x = 0;
    switch (parse_number(v.text, x)) {
      case Parsed::good:
        break;
      case Parsed::too_big:
        throw wrong(v, p, expected, ", which no double can hold");
      case Parsed::not_one:
        throw wrong(v, p, expected);
    }
    if (!inside(x, range)) throw wrong(v, p, expected);
    check_unit(v, p, x, range, "a number");
    return x;
  }
  /// What the reader leaves open, the unit of the key bounds.
  void check_unit(const Value& v, const std::string& p, double x, const Range& range,
                  const char* what) const {
    const Range bounded = config::within_unit(p, range);
    if (!inside(x, bounded)) throw wrong(v, p, what + show(bounded));
  }
  [[nodiscard]] std::int64_t read_integer(const Value& v, const std::string& p, const Range& range) const {
    const auto expected = "a whole number" + show(range);
    if (v.kind != Kind::scalar) throw wrong(v, p, expected);
    std::int64_t x = 0;
    const auto parsed = parse_integer(v.text, x);
    if (v.quoted) throw wrong(v, p, expected, parsed == Parsed::good ? "; remove the quotes" : "");
    if (ambiguous_zero(v.text))
      throw wrong(v, p, expected, "; write it without the leading zero, or as 0o… in octal");
    if (parsed == Parsed::too_big) throw wrong(v, p, expected, ", which 64 bits cannot hold");
    if (parsed != Parsed::good || !inside(x, range)) throw wrong(v, p, expected);
    // Seeds and addresses have all 64 bits.
    if (config::unit_limit(p) < config::unit_limit(""))
      check_unit(v, p, static_cast<double>(x), range, "a whole number");
    return x;
  }
  [[nodiscard]] bool read_flag(const Value& v, const std::string& p) const {
    if (v.kind == Kind::scalar && !v.quoted) {
      if (v.text == "true") return true;
      if (v.text == "false") return false;
    }
    static const std::set<std::string, std::less<>> yes{"yes", "Yes", "YES",  "on",  "On",
                                                        "ON",  "y",   "True", "TRUE"};
    static const std::set<std::string, std::less<>> no{"no",  "No", "NO",    "off",  "Off",
                                                       "OFF", "n",  "False", "FALSE"};
    std::string hint;
    if (v.kind == Kind::scalar) {
      if (yes.contains(v.text) || v.text == "true") hint = "; write true";
      if (no.contains(v.text) || v.text == "false") hint = "; write false";
    }
    throw wrong(v, p, "true or false", hint);
  }
  [[nodiscard]] std::string read_choice(const Value& v, const std::string& p,
                                        const std::vector<std::string>& allowed) const {
    const auto expected = choice_text(allowed);
    if (v.kind != Kind::scalar) throw wrong(v, p, expected);
    if (std::find(allowed.begin(), allowed.end(), v.text) != allowed.end()) return v.text;
    const auto now = renamed(v.text, allowed), near = nearest(v.text, allowed);
    throw wrong(v, p, expected,
                !now.empty()   ? "; now called " + now
                : near.empty() ? ""
                               : "; did you mean '" + near + "'?");
  }
  [[nodiscard]] std::vector<double> read_numbers(const Value& v, const std::string& p,
                                                 std::optional<std::size_t> count) const {
    const auto expected =
        count ? "a list of " + std::to_string(*count) + " numbers" : std::string("a list of numbers");
    if (v.kind != Kind::list || (count && v.items.size() != *count)) throw wrong(v, p, expected);
    std::vector<double> out;
    for (std::size_t i = 0; i < v.items.size(); ++i)
      out.push_back(read_number(*v.items[i], p + "." + std::to_string(i), {}));
    return out;
  }
  [[nodiscard]] static std::string choice_text(const std::vector<std::string>& allowed) {
    std::string s = allowed.size() == 1 ? "" : "one of ";
    for (std::size_t i = 0; i < allowed.size(); ++i) s += (i ? ", " : "") + allowed[i];
    return s;
  }
};

namespace {

/// What an absent, default-made node says when something is required of it.
ConfigError absent_error(std::string_view key, const std::string& expected) {
  return ConfigError({ErrorCode::bad_input, "",
                      std::string(key) + ": expected " + expected + ", got nothing: the key is missing"});
}

}  // namespace

bool ConfigNode::present() const noexcept { return impl_ && impl_->value; }
bool ConfigNode::is_map() const {
  return present() && (impl_->value->kind == Kind::map || impl_->value->kind == Kind::null);
}
bool ConfigNode::is_list() const { return present() && impl_->value->kind == Kind::list; }
bool ConfigNode::has(std::string_view key) const {
  if (!impl_) return false;
  impl_->known.emplace(key);
  return impl_->value && impl_->value->kind == Kind::map && impl_->value->find(key) != nullptr;
}
std::string ConfigNode::scalar_or_empty(std::string_view key) const {
  const auto* v = impl_ ? impl_->ask(key) : nullptr;
  return v && v->kind == Kind::scalar ? v->text : "";
}
std::string ConfigNode::path() const { return impl_ ? impl_->path : ""; }
std::string ConfigNode::place() const { return impl_ ? impl_->document->place(impl_->place) : ""; }
std::filesystem::path ConfigNode::base_dir() const {
  return impl_ ? impl_->document->base_dir : std::filesystem::path();
}

std::string ConfigNode::text(std::string_view key) const {
  if (!impl_) throw absent_error(key, "text");
  const auto* v = impl_->ask(key);
  if (!v) throw impl_->missing(key, "text");
  return impl_->read_text(*v, impl_->child_path(key));
}
double ConfigNode::number(std::string_view key, Range range) const {
  if (!impl_) throw absent_error(key, "a number" + show(range));
  const auto* v = impl_->ask(key);
  if (!v) throw impl_->missing(key, "a number" + show(range));
  return impl_->read_number(*v, impl_->child_path(key), range);
}
std::int64_t ConfigNode::integer(std::string_view key, Range range) const {
  if (!impl_) throw absent_error(key, "a whole number" + show(range));
  const auto* v = impl_->ask(key);
  if (!v) throw impl_->missing(key, "a whole number" + show(range));
  return impl_->read_integer(*v, impl_->child_path(key), range);
}
bool ConfigNode::flag(std::string_view key) const {
  if (!impl_) throw absent_error(key, "true or false");
  const auto* v = impl_->ask(key);
  if (!v) throw impl_->missing(key, "true or false");
  return impl_->read_flag(*v, impl_->child_path(key));
}
ConfigNode ConfigNode::map(std::string_view key) const {
  if (!impl_) throw absent_error(key, "a map");
  if (!impl_->ask(key)) throw impl_->missing(key, "a map");
  return map_or_absent(key);
}
std::vector<ConfigNode> ConfigNode::list(std::string_view key) const {
  if (!impl_) throw absent_error(key, "a list");
  const auto* v = impl_->ask(key);
  if (!v) throw impl_->missing(key, "a list");
  if (v->kind != Kind::list) throw impl_->wrong(*v, impl_->child_path(key), "a list");
  return list_or_empty(key);
}
std::vector<double> ConfigNode::numbers(std::string_view key, std::size_t count) const {
  const auto expected = "a list of " + std::to_string(count) + " numbers";
  if (!impl_) throw absent_error(key, expected);
  const auto* v = impl_->ask(key);
  if (!v) throw impl_->missing(key, expected);
  return impl_->read_numbers(*v, impl_->child_path(key), count);
}
std::string ConfigNode::choice(std::string_view key, const std::vector<std::string>& allowed) const {
  if (!impl_) throw absent_error(key, Impl::choice_text(allowed));
  const auto* v = impl_->ask(key);
  if (!v) throw impl_->missing(key, Impl::choice_text(allowed));
  return impl_->read_choice(*v, impl_->child_path(key), allowed);
}

std::string ConfigNode::text_or(std::string_view key, std::string fallback) const {
  const auto* v = impl_ ? impl_->ask(key) : nullptr;
  return v ? impl_->read_text(*v, impl_->child_path(key)) : std::move(fallback);
}
double ConfigNode::number_or(std::string_view key, double fallback, Range range) const {
  const auto* v = impl_ ? impl_->ask(key) : nullptr;
  return v ? impl_->read_number(*v, impl_->child_path(key), range) : fallback;
}
std::int64_t ConfigNode::integer_or(std::string_view key, std::int64_t fallback, Range range) const {
  const auto* v = impl_ ? impl_->ask(key) : nullptr;
  return v ? impl_->read_integer(*v, impl_->child_path(key), range) : fallback;
}
bool ConfigNode::flag_or(std::string_view key, bool fallback) const {
  const auto* v = impl_ ? impl_->ask(key) : nullptr;
  return v ? impl_->read_flag(*v, impl_->child_path(key)) : fallback;
}
ConfigNode ConfigNode::map_or_absent(std::string_view key) const {
  ConfigNode n;
  if (!impl_) return n;
  const auto* v = impl_->ask(key);
  if (v && v->kind != Kind::map && v->kind != Kind::null)
    throw impl_->wrong(*v, impl_->child_path(key), "a map");
  n.impl_ = v ? impl_->child(key, impl_->value->find(key)->value, v->place)
              : impl_->child(key, nullptr, impl_->place);
  return n;
}
std::vector<ConfigNode> ConfigNode::list_or_empty(std::string_view key) const {
  std::vector<ConfigNode> out;
  const auto* v = impl_ ? impl_->ask(key) : nullptr;
  if (!v || v->kind == Kind::null) return out;
  if (v->kind != Kind::list) throw impl_->wrong(*v, impl_->child_path(key), "a list");
  for (std::size_t i = 0; i < v->items.size(); ++i) {
    ConfigNode n;
    n.impl_ = impl_->child(key, v->items[i], v->items[i]->place, static_cast<int>(i));
    out.push_back(std::move(n));
  }
  return out;
}
std::vector<double> ConfigNode::numbers_or(std::string_view key, std::vector<double> fallback) const {
  const auto* v = impl_ ? impl_->ask(key) : nullptr;
  if (!v) return fallback;
  return impl_->read_numbers(*v, impl_->child_path(key),
                             fallback.empty() ? std::nullopt : std::optional(fallback.size()));
}
std::string ConfigNode::choice_or(std::string_view key, const std::vector<std::string>& allowed,
                                  std::string fallback) const {
  const auto* v = impl_ ? impl_->ask(key) : nullptr;
  return v ? impl_->read_choice(*v, impl_->child_path(key), allowed) : std::move(fallback);
}

std::string ConfigNode::as_text() const {
  if (!present()) throw error({}, "expected text, got nothing");
  return impl_->read_text(*impl_->value, impl_->path);
}
double ConfigNode::as_number(Range range) const {
  if (!present()) throw error({}, "expected a number" + show(range) + ", got nothing");
  return impl_->read_number(*impl_->value, impl_->path, range);
}
std::int64_t ConfigNode::as_integer(Range range) const {
  if (!present()) throw error({}, "expected a whole number" + show(range) + ", got nothing");
  return impl_->read_integer(*impl_->value, impl_->path, range);
}

std::vector<std::string> ConfigNode::keys() const {
  std::vector<std::string> out;
  if (present())
    for (const auto& e : impl_->value->entries) out.push_back(e.key);
  return out;
}

void ConfigNode::finish() const {
  if (!present()) return;
  if (!is_map()) throw impl_->wrong(*impl_->value, impl_->path, "a map");
  for (const auto& e : impl_->value->entries) {
    if (impl_->asked.contains(e.key)) continue;
    std::vector<std::string> free;  // a known key that is there already is not what was meant
    for (const auto& k : impl_->known)
      if (!impl_->value->find(k)) free.push_back(k);
    if (const auto now = renamed(e.key, {impl_->known.begin(), impl_->known.end()}); !now.empty())
      throw impl_->error_at(e.key_place, impl_->child_path(e.key), "now called " + now);
    const auto near = nearest(e.key, free);
    std::string expected;
    if (near.empty()) {
      for (const auto& k : impl_->known) expected += (expected.empty() ? "" : ", ") + k;
      expected = expected.empty() ? "; expected no keys here" : "; expected " + expected;
    } else {
      expected = "; did you mean " + near + "?";
    }
    throw impl_->error_at(e.key_place, impl_->child_path(e.key), "unknown key" + expected);
  }
}

ConfigError ConfigNode::error(std::string_view key, std::string_view message) const {
  if (!impl_)
    return ConfigError({ErrorCode::bad_input, "",
                        key.empty() ? std::string(message) : std::string(key) + ": " + std::string(message)});
  if (key.empty()) return impl_->error_at(impl_->place, impl_->path, std::string(message));
  const auto* entry = impl_->value && impl_->value->kind == Kind::map ? impl_->value->find(key) : nullptr;
  return impl_->error_at(entry ? entry->value->place : impl_->place, impl_->child_path(key),
                         std::string(message));
}

std::string ConfigNode::dump() const { return present() ? config::write_yaml(*impl_->value) : ""; }
std::string ConfigNode::json() const {
  const auto replace = nlohmann::json::error_handler_t::replace;
  return present() ? to_json(*impl_->value).dump(-1, ' ', false, replace) : "{}";
}

Result<ConfigOverride> ConfigOverride::parse(std::string_view text) {
  const auto equals = text.find('=');
  const std::string where = "--set " + std::string(text);
  if (equals == std::string_view::npos)
    return fail(ErrorCode::bad_input, where, "expected path.to.key=value, got no =");
  if (config::find_unprintable(text) != std::string_view::npos)
    return fail(ErrorCode::bad_input, "--set", "expected text, got a control character or a byte-order mark");
  const auto path = text.substr(0, equals);
  if (path.empty() || path.front() == '.' || path.back() == '.' || path.find("..") != std::string_view::npos)
    return fail(ErrorCode::bad_input, where,
                "expected keys joined by single dots before the =, got '" + std::string(path) + "'");
  return ConfigOverride{std::string(path), std::string(text.substr(equals + 1))};
}

Result<ConfigNode> ConfigDocument::load(const std::filesystem::path& file,
                                        const std::vector<ConfigOverride>& overrides) {
  namespace fs = std::filesystem;
  std::error_code ec;
  const auto status = fs::status(file, ec);
  if (status.type() == fs::file_type::not_found)
    return fail(ErrorCode::not_found, file.string(),
                "expected a YAML file, got nothing: no such file (looked in " +
                    fs::absolute(file, ec).parent_path().string() + ")");
  if (fs::is_directory(status))
    return fail(ErrorCode::bad_input, file.string(), "expected a YAML file, got a directory");
  errno = 0;
  std::ifstream in(file, std::ios::binary);
  if (!in)
    return fail(ErrorCode::bad_input, file.string(),
                std::string("expected a readable file, got: ") + std::strerror(errno != 0 ? errno : EIO));
  std::string text(config::kMaxFileBytes + 1, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  if (in.bad()) return fail(ErrorCode::io, file.string(), "cannot be read to its end");
  if (text.size() > config::kMaxFileBytes)
    return fail(ErrorCode::bad_input, file.string(), "expected at most 16 MiB of YAML, got more");
  return parse(text, file.string(), overrides);
}

Result<ConfigNode> ConfigDocument::parse(std::string_view text, std::string_view name,
                                         const std::vector<ConfigOverride>& overrides) {
  auto root = config::read_tree(text, name);
  if (!root) return tl::unexpected<Error>(root.error());
  for (const auto& o : overrides) {
    root = config::apply_override(*root, o);
    if (!root) return tl::unexpected<Error>(root.error());
  }
  auto document = std::make_shared<Document>();
  document->name = name;
  if (!name.starts_with('<')) document->base_dir = std::filesystem::path(name).parent_path();
  ConfigNode n;
  n.impl_ = std::make_shared<ConfigNode::Impl>();
  n.impl_->document = std::move(document);
  n.impl_->place = (*root)->place;
  n.impl_->value = std::move(*root);
  return n;
}

}  // namespace rigor
