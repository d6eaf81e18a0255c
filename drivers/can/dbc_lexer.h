// Words, numbers, quoted texts and marks of a DBC file, with their places.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "rt-core/result.h"

namespace rigor::can {

/// Thrown within the parser and caught at its edge.
struct DbcError {
  Error error;
};

struct DbcToken {
  enum class Kind : std::uint8_t { word, number, text, mark, end } kind = Kind::end;
  std::string_view text;  ///< of a quoted text what is between the quotes, escapes as they stand
  std::uint32_t line = 1, column = 1;
  bool first_of_line = false;
  [[nodiscard]] bool is(std::string_view s) const noexcept {
    return (kind == Kind::word || kind == Kind::mark) && text == s;
  }
};

class DbcLexer {
 public:
  DbcLexer(std::string_view text, std::string_view name);

  [[nodiscard]] const DbcToken& peek() const noexcept { return token_; }
  DbcToken take();
  [[nodiscard]] bool accept(std::string_view mark);
  void expect(std::string_view mark);
  [[nodiscard]] std::string word(std::string_view what);
  [[nodiscard]] std::string quoted(std::string_view what);  ///< as UTF-8
  [[nodiscard]] double number(std::string_view what);       ///< with its sign
  [[nodiscard]] std::uint64_t whole(std::string_view what, std::uint64_t most);
  [[nodiscard]] std::int64_t whole_signed(std::string_view what);
  [[noreturn]] void fail_at(const DbcToken& t, std::string_view expected) const;
  [[noreturn]] void fail_at(const DbcToken& t, std::string_view expected, std::string_view got) const;

 private:
  void advance();
  void skip_space();
  char step() noexcept;
  [[nodiscard]] char now() const noexcept { return at_ < text_.size() ? text_[at_] : '\0'; }
  [[nodiscard]] char next() const noexcept { return at_ + 1 < text_.size() ? text_[at_ + 1] : '\0'; }

  std::string_view text_, name_;
  std::size_t at_ = 0;
  std::uint32_t line_ = 1, column_ = 1;
  std::uint32_t last_line_ = 0;
  DbcToken token_;
};

}  // namespace rigor::can
