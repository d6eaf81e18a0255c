#include "sim/render/content/world_view.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace rigor::render {
namespace {

/// Answers that are kept of each provider: for the sensors of a rig, on both sides of a cell's border.
constexpr std::size_t kAnswersKept = 8;

bool same_but_for_time(const ContentQuery& a, const ContentQuery& b) {
  return a.eye == b.eye && a.eye_reach_m == b.eye_reach_m && a.allowed_error_rad == b.allowed_error_rad &&
         a.far_m == b.far_m && a.full_within_m == b.full_within_m && a.shadow_reach_m == b.shadow_reach_m &&
         std::equal(a.frustum.begin(), a.frustum.end(), b.frustum.begin(), b.frustum.end(),
                    [](const auto& p, const auto& q) { return p.coeffs() == q.coeffs(); });
}

}  // namespace

WorldView::WorldView(world::Database& db, std::vector<std::shared_ptr<ContentProvider>> providers) {
  for (auto& p : providers) parts_.push_back({std::move(p), {}});
  const auto now = db.snapshot();
  for (const auto& p : parts_) p.provider->rebuild(now);
  subscription_ = db.subscribe({}, [this](const world::ChangeSet& set, std::span<const world::Change>) {
    for (const auto& p : parts_) p.provider->apply(set);
  });
}

WorldView::~WorldView() = default;

ContentFrame WorldView::collect(const ContentQuery& query) {
  ContentFrame frame;
  for (auto& [provider, answers] : parts_) {
    const std::uint64_t version = provider->version();
    if (version == 0) {
      provider->collect(query, frame);
      continue;
    }
    std::erase_if(answers, [&](const Answer& a) { return a.version != version; });
    auto kept = std::find_if(answers.begin(), answers.end(),
                             [&](const Answer& a) { return same_but_for_time(a.query, query); });
    if (kept == answers.end()) {
      ContentFrame part;
      provider->collect(query, part);
      kept = answers.insert(answers.begin(), {query, version, std::move(part.batches)});
      if (answers.size() > kAnswersKept) answers.pop_back();
    }
    answers.splice(answers.begin(), answers, kept);
    const auto& batches = answers.front().batches;
    frame.batches.insert(frame.batches.end(), batches.begin(), batches.end());
  }
  return frame;
}

std::vector<std::string> WorldView::warnings() const {
  std::vector<std::string> all;
  for (const auto& p : parts_)
    for (auto& w : p.provider->warnings()) all.push_back(std::string(p.provider->name()) + ": " + w);
  return all;
}

}  // namespace rigor::render
