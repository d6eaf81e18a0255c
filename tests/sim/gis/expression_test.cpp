// Expressions over columns.
#include "sim/gis/expression.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace rigor::gis {
namespace {

double value(const std::string& text, const std::vector<double>& cells = {}) {
  const auto e = Expression::parse(text);
  EXPECT_TRUE(e) << (e ? "" : e.error().message);
  return e ? e->value([&](std::size_t i) { return cells.at(i); }) : std::numeric_limits<double>::quiet_NaN();
}
std::string refusal(const std::string& text) {
  const auto e = Expression::parse(text);
  return e ? "(accepted)" : e.error().message;
}

TEST(Expression, HasTheOrderOfArithmetic) {
  EXPECT_EQ(value("1 + 2 * 3"), 7);
  EXPECT_EQ(value("(1 + 2) * 3"), 9);
  EXPECT_EQ(value("10 - 4 - 3"), 3);
  EXPECT_EQ(value("12 / 3 / 2"), 2);
  EXPECT_EQ(value("-2 * -3 + -(1 - 5)"), 10);
  EXPECT_EQ(value("1e3*.5"), 500);
}

TEST(Expression, NamesColumns) {
  const auto e = Expression::parse("(d1_cm + d2_cm) / 2 * 0.01 + [height (m)] - d1_cm");
  ASSERT_TRUE(e);
  EXPECT_EQ(e->columns(), (std::vector<std::string>{"d1_cm", "d2_cm", "height (m)"}));
  EXPECT_DOUBLE_EQ(value("(d1 + d2) / 2 * 0.01", {30, 40}), 0.35);
  EXPECT_DOUBLE_EQ(value("Höhe*2", {3}), 6);
  EXPECT_DOUBLE_EQ(value("[a-b]+[c d]", {1, 2}), 3);
}

TEST(Expression, OfWhatIsNotKnownIsNotKnown) {
  EXPECT_TRUE(std::isnan(value("a * 2", {std::numeric_limits<double>::quiet_NaN()})));
  EXPECT_TRUE(std::isnan(value("1 / a", {0}))) << "no infinite sizes";
  EXPECT_TRUE(std::isnan(value("a * 1e300 * 1e300", {1})));
}

TEST(Expression, SaysWhereItBreaks) {
  EXPECT_EQ(refusal("d_cm *"), "expected a number, the name of a column, or ( at the end of 'd_cm *'");
  EXPECT_EQ(refusal("d_cm 0.01"), "expected + - * / or the end at '0.01' of 'd_cm 0.01'");
  EXPECT_EQ(refusal("(a + b"), "expected a closing parenthesis at the end of '(a + b'");
  EXPECT_EQ(refusal("[a"), "expected a closing bracket after the name of a column at 'a' of '[a'");
  EXPECT_EQ(refusal("a ** 2"), "expected a number, the name of a column, or ( at '* 2' of 'a ** 2'");
  EXPECT_NE(refusal(""), "(accepted)");
  EXPECT_NE(refusal("[]"), "(accepted)");
  EXPECT_NE(refusal("1.2.3"), "(accepted)");
  EXPECT_NE(refusal("1e999"), "(accepted)");
  EXPECT_NE(refusal(std::string(100000, '(')), "(accepted)") << "and does not run out of stack";
  EXPECT_NE(refusal(std::string(100000, '-') + "1"), "(accepted)");
}

}  // namespace
}  // namespace rigor::gis
