#include "sensor-hal/config/yaml_tree.h"

#include <yaml-cpp/anchor.h>
#include <yaml-cpp/eventhandler.h>
#include <yaml-cpp/exceptions.h>
#include <yaml-cpp/parser.h>

#include <algorithm>
#include <charconv>
#include <map>
#include <sstream>
#include <unordered_set>

namespace rigor::config {
namespace {

std::string at(std::string_view name, Place p) {
  return std::string(name) + ":" + std::to_string(p.line) + ":" + std::to_string(p.column);
}

/// A complaint on its way out of the parser's callbacks.
struct Refused {
  Place place;
  std::string message;
};

bool is_continuation(char c) noexcept { return (static_cast<unsigned char>(c) & 0xC0U) == 0x80U; }

/// Bytes of the UTF-8 character at the start of `s`; 0 where it is none (overlong, surrogate, cut short).
std::size_t utf8_length(std::string_view s) noexcept {
  const auto byte = [&](std::size_t i) -> unsigned { return static_cast<unsigned char>(s[i]); };
  const unsigned b0 = byte(0);
  if (b0 < 0x80) return 1;
  const std::size_t n = b0 >= 0xC2 && b0 <= 0xDF   ? 2
                        : b0 >= 0xE0 && b0 <= 0xEF ? 3
                        : b0 >= 0xF0 && b0 <= 0xF4 ? 4
                                                   : 0;
  if (n == 0 || s.size() < n) return 0;
  for (std::size_t i = 1; i < n; ++i)
    if (!is_continuation(s[i])) return 0;
  if (b0 == 0xE0 && byte(1) < 0xA0) return 0;
  if (b0 == 0xED && byte(1) > 0x9F) return 0;
  if (b0 == 0xF0 && byte(1) < 0x90) return 0;
  if (b0 == 0xF4 && byte(1) > 0x8F) return 0;
  return n;
}

/// Places as an editor counts them: columns in characters, where the parser counts bytes.
class Lines {
 public:
  explicit Lines(std::string_view text) : text_(text) {
    starts_.push_back(0);
    for (std::size_t i = 0; i < text.size(); ++i)
      if (text[i] == '\n') starts_.push_back(i + 1);
  }
  [[nodiscard]] Place place(std::size_t offset) const {
    offset = std::min(offset, text_.size());
    const auto line =
        static_cast<std::size_t>(std::upper_bound(starts_.begin(), starts_.end(), offset) - starts_.begin());
    return {static_cast<std::uint32_t>(line), column(starts_[line - 1], offset)};
  }
  [[nodiscard]] Place place(const YAML::Mark& m) const {
    if (m.is_null() || m.line < 0 || m.column < 0) return {1, 1};
    const auto line = std::min(static_cast<std::size_t>(m.line), starts_.size() - 1);
    const auto offset = std::min(starts_[line] + static_cast<std::size_t>(m.column), text_.size());
    return {static_cast<std::uint32_t>(line + 1), column(starts_[line], offset)};
  }
  /// True where the text at `m` spells nothing, instead of having nothing there.
  [[nodiscard]] bool null_word_at(const YAML::Mark& m) const {
    if (m.is_null() || m.line < 0 || m.column < 0 || static_cast<std::size_t>(m.line) >= starts_.size())
      return false;
    const auto begin = starts_[static_cast<std::size_t>(m.line)] + static_cast<std::size_t>(m.column);
    if (begin >= text_.size()) return false;
    const auto word = text_.substr(begin, text_.find_first_of(" \t\r\n,]}#:", begin) - begin);
    return !word.empty() && is_null_word(word);
  }
  /// The first line up to `last` that is indented with a tab; 0 when none is.
  [[nodiscard]] Place tab_indent(std::uint32_t last) const {
    for (std::size_t line = 0; line < starts_.size() && line < last; ++line) {
      std::size_t i = starts_[line];
      while (i < text_.size() && text_[i] == ' ') ++i;
      if (i < text_.size() && text_[i] == '\t') return place(i);
    }
    return {};
  }

 private:
  /// Goes on from the last answer where it can, since places are asked for in the order of the text: a file
  /// that is one long line would cost the square of its length.
  [[nodiscard]] std::uint32_t column(std::size_t start, std::size_t offset) const {
    if (start != last_start_ || offset < last_offset_) last_start_ = last_offset_ = start, last_column_ = 1;
    for (; last_offset_ < offset; ++last_offset_) last_column_ += !is_continuation(text_[last_offset_]);
    return last_column_;
  }
  std::string_view text_;
  std::vector<std::size_t> starts_;
  mutable std::size_t last_start_ = 0, last_offset_ = 0;
  mutable std::uint32_t last_column_ = 1;
};

/// Takes the parser's events and stacks up values.
class Builder final : public YAML::EventHandler {
 public:
  explicit Builder(const Lines& lines) : lines_(lines) {}

