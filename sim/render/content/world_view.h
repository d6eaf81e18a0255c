// A view of a world: keeps the providers up to date by the database's signals, and gives engines their
// content.
//
//   WorldView view(db, providers);          // world thread; subscribes
//   ContentFrame frame = view.collect(query);
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "sim/render/content/provider.h"
#include "sim/world/graph/database.h"

namespace rigor::render {

class WorldView {
 public:
  /// Builds every provider from the world as it stands. World thread; the database outlives the view.
  WorldView(world::Database& db, std::vector<std::shared_ptr<ContentProvider>> providers);
  ~WorldView();
  WorldView(const WorldView&) = delete;
  WorldView& operator=(const WorldView&) = delete;

  /// World thread.
  [[nodiscard]] ContentFrame collect(const ContentQuery& query);
  /// What could not be shown, provider by provider.
  [[nodiscard]] std::vector<std::string> warnings() const;

 private:
  std::vector<std::shared_ptr<ContentProvider>> providers_;
  world::Subscription subscription_;
};

}  // namespace rigor::render
