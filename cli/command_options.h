// Options of a command, as its own file declares them. A front of CLI11 with just what the commands need:
// CLI11's header alone takes longer to compile than most of the commands, so one source file includes it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace rigor {

/// An option that was added; the calls say what it takes. Values that are not of that kind end the command
/// with a message and the status of bad input.
class CommandOption {
 public:
  CommandOption required(bool yes = true) const;
  CommandOption positive() const;
  CommandOption not_negative() const;
  CommandOption between(int from, int to) const;
  /// A file that may be one that Rigor comes with (installed_configs.h).
  CommandOption config_file() const;
  CommandOption one_of(const std::vector<std::string>& names) const;
  CommandOption excludes(const CommandOption& other) const;
  /// Of several values: one for each time that it is given, so that arguments may follow.
  CommandOption one_each() const;

 private:
  friend class CommandOptions;
  explicit CommandOption(CLI::Option* option) : option_(option) {}
  CLI::Option* option_;
};

/// A subcommand. Values must outlive the parsing: they are written while it goes on. Setup only.
class CommandOptions {
 public:
  CommandOptions(CLI::App& parent, const std::string& name, const std::string& what_it_does);

  CommandOption add_option(const std::string& names, std::string& value, const std::string& what);
  CommandOption add_option(const std::string& names, std::filesystem::path& value, const std::string& what);
  CommandOption add_option(const std::string& names, double& value, const std::string& what);
  CommandOption add_option(const std::string& names, int& value, const std::string& what);
  CommandOption add_option(const std::string& names, std::vector<std::string>& values,
                           const std::string& what);
  CommandOption add_option(const std::string& names, std::vector<std::filesystem::path>& values,
                           const std::string& what);
  CommandOption add_flag(const std::string& names, bool& value, const std::string& what);
  /// One that is there already. Throws where there is none: a slip of the programmer.
  [[nodiscard]] CommandOption get_option(const std::string& name) const;
  void footer(const std::string& text);
  [[nodiscard]] bool parsed() const;

 private:
  CLI::App* app_;
};

}  // namespace rigor