  [[nodiscard]] ValuePtr root() const { return root_; }

  void OnDocumentStart(const YAML::Mark&) override {}
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark& mark, YAML::anchor_t anchor) override {
    auto v = make(Value::Kind::null, mark);
    // What is left out has no token: the parser then gives the place where it stopped looking, often a later
    // line.
    if (!lines_.null_word_at(mark) && !open_.empty() && open_.back().has_key)
      v->place = open_.back().value->entries.back().key_place;
    add(std::move(v), anchor);
  }
  void OnAlias(const YAML::Mark& mark, YAML::anchor_t anchor) override {
    const auto found = anchors_.find(anchor);
    if (found == anchors_.end())
      throw Refused{lines_.place(mark),
                    "expected an alias of a finished value, got one inside the value itself"};
    if (!open_.empty() && expects_key()) throw Refused{lines_.place(mark), "expected a key, got an alias"};
    count(found->second->weight, lines_.place(mark));
    check_depth(open_.size() + found->second->depth, lines_.place(mark));
    attach(found->second, lines_.place(mark));
  }
  void OnScalar(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                const std::string& text) override {
    auto v = make(Value::Kind::scalar, mark);
    v->quoted = tag == "!" || tag == "tag:yaml.org,2002:str";
    if (!v->quoted) check_tag(tag, v->place);
    check_text(text, v->place);
    v->text = text;
    if (!open_.empty() && expects_key()) return take_key(*v);
    if (!v->quoted && is_null_word(text)) v->kind = Value::Kind::null;
    add(std::move(v), anchor);
  }
  void OnSequenceStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                       YAML::EmitterStyle::value) override {
    open(Value::Kind::list, mark, tag, anchor);
  }
  void OnSequenceEnd() override { close(); }
  void OnMapStart(const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor,
                  YAML::EmitterStyle::value) override {
    open(Value::Kind::map, mark, tag, anchor);
  }
  void OnMapEnd() override { close(); }

 private:
  struct Open {
    std::shared_ptr<Value> value;
    YAML::anchor_t anchor = YAML::NullAnchor;
    bool has_key = false;
    std::unordered_set<std::string> seen;
  };

