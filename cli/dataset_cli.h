// `rigor dataset`: labelled data with ground truth (docs/datasets.md).
#pragma once

#include <memory>

namespace CLI {
class App;
}

namespace rigor {

class DatasetCommandLine {
 public:
  explicit DatasetCommandLine(CLI::App& app);
  ~DatasetCommandLine();
  [[nodiscard]] bool chosen() const;
  [[nodiscard]] int run() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
