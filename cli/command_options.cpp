#include "cli/command_options.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <cstdlib>

#include "bench/files/installed_configs.h"
#include "bench/world/world_plugins.h"
#include "cli/option_checks.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {

CLI::Validator number_within(NumberLimits limits) {
  return CLI::Validator(
      [limits](std::string& text) -> std::string {
        char* end = nullptr;
        const double x = std::strtod(text.c_str(), &end);
        const bool number = end != text.c_str() && *end == '\0';
        const bool inside = limits.exclusive_min ? x > limits.min : x >= limits.min;
        if (number && std::isfinite(x) && inside && x <= limits.max) return {};
        return limits.exclusive_min
                   ? fmt::format("expected a number above {:g} and up to {:g}, got {}", limits.min,
                                 limits.max, text)
                   : fmt::format("expected a number from {:g} to {:g}, got {}", limits.min, limits.max, text);
      },
      "");
}

std::string unknown_command(const CLI::App& app, const std::vector<std::string>& words) {
  const CLI::App* at = &app;
  for (const std::string& word : words) {
    std::vector<std::string> names;
    const CLI::App* next = nullptr;
    for (const CLI::App* sub : at->get_subcommands([](const CLI::App*) { return true; })) {
      if (sub->get_name() == word) next = sub;
      names.push_back(sub->get_name());
    }
    if (names.empty() || word.starts_with('-')) return {};
    if (!next) {
      return fmt::format("expected one of the commands {}, got \"{}\"{}", fmt::join(names, ", "), word,
                         did_you_mean(word, names));
    }
    at = next;
  }
  return {};
}

void add_plugins(CLI::App* app) {
  app->add_option_function<std::vector<std::string>>(
         "--plugin", &set_command_plugins,
         "Plugin of the world, a shared object that is loaded before the world (may be repeated)")
      ->type_name("FILE.so")
      ->allow_extra_args(false);
}

CommandOption CommandOption::required(bool yes) const {
  option_->required(yes);
  return *this;
}
CommandOption CommandOption::positive() const {
  option_->check(number_within({.min = 0, .max = kMostOption, .exclusive_min = true}));
  return *this;
}
CommandOption CommandOption::not_negative() const {
  option_->check(number_within({.min = 0, .max = kMostOption}));
  return *this;
}
CommandOption CommandOption::between(int from, int to) const {
  option_->check(CLI::Range(from, to));
  return *this;
}
CommandOption CommandOption::config_file() const {
  option_->transform(CLI::Validator(
      [](std::string& name) {
        name = find_config(name).string();
        return std::string();
      },
      ""));
  return *this;
}
CommandOption CommandOption::one_of(const std::vector<std::string>& names) const {
  option_->check(CLI::IsMember(names));
  return *this;
}
CommandOption CommandOption::one_each() const {
  option_->allow_extra_args(false);
  return *this;
}
CommandOption CommandOption::excludes(const CommandOption& other) const {
  option_->excludes(other.option_);
  return *this;
}

CommandOptions::CommandOptions(CLI::App& parent, const std::string& name, const std::string& what_it_does)
    : app_(parent.add_subcommand(name, what_it_does)) {}

CommandOption CommandOptions::add_option(const std::string& names, std::string& value,
                                         const std::string& what) {
  return CommandOption(app_->add_option(names, value, what));
}
CommandOption CommandOptions::add_option(const std::string& names, std::filesystem::path& value,
                                         const std::string& what) {
  return CommandOption(app_->add_option(names, value, what));
}
CommandOption CommandOptions::add_option(const std::string& names, double& value, const std::string& what) {
  return CommandOption(
      app_->add_option(names, value, what)->check(number_within({.min = -kMostOption, .max = kMostOption})));
}
CommandOption CommandOptions::add_option(const std::string& names, int& value, const std::string& what) {
  return CommandOption(app_->add_option(names, value, what));
}
CommandOption CommandOptions::add_option(const std::string& names, std::vector<std::string>& values,
                                         const std::string& what) {
  return CommandOption(app_->add_option(names, values, what));
}
CommandOption CommandOptions::add_option(const std::string& names, std::vector<std::filesystem::path>& values,
                                         const std::string& what) {
  return CommandOption(app_->add_option(names, values, what));
}
CommandOption CommandOptions::add_flag(const std::string& names, bool& value, const std::string& what) {
  return CommandOption(app_->add_flag(names, value, what));
}
CommandOption CommandOptions::get_option(const std::string& name) const {
  return CommandOption(app_->get_option(name));
}
void CommandOptions::footer(const std::string& text) { app_->footer(text); }
bool CommandOptions::parsed() const { return app_->parsed(); }

}  // namespace rigor
