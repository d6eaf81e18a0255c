// Parts of a report that need no run: plots and the command line.
#include <gmock/gmock.h>

#include <nlohmann/json.hpp>

#include "bench/page/svg.h"
#include "bench/report/typed_command.h"

namespace rigor {
namespace {

using ::testing::ContainsRegex;
using ::testing::HasSubstr;
using ::testing::Not;

TEST(TypedCommand, IsAsAShellTakesIt) {
  EXPECT_EQ(quoted_command({"rigor", "run", "my rig.yaml", "--set", "a=it's", ""}),
            "rigor run 'my rig.yaml' --set 'a=it'\\''s' ''");
}

TEST(TypedCommand, LeavesTheTokenOut) {
  EXPECT_EQ(quoted_command({"rigor", "run", "r.yaml", "--live-token", "sesame", "--json"}),
            "rigor run r.yaml --live-token ... --json");
  EXPECT_EQ(quoted_command({"rigor", "run", "r.yaml", "--live-token=sesame"}),
            "rigor run r.yaml --live-token=...");
}

TEST(Plots, ColourLegendsAsTheirLines) {
  const std::string s =
      svg_lines({{"bias", "var(--series-1)", {0, 1}, {0, 2}}, {"a < b", "var(--series-2)", {0, 1}, {1, 3}}},
                "time [s]", "px");
  for (const char* colour : {"var(--series-1)", "var(--series-2)"}) {
    EXPECT_THAT(s, HasSubstr(std::string("style=\"stroke:") + colour));
    EXPECT_THAT(s, HasSubstr(std::string("style=\"fill:") + colour));
  }
  EXPECT_THAT(s, HasSubstr("data-name=\"a &lt; b\""));
  EXPECT_THAT(s, HasSubstr("data-range=\"0 1 "));
}

TEST(Plots, HistogramBarsBeyondTheLimitStandOut) {
  const nlohmann::json h{
      {"p50_ns", 1000}, {"p99_ns", 100000}, {"buckets", {{900, 1100, 50}, {90000, 110000, 1}}}};
  EXPECT_THAT(svg_histogram(h, "x"), Not(HasSubstr("bar beyond")));
  const std::string s = svg_histogram(h, "x", 10000);
  EXPECT_THAT(s, ContainsRegex("class=\"bar\"[^>]*><title>50 times"));
  EXPECT_THAT(s, ContainsRegex("class=\"bar beyond\"[^>]*><title>1 times"));
  EXPECT_THAT(s, HasSubstr(">limit</text>"));
}

}  // namespace
}  // namespace rigor
