#include "drivers/can/dbc.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <map>
#include <unordered_map>

#include "drivers/can/can_bits.h"
#include "drivers/can/dbc_lexer.h"

namespace rigor::can {
namespace {

constexpr std::size_t kMostBytes = 64u << 20, kMostMessages = 65536, kMostSignals = 4096, kMostValues = 65536;
constexpr std::uint64_t kIndependent = 0xc0000000;  // VECTOR__INDEPENDENT_SIG_MSG: signals without a message

/// Words that begin a section. What begins with none of them is passed over up to one of them or a `;`.
constexpr std::string_view kSections[] = {"VERSION",
                                          "NS_",
                                          "BS_",
                                          "BU_",
                                          "BO_",
                                          "SG_",
                                          "VAL_TABLE_",
                                          "BO_TX_BU_",
                                          "EV_",
                                          "ENVVAR_DATA_",
                                          "EV_DATA_",
                                          "SGTYPE_",
                                          "CM_",
                                          "BA_DEF_",
                                          "BA_DEF_REL_",
                                          "BA_DEF_DEF_",
                                          "BA_DEF_DEF_REL_",
                                          "BA_",
                                          "BA_REL_",
                                          "VAL_",
                                          "SIG_GROUP_",
                                          "SIG_VALTYPE_",
                                          "SIG_TYPE_REF_",
                                          "SGTYPE_VAL_",
                                          "BA_DEF_SGTYPE_",
                                          "BA_SGTYPE_",
                                          "CAT_DEF_",
                                          "CAT_",
                                          "FILTER",
                                          "SG_MUL_VAL_",
                                          "BU_SG_REL_",
                                          "BU_EV_REL_",
                                          "BU_BO_REL_",
                                          "SIGTYPE_VALTYPE_",
                                          "NS_DESC_"};

bool is_section(const DbcToken& t) {
  return t.kind == DbcToken::Kind::word && t.first_of_line &&
         std::find(std::begin(kSections), std::end(kSections), t.text) != std::end(kSections);
}

/// The message-wide attributes that mean something here, by name.
struct Attribute {
  std::vector<std::string> choices;  ///< of an ENUM
  double fallback = 0;
};

class Parser {
 public:
  Parser(std::string_view text, std::string_view name) : lex_(text, name) { dbc_.name = std::string(name); }

  Dbc run() {
    while (lex_.peek().kind != DbcToken::Kind::end) statement();
    finish();
    return std::move(dbc_);
  }

 private:
  using Kind = DbcToken::Kind;

  void statement() {
    const DbcToken t = lex_.peek();
    if (t.is("VERSION")) {
      lex_.take();
      if (lex_.peek().kind == Kind::text) lex_.take();
    } else if (t.is("NS_")) {
      names();
    } else if (t.is("BU_")) {
      nodes();
    } else if (t.is("BO_")) {
      message();
    } else if (t.is("SG_")) {
      lex_.fail_at(t, "a message (`BO_`) in front of its signals", "`SG_`");
    } else if (t.is("VAL_TABLE_")) {
      value_table();
    } else if (t.is("VAL_")) {
      values();
    } else if (t.is("BO_TX_BU_")) {
      senders();
    } else if (t.is("SIG_VALTYPE_")) {
      value_type();
    } else if (t.is("SG_MUL_VAL_")) {
      multiplexed_values();
    } else if (t.is("BA_DEF_")) {
      attribute_definition();
    } else if (t.is("BA_DEF_DEF_")) {
      attribute_default();
    } else if (t.is("BA_")) {
      attribute();
    } else {
      skip();
    }
  }

  /// Over what is not ours: to the end of the statement, or to where the next one begins.
  void skip() {
    lex_.take();
    while (lex_.peek().kind != Kind::end && !is_section(lex_.peek()))
      if (lex_.take().is(";")) return;
  }
  void skip_statement() {
    while (lex_.peek().kind != Kind::end)
      if (lex_.take().is(";")) return;
  }

