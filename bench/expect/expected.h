// How an expectation of a rig came out. Forms in which that is written: expected_forms.h.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace rigor {

/// How an expectation came out.
struct Expected {
  std::string of, quantity;  ///< "turntable.position", "value"
  std::string bounds;        ///< "from -45 to 45"
  bool holds = false;
  bool decided = true;  ///< false: the run goes on, and it may come out either way
  /// False: a recording does not contain it, so that it can neither hold nor be violated.
  bool known = true;
  std::uint64_t looked_at = 0;      ///< samples, commands, or 1
  std::uint64_t outside = 0;        ///< of these
  std::optional<double> first_s;    ///< the first that was outside, since the start of the run
  double minimum = 0, maximum = 0;  ///< where `looked_at` is not 0
  std::string detail;               ///< of the first that was outside, in words; may be empty
  std::string nothing;  ///< why nothing could be judged, where more is known than that nothing came
  /// "turntable.position: expected value from -45 to 45, got 0 to 47.2; 12 of 980, first at 3.120 s".
  [[nodiscard]] std::string sentence() const;
  /// "got 0 to 47.2; 12 of 980, first at 3.120 s".
  [[nodiscard]] std::string outcome() const;
  /// "turntable.position value from -45 to 45".
  [[nodiscard]] std::string name() const;
  [[nodiscard]] bool fails() const { return known && decided && !holds; }
  /// "holds", "violated", "undecided" or "unknown".
  [[nodiscard]] const char* state() const;
};

}  // namespace rigor
