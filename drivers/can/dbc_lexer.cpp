#include "drivers/can/dbc_lexer.h"

#include <charconv>
#include <cmath>

namespace rigor::can {
namespace {

bool is_digit(char c) noexcept { return c >= '0' && c <= '9'; }
bool is_word(char c) noexcept {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || is_digit(c) || c == '_' ||
         static_cast<unsigned char>(c) >= 0x80;  // names with umlauts are against the format, and about
}

bool is_utf8(std::string_view s) noexcept {
  for (std::size_t i = 0; i < s.size();) {
    const auto c = static_cast<unsigned char>(s[i]);
    const std::size_t more = c < 0x80                  ? 0
                             : (c >= 0xc2 && c < 0xe0) ? 1
                             : (c & 0xf0) == 0xe0      ? 2
                             : (c >= 0xf0 && c < 0xf5) ? 3
                                                       : 9;
    if (more == 9 || i + more >= s.size()) return false;
    for (std::size_t k = 1; k <= more; ++k)
      if ((static_cast<unsigned char>(s[i + k]) & 0xc0) != 0x80) return false;
    i += more + 1;
  }
  return true;
}

/// Windows-1252 is Latin-1 but for 0x80 to 0x9f, of which units and names have no use; those become U+FFFD.
std::string to_utf8(std::string_view s) {
  if (is_utf8(s)) return std::string(s);
  std::string out;
  for (const char ch : s) {
    const auto c = static_cast<unsigned char>(ch);
    if (c < 0x80) {
      out += ch;
    } else if (c == 0x80) {
      out += "\xe2\x82\xac";  // the euro sign
    } else if (c < 0xa0) {
      out += "\xef\xbf\xbd";
    } else {
      out += static_cast<char>(0xc0 | c >> 6);
      out += static_cast<char>(0x80 | (c & 0x3f));
    }
  }
  return out;
}

}  // namespace

DbcLexer::DbcLexer(std::string_view text, std::string_view name) : text_(text), name_(name) {
  if (text_.substr(0, 3) == "\xef\xbb\xbf") at_ = 3;
  advance();
}

char DbcLexer::step() noexcept {
  const char c = text_[at_++];
  if (c == '\n')
    ++line_, column_ = 1;
  else
    ++column_;
  return c;
}

void DbcLexer::skip_space() {
  while (at_ < text_.size()) {
    const char c = now();
    if (c == ' ' || c == '\t' || c == '\r' || c == '\n' || c == '\0') {
      step();
    } else if (c == '/' && next() == '/') {
      while (at_ < text_.size() && now() != '\n') step();
    } else if (c == '/' && next() == '*') {
      step(), step();
      while (at_ < text_.size() && !(now() == '*' && next() == '/')) step();
      if (at_ < text_.size()) step(), step();
    } else {
      return;
    }
  }
}

void DbcLexer::advance() {
  skip_space();
  token_ = {};
  token_.line = line_;
  token_.column = column_;
  token_.first_of_line = line_ != last_line_;
  last_line_ = line_;
  if (at_ >= text_.size()) return;
  const std::size_t from = at_;
  const char c = now();
  if (is_digit(c) || (c == '.' && is_digit(next()))) {
    token_.kind = DbcToken::Kind::number;
    if (c == '0' && (next() == 'x' || next() == 'X')) {
      step(), step();
      while (is_word(now())) step();
    } else {
      while (is_digit(now())) step();
      if (now() == '.') step();
      while (is_digit(now())) step();
      if (now() == 'e' || now() == 'E') {
        const char sign = next();
        const bool signed_exponent =
            (sign == '+' || sign == '-') && at_ + 2 < text_.size() && is_digit(text_[at_ + 2]);
        if (is_digit(sign) || signed_exponent) {
          step(), step();
          while (is_digit(now())) step();
        }
      }
    }
  } else if (is_word(c)) {
    token_.kind = DbcToken::Kind::word;
    while (is_word(now())) step();
  } else if (c == '"') {
    token_.kind = DbcToken::Kind::text;
    step();
    while (at_ < text_.size() && now() != '"') {
      if (now() == '\\' && next() == '"') step();
      step();
    }
    if (at_ >= text_.size()) {
      token_.kind = DbcToken::Kind::end;
      fail_at(token_, "a closing `\"` of the text that begins here", "the end of the file");
    }
    token_.text = text_.substr(from + 1, at_ - from - 1);
    step();
    return;
  } else {
    token_.kind = DbcToken::Kind::mark;
    step();
  }
  token_.text = text_.substr(from, at_ - from);
}

DbcToken DbcLexer::take() {
  const DbcToken t = token_;
  if (t.kind != DbcToken::Kind::end) advance();
  return t;
}

bool DbcLexer::accept(std::string_view mark) {
  if (!token_.is(mark)) return false;
  advance();
  return true;
}

void DbcLexer::expect(std::string_view mark) {
  if (!accept(mark)) fail_at(token_, "`" + std::string(mark) + "`");
}

std::string DbcLexer::word(std::string_view what) {
  if (token_.kind != DbcToken::Kind::word) fail_at(token_, what);
  return to_utf8(take().text);
}

std::string DbcLexer::quoted(std::string_view what) {
  if (token_.kind != DbcToken::Kind::text) fail_at(token_, std::string(what) + " in quotes");
  return to_utf8(take().text);
}

double DbcLexer::number(std::string_view what) {
  const DbcToken start = token_;
  const bool minus = accept("-");
  if (!minus) (void)accept("+");
  if (token_.kind == DbcToken::Kind::word &&
      (token_.text == "inf" || token_.text == "INF" || token_.text == "NAN"))
    fail_at(start, std::string(what) + ", a finite number");
  if (token_.kind != DbcToken::Kind::number)
    fail_at(minus ? start : token_, std::string(what) + ", a number");
  double value = 0;
  const auto t = token_.text;
  auto [end, error] = std::from_chars(t.data(), t.data() + t.size(), value);
  if (t.size() > 2 && (t[1] == 'x' || t[1] == 'X')) {
    std::uint64_t hex = 0;
    const auto read = std::from_chars(t.data() + 2, t.data() + t.size(), hex, 16);
    end = read.ptr, error = read.ec;
    value = static_cast<double>(hex);
  }
  if (error != std::errc{} || end != t.data() + t.size() || !std::isfinite(value))
    fail_at(token_, std::string(what) + ", a finite number");
  advance();
  return minus ? -value : value;
}

std::uint64_t DbcLexer::whole(std::string_view what, std::uint64_t most) {
  const auto t = token_.text;
  std::uint64_t value = 0;
  if (token_.kind == DbcToken::Kind::number) {
    const auto [end, error] = std::from_chars(t.data(), t.data() + t.size(), value);
    if (error == std::errc{} && end == t.data() + t.size() && value <= most) {
      advance();
      return value;
    }
  }
  fail_at(token_, std::string(what) + ", a whole number from 0 to " + std::to_string(most));
}

std::int64_t DbcLexer::whole_signed(std::string_view what) {
  const DbcToken start = token_;
  const bool minus = accept("-");
  if (!minus) (void)accept("+");
  const auto t = token_.text;
  std::uint64_t value = 0;
  if (token_.kind == DbcToken::Kind::number) {
    const auto [end, error] = std::from_chars(t.data(), t.data() + t.size(), value);
    if (error == std::errc{} && end == t.data() + t.size()) {
      advance();  // beyond 2^63 the bits stand for an unsigned value
      return static_cast<std::int64_t>(minus ? 0 - value : value);
    }
    // Some tools write raw values as 3.0.
    double d = 0;
    const auto read = std::from_chars(t.data(), t.data() + t.size(), d);
    if (read.ec == std::errc{} && read.ptr == t.data() + t.size() && std::fabs(d) < 9e15 &&
        d == std::floor(d)) {
      advance();
      return static_cast<std::int64_t>(minus ? -d : d);
    }
  }
  fail_at(start, std::string(what) + ", a whole number");
}

void DbcLexer::fail_at(const DbcToken& t, std::string_view expected) const {
  const std::string got = t.kind == DbcToken::Kind::end    ? "the end of the file"
                          : t.kind == DbcToken::Kind::text ? "\"" + to_utf8(t.text.substr(0, 40)) + "\""
                                                           : "`" + to_utf8(t.text.substr(0, 40)) + "`";
  fail_at(t, expected, got);
}

void DbcLexer::fail_at(const DbcToken& t, std::string_view expected, std::string_view got) const {
  throw DbcError{Error{ErrorCode::bad_input,
                       std::string(name_) + ":" + std::to_string(t.line) + ":" + std::to_string(t.column),
                       "expected " + std::string(expected) + ", got " + std::string(got)}};
}

}  // namespace rigor::can
