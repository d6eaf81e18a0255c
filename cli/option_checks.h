// What options of the command line may hold. Includes CLI11: for the few files that declare options.
#pragma once

#include <CLI/CLI.hpp>

#include <string>
#include <vector>

namespace rigor {

struct NumberLimits {
  double min = 0, max = 0;
  bool exclusive_min = false;
};

/// As limits of configuration files: no option takes a number that is not finite, or larger.
inline constexpr double kMostOption = 1e12;
/// The longest run, in seconds.
inline constexpr double kLongestRun_s = 1e7;

/// "expected a number from 0 to 1e+07, got nan". CLI11's own ranges let nan pass and write numbers of 300
/// digits.
[[nodiscard]] CLI::Validator number_within(NumberLimits limits);

/// `--plugin FILE.so`, to commands that open a world (bench/world/world_plugins.h).
void add_plugins(CLI::App* app);

/// What is wrong with the first of the words that should name a command and names none, with the commands
/// that there are; empty where the words name one.
[[nodiscard]] std::string unknown_command(const CLI::App& app, const std::vector<std::string>& words);

}  // namespace rigor