  void names() {  // NS_ : with names of sections, which are no sections here
    lex_.take();
    lex_.expect(":");
    while (lex_.peek().kind == Kind::word && !lex_.peek().is("BS_") && !lex_.peek().is("BU_")) {
      // A list that is not followed by BS_ ends where something comes that a list of names cannot hold.
      if (lex_.peek().is("BO_") || lex_.peek().is("VERSION")) return;
      lex_.take();
    }
  }

  void nodes() {
    lex_.take();
    lex_.expect(":");
    while (lex_.peek().kind == Kind::word && !is_section(lex_.peek())) {
      if (dbc_.nodes.size() >= kMostSignals * 16) lex_.fail_at(lex_.peek(), "no more nodes than 65536");
      dbc_.nodes.push_back(lex_.word("the name of a node"));
    }
  }

  struct Id {
    std::uint64_t number = 0;
    DbcToken at;
  };
  Id id() {
    Id i;
    i.at = lex_.peek();
    i.number = lex_.whole("a message's identifier", 0xffffffff);
    return i;
  }

  void message() {
    lex_.take();
    const Id i = id();
    Message m;
    places_.clear();
    m.extended = (i.number & 0x80000000u) != 0;
    m.id = static_cast<std::uint32_t>(i.number & kExtendedMask);
    const DbcToken at_name = lex_.peek();
    m.name = lex_.word("the name of a message");
    lex_.expect(":");
    m.length = static_cast<std::uint16_t>(lex_.whole("the message's length in bytes", 65535));
    if (lex_.peek().kind == Kind::word && !is_section(lex_.peek())) add_sender(m, lex_.word("a sender"));
    const bool independent = i.number == kIndependent || m.name == "VECTOR__INDEPENDENT_SIG_MSG";
    if (!independent) {
      if (!m.extended && i.number > kStandardMask)
        lex_.fail_at(i.at, "an identifier up to 2047, or one above 2147483648 for an extended one");
      if (m.extended && (i.number & 0x60000000u) != 0)
        lex_.fail_at(i.at, "an extended identifier of 29 bits, plus 2147483648");
      if (by_id_.contains(i.number)) lex_.fail_at(i.at, "an identifier that no message before has");
      if (by_name_.contains(m.name)) lex_.fail_at(at_name, "a name that no message before has");
    }
    while (lex_.peek().is("SG_")) signal(m, independent);
    if (independent) return;
    if (dbc_.messages.size() >= kMostMessages) lex_.fail_at(i.at, "at most 65536 messages", "one more");
    check_multiplexors(m);
    by_id_[i.number] = dbc_.messages.size();
    by_name_[m.name] = dbc_.messages.size();
    signal_places_.push_back(places_);
    dbc_.messages.push_back(std::move(m));
  }

  static void add_sender(Message& m, std::string node) {
    if (node == "Vector__XXX" || node == "VectorXXX") return;
    if (std::find(m.senders.begin(), m.senders.end(), node) == m.senders.end())
      m.senders.push_back(std::move(node));
  }

