// Small expressions over the columns of a row, for units and for values that a table spreads over columns:
//
//   d_cm * 0.01          girth_cm / 314.159          (d1_mm + d2_mm) / 2000          450000 + [x (local)]
//
// Numbers, names of columns, + - * /, signs, parentheses. A name that is no word stands in brackets. A cell
// that is empty makes the whole unknown.
#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"

namespace rigor::gis {

class Expression {
 public:
  /// bad_input: what was expected, and where in the text. Whether the columns exist is the caller's to say.
  [[nodiscard]] static Result<Expression> parse(std::string_view text);

  /// Each once, in the order in which they come.
  [[nodiscard]] const std::vector<std::string>& columns() const noexcept { return columns_; }
  /// `cell(i)`: of columns()[i], NaN where unknown. NaN where one is unknown or the result is not finite.
  [[nodiscard]] double value(const std::function<double(std::size_t)>& cell) const;

 private:
  friend class ExpressionParser;
  enum class Op : std::uint8_t { number, column, add, subtract, multiply, divide, negate };
  struct Step {
    Op op = Op::number;
    double number = 0;
    std::size_t column = 0;
  };
  std::vector<Step> steps_;  ///< postfix
  std::vector<std::string> columns_;
};

}  // namespace rigor::gis
