#include "sim/gis/expression.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>

namespace rigor::gis {

namespace {
constexpr int kDeepest = 64;  // parentheses and signs within each other

bool is_digit(char c) { return c >= '0' && c <= '9'; }
/// Letters of any script: bytes of UTF-8 beyond ASCII.
bool begins_name(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_' ||
         static_cast<unsigned char>(c) >= 0x80;
}
}  // namespace

// Sums of products of factors, each by a function of its own.
class ExpressionParser {
 public:
  explicit ExpressionParser(std::string_view text) : text_(text) {}

  Result<Expression> parse() {
    if (auto s = sum(0); !s) return tl::unexpected(s.error());
    if (skip_blanks(); at_ != text_.size()) return expected("+ - * / or the end");
    return std::move(out_);
  }

 private:
  using Op = Expression::Op;

  Status sum(int depth) {
    if (auto s = product(depth); !s) return s;
    while (const char op = one_of("+-")) {
      if (auto s = product(depth); !s) return s;
      out_.steps_.push_back({op == '+' ? Op::add : Op::subtract});
    }
    return {};
  }
  Status product(int depth) {
    if (auto s = factor(depth); !s) return s;
    while (const char op = one_of("*/")) {
      if (auto s = factor(depth); !s) return s;
      out_.steps_.push_back({op == '*' ? Op::multiply : Op::divide});
    }
    return {};
  }
  Status factor(int depth) {
    if (depth > kDeepest) return expected("fewer parentheses");
    if (const char sign = one_of("+-")) {
      if (auto s = factor(depth + 1); !s) return s;
      if (sign == '-') out_.steps_.push_back({Op::negate});
      return {};
    }
    if (one_of("(")) {
      if (auto s = sum(depth + 1); !s) return s;
      return one_of(")") ? Status{} : expected("a closing parenthesis");
    }
    if (one_of("[")) {
      const auto end = text_.find(']', at_);
      if (end == std::string_view::npos) return expected("a closing bracket after the name of a column");
      return column(std::exchange(at_, end + 1), end);
    }
    skip_blanks();
    if (at_ < text_.size() && (is_digit(text_[at_]) || text_[at_] == '.')) return number();
    std::size_t end = at_;
    while (end < text_.size() &&
           (begins_name(text_[end]) || (end > at_ && (is_digit(text_[end]) || text_[end] == '.'))))
      ++end;
    if (end == at_) return expected("a number, the name of a column, or (");
    return column(std::exchange(at_, end), end);
  }
  Status number() {
    double x = 0;
    const auto [end, error] = std::from_chars(text_.data() + at_, text_.data() + text_.size(), x);
    if (error != std::errc{} || !std::isfinite(x)) return expected("a number");
    at_ = static_cast<std::size_t>(end - text_.data());
    out_.steps_.push_back({Op::number, x});
    return {};
  }
  Status column(std::size_t begin, std::size_t end) {
    const std::string name(text_.substr(begin, end - begin));
    if (name.empty()) return expected("the name of a column");
    auto& all = out_.columns_;
    const auto it = std::find(all.begin(), all.end(), name);
    out_.steps_.push_back({Op::column, 0, static_cast<std::size_t>(it - all.begin())});
    if (it == all.end()) all.push_back(name);
    return {};
  }
  void skip_blanks() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t')) ++at_;
  }
  char one_of(std::string_view these) {
    skip_blanks();
    if (at_ >= text_.size() || these.find(text_[at_]) == std::string_view::npos) return '\0';
    return text_[at_++];
  }
  [[nodiscard]] tl::unexpected<Error> expected(std::string_view what) const {
    return fail(ErrorCode::bad_input, "",
                at_ < text_.size()
                    ? fmt::format("expected {} at '{}' of '{}'", what, text_.substr(at_), text_)
                    : fmt::format("expected {} at the end of '{}'", what, text_));
  }

  std::string_view text_;
  std::size_t at_ = 0;
  Expression out_;
};

Result<Expression> Expression::parse(std::string_view text) { return ExpressionParser(text).parse(); }

double Expression::value(const std::function<double(std::size_t)>& cell) const {
  std::vector<double> stack;
  for (const Step& s : steps_) {
    if (s.op == Op::number || s.op == Op::column) {
      stack.push_back(s.op == Op::number ? s.number : cell(s.column));
      continue;
    }
    if (s.op == Op::negate) {
      stack.back() = -stack.back();
      continue;
    }
    const double right = stack.back();
    stack.pop_back();
    double& left = stack.back();
    if (s.op == Op::add) left += right;
    if (s.op == Op::subtract) left -= right;
    if (s.op == Op::multiply) left *= right;
    if (s.op == Op::divide) left /= right;
  }
  return std::isfinite(stack.back()) ? stack.back() : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace rigor::gis