  void signal(Message& m, bool independent) {
    lex_.take();
    Signal s;
    const DbcToken at = lex_.peek();
    s.name = lex_.word("the name of a signal");
    if (m.index_of(s.name) >= 0) lex_.fail_at(at, "a name that no signal of this message has");
    if (lex_.peek().kind == Kind::word) multiplexing(s);
    lex_.expect(":");
    const DbcToken at_start = lex_.peek();
    s.start_bit = static_cast<std::uint16_t>(lex_.whole("the signal's start bit", 65535));
    lex_.expect("|");
    const DbcToken at_length = lex_.peek();
    s.length_bits = static_cast<std::uint16_t>(lex_.whole("the signal's length in bits", 65535));
    if (s.length_bits == 0) lex_.fail_at(at_length, "a signal of at least one bit", "`0`");
    lex_.expect("@");
    s.order =
        lex_.whole("a bit order, 0 (Motorola) or 1 (Intel)", 1) == 1 ? BitOrder::intel : BitOrder::motorola;
    if (lex_.accept("-"))
      s.is_signed = true;
    else
      lex_.expect("+");
    lex_.expect("(");
    const DbcToken at_factor = lex_.peek();
    s.factor = lex_.number("a factor");
    if (s.factor == 0) lex_.fail_at(at_factor, "a factor other than 0", "`0`");
    lex_.expect(",");
    s.offset = lex_.number("an offset");
    lex_.expect(")");
    lex_.expect("[");
    s.minimum = lex_.number("a minimum");
    lex_.expect("|");
    s.maximum = lex_.number("a maximum");
    lex_.expect("]");
    s.unit = lex_.quoted("a unit");
    while (lex_.peek().kind == Kind::word && !is_section(lex_.peek())) {
      (void)lex_.word("a receiver");
      if (!lex_.accept(",") && lex_.peek().kind == Kind::word && lex_.peek().first_of_line) break;
    }
    (void)lex_.accept(";");  // some tools end signals so
    if (independent) return;
    check_place(m, s, at_start);
    if (m.signals.size() >= kMostSignals) lex_.fail_at(at, "at most 4096 signals in a message", "one more");
    m.signals.push_back(std::move(s));
    places_.push_back(at);
  }

  void multiplexing(Signal& s) {
    const DbcToken t = lex_.take();
    std::string_view text = t.text;
    if (text == "M") {
      s.multiplexor = true;
      return;
    }
    std::uint64_t value = 0;
    std::size_t i = 1;
    bool good = text.size() > 1 && text[0] == 'm';
    for (; good && i < text.size() && text[i] >= '0' && text[i] <= '9'; ++i) {
      good = i < 12;
      value = value * 10 + static_cast<std::uint64_t>(text[i] - '0');
    }
    if (good && i + 1 == text.size() && text[i] == 'M') s.multiplexor = true, ++i;
    if (!good || i == 1 || i != text.size())
      lex_.fail_at(t, "`:`, or how the signal is multiplexed (`M`, `m3`, `m3M`)");
    s.shown.push_back({value, value});
    s.multiplexed_by = -2;  // by a multiplexor that is found when all signals of the message are known
  }

  void check_place(const Message& m, const Signal& s, const DbcToken& at) const {
    const unsigned bits = m.length * 8u;
    bool fits = s.length_bits <= 64;
    if (s.order == BitOrder::intel) {
      fits = fits && s.start_bit + unsigned{s.length_bits} <= bits;
    } else {
      // Bits from the start bit on in the order of transmission: byte by byte, each from its bit 7 down.
      const unsigned sent = s.start_bit / 8u * 8u + (7u - s.start_bit % 8u);
      fits = fits && sent + s.length_bits <= bits;
    }
    if (!fits)
      lex_.fail_at(
          at, "a signal of at most 64 bits within the " + std::to_string(m.length) + " bytes of " + m.name,
          s.name + " of " + std::to_string(s.length_bits) + " bits from bit " + std::to_string(s.start_bit));
  }

  void check_multiplexors(Message& m) const {
    int only = -1, count = 0;
    for (std::size_t i = 0; i < m.signals.size(); ++i)
      if (m.signals[i].multiplexor && m.signals[i].multiplexed_by == -1) only = static_cast<int>(i), ++count;
    for (auto& s : m.signals)
      if (s.multiplexed_by == -2 && count == 1) s.multiplexed_by = only;
    // Where there are several, SG_MUL_VAL_ has to say which is meant; see `finish`.
  }

  std::vector<ValueName> value_names() {
    std::vector<ValueName> out;
    while (!lex_.peek().is(";") && lex_.peek().kind != Kind::end) {
      if (out.size() >= kMostValues) lex_.fail_at(lex_.peek(), "at most 65536 values", "one more");
      ValueName v;
      v.raw = lex_.whole_signed("a raw value");
      v.text = lex_.quoted("the value's name");
      out.push_back(std::move(v));
    }
    lex_.expect(";");
    return out;
  }

