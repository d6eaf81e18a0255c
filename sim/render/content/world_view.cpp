#include "sim/render/content/world_view.h"

#include <utility>

namespace rigor::render {

WorldView::WorldView(world::Database& db, std::vector<std::shared_ptr<ContentProvider>> providers)
    : providers_(std::move(providers)) {
  const auto now = db.snapshot();
  for (const auto& p : providers_) p->rebuild(now);
  subscription_ = db.subscribe({}, [this](const world::ChangeSet& set, std::span<const world::Change>) {
    for (const auto& p : providers_) p->apply(set);
  });
}

WorldView::~WorldView() = default;

ContentFrame WorldView::collect(const ContentQuery& query) {
  ContentFrame frame;
  for (const auto& p : providers_) p->collect(query, frame);
  return frame;
}

std::vector<std::string> WorldView::warnings() const {
  std::vector<std::string> all;
  for (const auto& p : providers_)
    for (auto& w : p->warnings()) all.push_back(std::string(p->name()) + ": " + w);
  return all;
}

}  // namespace rigor::render