  std::shared_ptr<Value> make(Value::Kind kind, const YAML::Mark& mark) {
    auto v = std::make_shared<Value>();
    v->kind = kind;
    v->place = lines_.place(mark);
    return v;
  }
  static void check_tag(const std::string& tag, Place place) {
    if (!tag.empty() && tag != "?")
      throw Refused{place, "expected a plain value, got the tag '" + tag + "'; remove it"};
  }
  /// yaml-cpp 0.7 writes the escapes \N and \_ as one byte, which is no UTF-8.
  static void check_text(std::string_view text, Place place) {
    for (std::size_t i = 0; i < text.size();) {
      const auto n = utf8_length(text.substr(i));
      if (n == 0)
        throw Refused{place,
                      "expected text, got an escape (\\N or \\_) that the parser gets wrong; write the "
                      "character itself, or \\u0085 or \\u00a0"};
      i += n;
    }
  }
  [[nodiscard]] bool expects_key() const {
    return open_.back().value->kind == Value::Kind::map && !open_.back().has_key;
  }
  void count(std::uint64_t n, Place place) {
    total_ += n;
    if (total_ > kMaxValues)
      throw Refused{
          place, "expected at most " + std::to_string(kMaxValues) +
                     " values with every alias written out, got more; use fewer aliases or split the file"};
  }
  static void check_depth(std::size_t depth, Place place) {
    if (depth > kMaxDepth)
      throw Refused{place, "expected maps and lists nested at most " + std::to_string(kMaxDepth) +
                               " levels deep with every alias written out, got more; flatten them"};
  }
  void take_key(const Value& key) {
    auto& map = open_.back();
    if (!key.quoted && key.text == "<<")
      throw Refused{key.place,
                    "expected a key, got the merge key <<, which YAML 1.2 does not have; repeat the keys"};
    if (!map.seen.insert(key.text).second) {
      const auto first = map.value->find(key.text)->key_place;
      throw Refused{key.place, "expected each key once, got '" + key.text + "' again; the first is in line " +
                                   std::to_string(first.line)};
    }
    map.value->entries.push_back({key.text, key.quoted, key.place, nullptr});
    map.has_key = true;
  }
  void add(std::shared_ptr<Value> v, YAML::anchor_t anchor) {
    count(1, v->place);
    if (anchor != YAML::NullAnchor) anchors_[anchor] = v;
    const auto place = v->place;
    attach(std::move(v), place);
  }
  void attach(ValuePtr v, Place place) {
    if (open_.empty()) {
      root_ = std::move(v);
      return;
    }
    auto& top = open_.back();
    top.value->weight += v->weight;
    top.value->depth = std::max(top.value->depth, v->depth + 1);
    if (top.value->kind == Value::Kind::list) {
      top.value->items.push_back(std::move(v));
    } else if (top.has_key) {
      top.value->entries.back().value = std::move(v);
      top.has_key = false;
    } else {
      throw Refused{place, "expected a key, got " + describe(*v)};
    }
  }
  void open(Value::Kind kind, const YAML::Mark& mark, const std::string& tag, YAML::anchor_t anchor) {
    auto v = make(kind, mark);
    check_tag(tag, v->place);
    if (!open_.empty() && expects_key())
      throw Refused{v->place,
                    std::string("expected a key, got a ") + (kind == Value::Kind::map ? "map" : "list")};
    count(1, v->place);
    check_depth(open_.size() + 1, v->place);
    v->depth = 1;
    open_.push_back({std::move(v), anchor, false, {}});
  }
  void close() {
    auto done = std::move(open_.back());
    open_.pop_back();
    if (done.anchor != YAML::NullAnchor) anchors_[done.anchor] = done.value;
    const auto place = done.value->place;
    attach(std::move(done.value), place);
  }

  const Lines& lines_;
  ValuePtr root_;
  std::vector<Open> open_;
  std::map<YAML::anchor_t, ValuePtr> anchors_;
  std::uint64_t total_ = 0;
};

/// The bytes that YAML allows, so that the parser never meets those that it keeps for itself.
void check_characters(std::string_view text, const Lines& lines) {
  for (std::size_t i = 0; i < text.size();) {
    const auto c = static_cast<unsigned char>(text[i]);
    const auto n = utf8_length(text.substr(i));
    if (n == 0)
      throw Refused{lines.place(i), "expected UTF-8 text, got a byte that is none; save the file as UTF-8"};
    if ((c < 0x20 && c != '\t' && c != '\n' && c != '\r') || c == 0x7F)
      throw Refused{lines.place(i), "expected text, got the control character " + std::to_string(c)};
    if (text.substr(i).starts_with("\xEF\xBB\xBF"))
      throw Refused{lines.place(i),
                    "expected text, got a byte-order mark that is not the first character; remove it"};
    if (c == '\r' && (i + 1 == text.size() || text[i + 1] != '\n'))
      throw Refused{lines.place(i), "expected lines that end in LF or CR LF, got a CR alone"};
    i += n;
  }
}

ValuePtr parse(std::string_view text, const Lines& lines) {
  check_characters(text, lines);
  // yaml-cpp 0.7 takes a quote that is never closed for closed when the text ends in a line feed. A comment
  // at the end changes nothing else, and there it reports the open quote.
  std::string closed(text);
  closed += closed.ends_with('\n') ? "#" : "\n#";
  std::istringstream stream(closed);
  YAML::Parser parser(stream);
  Builder builder(lines);
  if (!parser.HandleNextDocument(builder)) return nullptr;
  Builder second(lines);
  if (parser.HandleNextDocument(second)) {
    const auto place = second.root() ? second.root()->place : Place{1, 1};
    throw Refused{place, "expected one document, got a second one; remove what follows the line ---"};
  }
  return builder.root();
}

}  // namespace

std::size_t find_unprintable(std::string_view text) {
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto c = static_cast<unsigned char>(text[i]);
    if ((c < 0x20 && c != '\t' && c != '\n' && c != '\r') || c == 0x7F || text.substr(i, 3) == "\xEF\xBB\xBF")
      return i;
  }
  return std::string_view::npos;
}