  void value_table() {
    lex_.take();
    auto name = lex_.word("the name of a value table");
    tables_[std::move(name)] = value_names();
  }

  Message* find(std::uint64_t number) {
    const auto it = by_id_.find(number);
    return it == by_id_.end() ? nullptr : &dbc_.messages[it->second];
  }
  /// The signal that the next words name; nullptr where it belongs to no message.
  Signal* find_signal(Message*& m) {
    const Id i = id();
    const DbcToken at = lex_.peek();
    const auto name = lex_.word("the name of a signal");
    m = find(i.number);
    if (i.number == kIndependent) return nullptr;
    if (!m) lex_.fail_at(i.at, "the identifier of a message that the file has");
    const int index = m->index_of(name);
    if (index < 0) lex_.fail_at(at, "a signal of " + m->name);
    return &m->signals[static_cast<std::size_t>(index)];
  }

  void values() {
    lex_.take();
    if (lex_.peek().kind == Kind::word) return skip_statement();  // of an environment variable
    Message* m = nullptr;
    Signal* s = find_signal(m);
    std::vector<ValueName> names;
    if (lex_.peek().kind == Kind::word) {
      const DbcToken at = lex_.peek();
      const auto it = tables_.find(lex_.word("the name of a value table"));
      if (it == tables_.end()) lex_.fail_at(at, "a value table that stands above");
      names = it->second;
      lex_.expect(";");
    } else {
      names = value_names();
    }
    if (s) s->values = std::move(names);
  }

  void senders() {
    lex_.take();
    Message* m = find(id().number);
    lex_.expect(":");
    while (!lex_.peek().is(";") && lex_.peek().kind != Kind::end) {
      auto node = lex_.word("a node");
      if (m) add_sender(*m, std::move(node));
      (void)lex_.accept(",");
    }
    lex_.expect(";");
  }

  void value_type() {
    lex_.take();
    Message* m = nullptr;
    const DbcToken at = lex_.peek();
    Signal* s = find_signal(m);
    (void)lex_.accept(":");
    const auto type = lex_.whole("0 (integer), 1 (float) or 2 (double)", 2);
    lex_.expect(";");
    if (!s || type == 0) return;
    const unsigned bits = type == 1 ? 32 : 64;
    if (s->length_bits != bits)
      lex_.fail_at(at, "a signal of " + std::to_string(bits) + " bits, as its type has them",
                   s->name + " of " + std::to_string(s->length_bits));
    s->type = type == 1 ? RawType::float32 : RawType::float64;
  }

  void multiplexed_values() {
    lex_.take();
    Message* m = nullptr;
    Signal* s = find_signal(m);
    const DbcToken at = lex_.peek();
    const auto by = lex_.word("the name of a multiplexor");
    std::vector<Signal::MuxRange> shown;
    do {
      Signal::MuxRange r;
      r.first = lex_.whole("a value of the multiplexor", ~std::uint64_t{0});
      lex_.expect("-");
      r.last = lex_.whole("the last value of the range", ~std::uint64_t{0});
      if (r.last < r.first) std::swap(r.first, r.last);
      if (shown.size() >= kMostValues) lex_.fail_at(at, "at most 65536 ranges");
      shown.push_back(r);
      (void)lex_.accept(",");
    } while (!lex_.peek().is(";") && lex_.peek().kind != Kind::end);
    lex_.expect(";");
    if (!s) return;
    const int index = m->index_of(by);
    if (index < 0) lex_.fail_at(at, "a multiplexor of " + m->name);
    m->signals[static_cast<std::size_t>(index)].multiplexor = true;
    s->multiplexed_by = index;
    s->shown = std::move(shown);
    signal_places_[static_cast<std::size_t>(m - dbc_.messages.data())]
                  [static_cast<std::size_t>(s - m->signals.data())] = at;
  }

