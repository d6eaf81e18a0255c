#include "sim/render/engine/content_window.h"

#include <gtest/gtest.h>

#include "sim/render/models/providers.h"
#include "sim/world/semantic_types.h"

namespace rigor::render {
namespace {

using Eigen::Vector3d;

TEST(ContentWindow, TimeGoesFromItsBeginToItsEndAndNoFurther) {
  ContentWindow w;
  w.begin = BenchTime{} + milliseconds(40);
  EXPECT_EQ(w.time_of(w.begin + milliseconds(5)), 0) << "one instant";
  w.end = w.begin + milliseconds(200);
  EXPECT_DOUBLE_EQ(w.time_of(w.begin), 0);
  EXPECT_DOUBLE_EQ(w.time_of(w.begin + milliseconds(50)), 0.25);
  EXPECT_DOUBLE_EQ(w.time_of(w.end), 1);
  EXPECT_DOUBLE_EQ(w.time_of(w.begin - milliseconds(1)), 0);
  EXPECT_DOUBLE_EQ(w.time_of(w.end + milliseconds(1)), 1);
}

TEST(StillContent, GivesOneFrameWhateverIsAsked) {
  auto frame = std::make_shared<const ContentFrame>();
  StillContent content(frame);
  const auto w = content.collect({}, BenchTime{}, BenchTime{} + milliseconds(10), 5);
  ASSERT_EQ(w->frames.size(), 1U);
  EXPECT_EQ(&w->first(), frame.get());
  EXPECT_TRUE(content.T_world_node(NodeId{1}, BenchTime{}).isApprox(Eigen::Isometry3d::Identity()));
  EXPECT_EQ(content.type_name(NodeId{1}), "");
}

class MovingContent : public ::testing::Test {
 protected:
  MovingContent() {
    EXPECT_TRUE(world::define_semantic_types(*db));
    std::vector<std::shared_ptr<ContentProvider>> providers;
    providers.push_back(make_body_provider("."));
    view = std::make_unique<WorldView>(*db, std::move(providers));
  }
  NodeId add(const Vector3d& velocity_m_per_s) {
    const world::types::Body t(db->schema());
    auto tx = db->begin();
    const auto node = *tx.create(t.type);
    if (velocity_m_per_s.norm() > 0) {
      world::Motion motion;
      motion.velocity_m_per_s = velocity_m_per_s;
      EXPECT_TRUE(tx.set(node, t.motion, motion));
      EXPECT_TRUE(tx.set(node, t.moves, true));
    }
    EXPECT_TRUE(tx.commit());
    return node;
  }
  std::unique_ptr<world::Database> db = world::Database::create();
  std::unique_ptr<WorldView> view;
  const BenchTime begin = BenchTime{} + seconds(1), end = BenchTime{} + seconds(2);
};

TEST_F(MovingContent, WhatStandsIsOneBatchInAllFramesAndWhatMovesOneInEach) {
  const NodeId still = add({0, 0, 0}), moving = add({2, 0, 0});
  ViewContent content(*db, *view);
  const auto w = content.collect({}, begin, end, 3);
  ASSERT_EQ(w->frames.size(), 3U);
  int stands = 0, moves = 0;
  for (std::size_t i = 0; i < w->first().batches.size(); ++i) {
    const Batch& first = *w->first().batches[i];
    for (std::size_t k = 1; k < 3; ++k) {
      ASSERT_EQ(w->frames[k]->batches.size(), w->first().batches.size());
      const Batch& later = *w->frames[k]->batches[i];
      EXPECT_EQ(later.node, first.node);
      EXPECT_EQ(later.prototype, first.prototype);
      if (first.node == still) {
        EXPECT_EQ(&later, &first);
        ++stands;
      } else if (first.node == moving) {
        EXPECT_NEAR(later.bounds.center().x() - first.bounds.center().x(), 1.0 * static_cast<double>(k),
                    1e-6);
        ++moves;
      }
    }
  }
  EXPECT_EQ(stands, 2);
  EXPECT_EQ(moves, 2);
  EXPECT_NEAR(content.T_world_node(moving, end).translation().x() -
                  content.T_world_node(moving, begin).translation().x(),
              2, 1e-9);
  EXPECT_EQ(content.type_name(moving), "Body");
  EXPECT_EQ(content.type_name(NodeId{987654}), "");
  EXPECT_EQ(content.collect({}, begin, begin, 3)->frames.size(), 1U) << "an instant";
}

TEST_F(MovingContent, WhereNothingMovesThereIsOneFrame) {
  add({0, 0, 0});
  ViewContent content(*db, *view);
  EXPECT_EQ(content.collect({}, begin, end, 4)->frames.size(), 1U);
}

}  // namespace
}  // namespace rigor::render