namespace {

/// `parse` with every way to fail turned into an Error.
Result<ValuePtr> parse_or_error(std::string_view text, std::string_view name) {
  if (text.size() > kMaxFileBytes)
    return fail(ErrorCode::bad_input, std::string(name), "expected at most 16 MiB of YAML, got more");
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  if (text.starts_with("\xFF\xFE") || text.starts_with("\xFE\xFF"))
    return fail(ErrorCode::bad_input, at(name, {1, 1}),
                "expected UTF-8 text, got UTF-16; save the file as UTF-8");
  const Lines lines(text);
  try {
    return parse(text, lines);
  } catch (const Refused& r) {
    return fail(ErrorCode::bad_input, at(name, r.place), r.message);
  } catch (const YAML::Exception& e) {
    const auto place = lines.place(e.mark);
    if (const auto tab = lines.tab_indent(place.line + 1); tab.line != 0)
      return fail(ErrorCode::bad_input, at(name, tab), "expected spaces as indentation, got a tab");
    return fail(ErrorCode::bad_input, at(name, place), "expected YAML, got something else: " + e.msg);
  }
}

/// As if every place in it were `--set`.
ValuePtr without_places(const ValuePtr& v) {
  auto copy = std::make_shared<Value>(*v);
  copy->place = {};
  for (auto& e : copy->entries) e.key_place = {}, e.value = without_places(e.value);
  for (auto& i : copy->items) i = without_places(i);
  return copy;
}

Result<ValuePtr> override_value(const ConfigOverride& o, const std::string& where) {
  auto v = std::make_shared<Value>();
  v->kind = Value::Kind::scalar;
  if (o.value.empty()) {
    v->quoted = true;
    return v;
  }
  // Parsed behind a key, so that a value means what it means in a file.
  auto read = parse_or_error("v: " + o.value, "v");
  const Value* root = read && *read ? read->get() : nullptr;
  if (!root || root->kind != Value::Kind::map || root->entries.size() != 1)
    return fail(
        ErrorCode::bad_input, where,
        "expected a YAML value after the =, got '" + o.value + "'; quote text that has special characters");
  return without_places(root->entries.front().value);
}

std::vector<std::string> split_path(std::string_view path) {
  std::vector<std::string> parts;
  for (std::size_t start = 0;;) {
    const auto dot = path.find('.', start);
    parts.emplace_back(path.substr(start, dot - start));
    if (dot == std::string_view::npos) return parts;
    start = dot + 1;
  }
}

std::string join(const std::vector<std::string>& parts, std::size_t count) {
  std::string s;
  for (std::size_t i = 0; i < count; ++i) s += (i ? "." : "") + parts[i];
  return s;
}

Result<ValuePtr> set_at(const ValuePtr& here, const std::vector<std::string>& parts, std::size_t depth,
                        const ValuePtr& leaf, const std::string& where) {
  if (depth == parts.size()) return leaf;
  auto copy = here ? std::make_shared<Value>(*here) : std::make_shared<Value>();
  const auto& key = parts[depth];
  if (copy->kind == Value::Kind::null) {
    copy->kind = Value::Kind::map;
    if (!here) copy->place = {};
  }
  if (copy->kind == Value::Kind::map) {
    for (auto& e : copy->entries) {
      if (e.key != key) continue;
      auto child = set_at(e.value, parts, depth + 1, leaf, where);
      if (!child) return child;
      e.value = *child;
      return copy;
    }
    auto child = set_at(nullptr, parts, depth + 1, leaf, where);
    if (!child) return child;
    copy->entries.push_back({key, true, {}, *child});
    return copy;
  }
  if (copy->kind == Value::Kind::list) {
    std::size_t index = 0;
    const auto [end, ec] = std::from_chars(key.data(), key.data() + key.size(), index);
    if (ec != std::errc{} || end != key.data() + key.size() || index >= copy->items.size())
      return fail(ErrorCode::bad_input, where,
                  join(parts, depth) + ": expected the index of one of its " +
                      std::to_string(copy->items.size()) + " items, counted from 0, got '" + key + "'");
    auto child = set_at(copy->items[index], parts, depth + 1, leaf, where);
    if (!child) return child;
    copy->items[index] = *child;
    return copy;
  }
  return fail(
      ErrorCode::bad_input, where,
      join(parts, depth) + ": expected a map or a list to set '" + key + "' in, got " + describe(*copy));
}

void quote(std::string& out, std::string_view s) {
  static constexpr char kHex[] = "0123456789abcdef";
  out += '"';
  for (const char c : s) {
    const auto u = static_cast<unsigned char>(c);
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (c == '\n') {
      out += "\\n";
    } else if (c == '\t') {
      out += "\\t";
    } else if (u < 0x20 || u == 0x7F) {
      out += "\\x";
      out += kHex[u >> 4];
      out += kHex[u & 15];
    } else {
      out += c;
    }
  }
  out += '"';
}

/// Numbers, flags and simple words. All else is text, and stays so in quotes; without them it may mean
/// something where it did not before (a `-` is text in a flow list and an item in a block).
bool safe_without_quotes(std::string_view s) {
  const auto word = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  };
  if (s.empty() || s == "...") return false;
  for (const char c : s)
    if (!word(c) && c != '.' && c != '+' && c != '-' && c != '/') return false;
  return s.front() != '-' || (s.size() > 1 && (word(s[1]) || s[1] == '.'));
}