  void attribute_definition() {
    lex_.take();
    std::string object;
    if (lex_.peek().kind == Kind::word) object = lex_.word("a kind of object");
    if (lex_.peek().kind != Kind::text) return skip_statement();
    const auto name = lex_.quoted("the attribute's name");
    if ((object != "BO_" && object != "SG_") || !lex_.peek().is("ENUM")) return skip_statement();
    lex_.take();
    auto& choices = attributes_[name].choices;
    choices.clear();
    while (!lex_.peek().is(";") && lex_.peek().kind != Kind::end) {
      if (choices.size() >= kMostValues) lex_.fail_at(lex_.peek(), "at most 65536 choices");
      choices.push_back(lex_.quoted("a choice of the attribute"));
      (void)lex_.accept(",");
    }
    lex_.expect(";");
  }

  /// A value as a number: the index of an ENUM's choice.
  double attribute_value(const std::string& name) {
    if (lex_.peek().kind != Kind::text) return lex_.number("the attribute's value");
    const auto text = lex_.quoted("a value");
    const auto& choices = attributes_[name].choices;
    const auto it = std::find(choices.begin(), choices.end(), text);
    return it == choices.end() ? 0 : static_cast<double>(it - choices.begin());
  }

  static bool matters(const std::string& name) {
    return name == "GenMsgCycleTime" || name == "GenSigStartValue" || name == "VFrameFormat" ||
           name == "CANFD_BRS";
  }

  void attribute_default() {
    lex_.take();
    if (lex_.peek().kind != Kind::text) return skip_statement();
    const auto name = lex_.quoted("the attribute's name");
    if (!matters(name)) return skip_statement();
    attributes_[name].fallback = attribute_value(name);
    lex_.expect(";");
  }

  void attribute() {
    lex_.take();
    const auto name = lex_.quoted("the attribute's name");
    if (!matters(name)) return skip_statement();
    if (lex_.accept("BO_")) {
      Message* m = find(id().number);
      const double value = attribute_value(name);
      if (m) of_message_[static_cast<std::size_t>(m - dbc_.messages.data())][name] = value;
    } else if (lex_.accept("SG_")) {
      Message* m = nullptr;
      Signal* s = find_signal(m);
      const double value = attribute_value(name);
      if (s && name == "GenSigStartValue") s->start_raw = value, started_.insert({s, true});
    } else {
      return skip_statement();
    }
    lex_.expect(";");
  }

  [[nodiscard]] double of(std::size_t message, const std::string& name) const {
    if (const auto it = of_message_.find(message); it != of_message_.end())
      if (const auto v = it->second.find(name); v != it->second.end()) return v->second;
    const auto it = attributes_.find(name);
    return it == attributes_.end() ? 0 : it->second.fallback;
  }

  void finish() {
    for (std::size_t i = 0; i < dbc_.messages.size(); ++i) {
      Message& m = dbc_.messages[i];
      const double cycle_ms = of(i, "GenMsgCycleTime");
      if (cycle_ms > 0 && cycle_ms < 1e9) m.cycle = seconds_from(cycle_ms * 1e-3);
      frame_format(m, of(i, "VFrameFormat"));
      m.bit_rate_switch = m.fd && of(i, "CANFD_BRS") != 0;
      for (std::size_t k = 0; k < m.signals.size(); ++k) {
        Signal& s = m.signals[k];
        if (const auto it = attributes_.find("GenSigStartValue");
            it != attributes_.end() && !started_.contains(&s))
          s.start_raw = it->second.fallback;
        if (s.multiplexed_by == -2)
          lex_.fail_at(
              signal_places_[i][k],
              "a line SG_MUL_VAL_ or one multiplexor for the multiplexed signal " + s.name + " of " + m.name,
              "none, or several multiplexors");
      }
      check_chains(m, signal_places_[i]);
    }
  }

