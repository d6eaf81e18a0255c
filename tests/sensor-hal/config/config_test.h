// What the tests of the configuration share.
#pragma once

#include <gtest/gtest.h>

#include <string>

#include "sensor-hal/config/yaml.h"

namespace rigor {

inline ConfigNode parsed(std::string_view text, const std::vector<ConfigOverride>& overrides = {}) {
  auto n = ConfigDocument::parse(text, "rig.yaml", overrides);
  EXPECT_TRUE(n.has_value()) << (n ? "" : n.error().text());
  return n ? *n : ConfigNode();
}

/// The whole message of a text that is refused, or of reading that is.
inline std::string refusal(std::string_view text, const std::vector<ConfigOverride>& overrides = {}) {
  const auto n = ConfigDocument::parse(text, "rig.yaml", overrides);
  if (n) return "(accepted)";
  EXPECT_EQ(n.error().exit_status(), 2);
  return n.error().text();
}
template <class F>
std::string complaint(F&& read) {
  const auto r = catch_config([&] {
    read();
    return 0;
  });
  if (r) return "(accepted)";
  EXPECT_EQ(r.error().code, ErrorCode::bad_input);
  return r.error().text();
}

}  // namespace rigor