void write_scalar(std::string& out, std::string_view text, bool quoted) {
  if (quoted || !safe_without_quotes(text))
    quote(out, text);
  else
    out += text;
}

void write(std::string& out, const Value& v, std::size_t indent) {
  const auto child = [&](const Value& c) {
    const bool block = (c.kind == Value::Kind::map && !c.entries.empty()) ||
                       (c.kind == Value::Kind::list && !c.items.empty());
    out += block ? '\n' : ' ';
    write(out, c, indent + 2);
  };
  const std::string pad(indent, ' ');
  switch (v.kind) {
    case Value::Kind::null:
      out += "null\n";
      break;
    case Value::Kind::scalar:
      write_scalar(out, v.text, v.quoted);
      out += '\n';
      break;
    case Value::Kind::map:
      if (v.entries.empty()) out += "{}\n";
      for (const auto& e : v.entries) {
        out += pad;
        write_scalar(out, e.key, e.key_quoted);
        out += ':';
        child(*e.value);
      }
      break;
    case Value::Kind::list:
      if (v.items.empty()) out += "[]\n";
      for (const auto& i : v.items) {
        out += pad + "-";
        child(*i);
      }
      break;
  }
}

}  // namespace

bool is_null_word(std::string_view plain) noexcept {
  return plain.empty() || plain == "~" || plain == "null" || plain == "Null" || plain == "NULL";
}

Result<ValuePtr> read_tree(std::string_view text, std::string_view name) {
  auto root = parse_or_error(text, name);
  if (!root) return root;
  if (!*root || (*root)->kind == Value::Kind::null)
    return fail(ErrorCode::bad_input, at(name, {1, 1}), "expected keys and values, got an empty file");
  if ((*root)->kind != Value::Kind::map)
    return fail(ErrorCode::bad_input, at(name, (*root)->place),
                "expected keys and values (key: value), got " + describe(**root));
  return root;
}

Result<ValuePtr> apply_override(const ValuePtr& root, const ConfigOverride& override) {
  const std::string where = "--set " + override.path + "=" + override.value;
  try {  // a value is checked when it is read as YAML; the path becomes keys as it stands
    check_characters(override.path, Lines(override.path));
  } catch (const Refused& r) {
    return fail(ErrorCode::bad_input, where, r.message);
  }
  auto leaf = override_value(override, where);
  if (!leaf) return leaf;
  const std::vector<std::string> path = split_path(override.path);
  if (path.size() + (*leaf)->depth > kMaxDepth)
    return fail(ErrorCode::bad_input, "--set",
                "expected a path and a value that nest at most " + std::to_string(kMaxDepth) +
                    " levels deep together, got " + std::to_string(path.size() + (*leaf)->depth));
  return set_at(root, path, 0, *leaf, where);
}

std::string describe(const Value& v) {
  switch (v.kind) {
    case Value::Kind::null:
      return "nothing";
    case Value::Kind::map:
      return "a map";
    case Value::Kind::list:
      return "a list of " + std::to_string(v.items.size());
    case Value::Kind::scalar:
      break;
  }
  std::string_view s = v.text;
  std::string out;
  if (s.size() > 60) {
    std::size_t n = 57;
    while (n > 0 && is_continuation(s[n])) --n;
    quote(out, s.substr(0, n));
    out.insert(out.size() - 1, "...");
    return out;
  }
  quote(out, s);
  // A plain scalar is shown as it stands, so that `5` and `"5"` can be told apart.
  return v.quoted || out.size() != s.size() + 2 ? out : std::string(s);
}

std::string write_yaml(const Value& value) {
  std::string out;
  write(out, value, 0);
  return out;
}

}  // namespace rigor::config