  void frame_format(Message& m, double value) const {
    m.fd = m.length > 8 && m.length <= 64;
    const auto it = attributes_.find("VFrameFormat");
    const auto index = static_cast<std::size_t>(value > 0 && value < 64 ? value : 0);
    if (it != attributes_.end() && index < it->second.choices.size())
      m.fd |= it->second.choices[index].find("FD") != std::string::npos;
    else
      m.fd |= index == 14 || index == 15;  // StandardCAN_FD, ExtendedCAN_FD in Vector's list
  }

  /// A multiplexor that selects itself, over others or not, would never be known; a chain that is too long
  /// would not be encoded.
  void check_chains(const Message& m, const std::vector<DbcToken>& places) const {
    const auto above = [&](int i) { return m.signals[static_cast<std::size_t>(i)].multiplexed_by; };
    for (std::size_t k = 0; k < m.signals.size(); ++k) {
      std::size_t steps = 0;
      int i = m.signals[k].multiplexed_by;
      for (; i >= 0 && steps <= kMostMultiplexors; i = above(i)) ++steps;
      if (steps <= kMostMultiplexors) continue;
      for (; i >= 0 && steps <= m.signals.size(); i = above(i)) ++steps;
      if (i >= 0)
        lex_.fail_at(
            places[k],
            "multiplexors of " + m.name + " that do not select each other in a circle, nor themselves",
            m.signals[k].name);
      lex_.fail_at(
          places[k],
          "at most " + std::to_string(kMostMultiplexors) + " multiplexors above a signal of " + m.name,
          std::to_string(steps) + " above " + m.signals[k].name);
    }
  }

  DbcLexer lex_;
  Dbc dbc_;
  std::unordered_map<std::uint64_t, std::size_t> by_id_;
  std::unordered_map<std::string, std::size_t> by_name_;
  std::unordered_map<std::string, std::vector<ValueName>> tables_;
  std::map<std::string, Attribute> attributes_;
  std::map<std::size_t, std::map<std::string, double>> of_message_;
  std::unordered_map<const Signal*, bool> started_;
  std::vector<DbcToken> places_;                      ///< of the signals of the message that is read
  std::vector<std::vector<DbcToken>> signal_places_;  ///< by message and signal: what said how it is selected
};

}  // namespace

bool Signal::shown_by(std::uint64_t raw) const noexcept {
  for (const auto& r : shown)
    if (raw >= r.first && raw <= r.last) return true;
  return false;
}

int Message::index_of(std::string_view signal) const noexcept {
  for (std::size_t i = 0; i < signals.size(); ++i)
    if (signals[i].name == signal) return static_cast<int>(i);
  return -1;
}

const Message* Dbc::message(std::string_view message_name) const noexcept {
  for (const auto& m : messages)
    if (m.name == message_name) return &m;
  return nullptr;
}

const Message* Dbc::message(std::uint32_t id, bool extended) const noexcept {
  for (const auto& m : messages)
    if (m.id == id && m.extended == extended) return &m;
  return nullptr;
}

Result<Dbc> parse_dbc(std::string_view text, std::string_view name) {
  if (text.size() > kMostBytes)
    return fail(ErrorCode::bad_input, std::string(name),
                "expected a DBC file of at most 64 MiB, got a larger one");
  try {
    return Parser(text, name).run();
  } catch (const DbcError& e) {
    return tl::unexpected<Error>(e.error);
  }
}

Result<Dbc> load_dbc(const std::filesystem::path& file) {
  std::error_code error;
  const auto size = std::filesystem::file_size(file, error);
  if (error)
    return fail(ErrorCode::not_found, file.string(), "expected a DBC file, got none: " + error.message());
  if (size > kMostBytes)
    return fail(ErrorCode::bad_input, file.string(),
                "expected a DBC file of at most 64 MiB, got a larger one");
  std::ifstream in(file, std::ios::binary);
  std::string text(std::istreambuf_iterator<char>(in), {});
  if (!in.good() && !in.eof()) return fail(ErrorCode::io, file.string(), "cannot be read");
  return parse_dbc(text, file.filename().string());
}

}  // namespace rigor::can
