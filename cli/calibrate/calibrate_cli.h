// `rigor calibrate …`: its subcommands and their options.
#pragma once

#include <memory>

namespace CLI {
class App;
}

namespace rigor {

class CalibrateCommandLine {
 public:
  explicit CalibrateCommandLine(CLI::App& app);
  ~CalibrateCommandLine();
  [[nodiscard]] bool chosen() const;
  [[nodiscard]] int run() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
