#include "cli/command_options.h"

#include <CLI/CLI.hpp>

namespace rigor {

CommandOption CommandOption::required(bool yes) const {
  option_->required(yes);
  return *this;
}
CommandOption CommandOption::positive() const {
  option_->check(CLI::PositiveNumber);
  return *this;
}
CommandOption CommandOption::not_negative() const {
  option_->check(CLI::NonNegativeNumber);
  return *this;
}
CommandOption CommandOption::between(int from, int to) const {
  option_->check(CLI::Range(from, to));
  return *this;
}
CommandOption CommandOption::one_of(const std::vector<std::string>& names) const {
  option_->check(CLI::IsMember(names));
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
  return CommandOption(app_->add_option(names, value, what));
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
