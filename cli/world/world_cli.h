// `rigor world …`: its subcommands and their options.
#pragma once

#include <memory>

namespace CLI {
class App;
}

namespace rigor {

class WorldCommandLine {
 public:
  explicit WorldCommandLine(CLI::App& app);
  ~WorldCommandLine();
  [[nodiscard]] bool chosen() const;
  [[nodiscard]] int run() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
