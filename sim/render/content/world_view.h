// A view of a world: keeps the providers up to date by the database's signals, and gives engines their
// content.
//
//   WorldView view(db, providers);          // world thread; subscribes
//   ContentFrame frame = view.collect(query);
#pragma once

#include <list>
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

  /// World thread. Keeps the answers of providers that have a version: the queries that it was asked last
  /// cost nothing but what moves.
  [[nodiscard]] ContentFrame collect(const ContentQuery& query);
  /// What could not be shown, provider by provider.
  [[nodiscard]] std::vector<std::string> warnings() const;

 private:
  /// What a provider with a version answered.
  struct Answer {
    ContentQuery query;
    std::uint64_t version = 0;
    std::vector<std::shared_ptr<const Batch>> batches;
  };
  struct Part {
    std::shared_ptr<ContentProvider> provider;
    std::list<Answer> answers;  ///< the one that was asked for last comes first
  };
  std::vector<Part> parts_;
  world::Subscription subscription_;
};

}  // namespace rigor::render
