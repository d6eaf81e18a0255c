// `rigor sweep`: many runs of one rig (docs/sweep.md).
#pragma once

#include <memory>

namespace CLI {
class App;
}

namespace rigor {

class SweepCommandLine {
 public:
  explicit SweepCommandLine(CLI::App& app);
  ~SweepCommandLine();
  [[nodiscard]] bool chosen() const;
  [[nodiscard]] int run() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
