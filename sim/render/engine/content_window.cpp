#include "sim/render/engine/content_window.h"

#include <algorithm>

namespace rigor::render {

double ContentWindow::time_of(BenchTime t) const {
  if (end <= begin) return 0;
  return std::clamp(static_cast<double>((t - begin).ns()) / static_cast<double>((end - begin).ns()), 0.0,
                    1.0);
}

std::shared_ptr<const ContentWindow> StillContent::collect(const ContentQuery&, BenchTime begin,
                                                           BenchTime end, int) {
  auto window = std::make_shared<ContentWindow>();
  window->begin = begin;
  window->end = end;
  window->frames = {frame_};
  return window;
}
Eigen::Isometry3d StillContent::T_world_node(NodeId, BenchTime) const {
  return Eigen::Isometry3d::Identity();
}
std::string StillContent::type_name(NodeId) const { return ""; }

std::shared_ptr<const ContentWindow> ViewContent::collect(const ContentQuery& query, BenchTime begin,
                                                          BenchTime end, int instants) {
  auto window = std::make_shared<ContentWindow>();
  window->begin = begin;
  window->end = end;
  const int steps = end > begin ? std::max(instants, 1) : 1;
  for (int i = 0; i < steps; ++i) {
    ContentQuery at = query;
    at.t = steps == 1 ? begin : begin + (end - begin) * std::int64_t{i} / std::int64_t{steps - 1};
    auto frame = std::make_shared<const ContentFrame>(view_.collect(at));
    window->frames.push_back(std::move(frame));
  }
  const auto& frames = window->frames;
  const bool moved = std::any_of(frames.begin() + 1, frames.end(),
                                 [&](const auto& f) { return f->batches != frames.front()->batches; });
  if (!moved) window->frames.resize(1);
  return window;
}

Eigen::Isometry3d ViewContent::T_world_node(NodeId node, BenchTime t) const {
  const world::Snapshot snapshot = db_.snapshot();
  if (!snapshot.contains(node)) return Eigen::Isometry3d::Identity();
  return snapshot.T_world_node(node, t);
}

std::string ViewContent::type_name(NodeId node) const {
  const world::Snapshot snapshot = db_.snapshot();
  if (!snapshot.contains(node)) return "";
  return std::string(snapshot.schema().type(*snapshot.type_of(node)).name);
}

}  // namespace rigor::render
