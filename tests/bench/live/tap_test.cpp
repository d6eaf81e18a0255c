// What the live view takes from the loop, and what stands where in a world for those who point at it.
#include "bench/run/tap.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>
#include <set>

#include "bench/live/world_shapes.h"
#include "bench/live/world_values.h"
#include "sensor-hal/channel/event_text.h"
#include "sim/world/semantic_types.h"

#include <nlohmann/json.hpp>

namespace rigor::live {
namespace {

SampleLease sample_of(SamplePool& pool, std::uint64_t sequence) {
  SampleSlot s = pool.try_acquire();
  s->stamp.sequence = sequence;
  s->info = PointCloudInfo{};
  s->size_bytes = 4;
  std::memcpy(s->memory().data(), "abcd", 4);
  return s;
}

TEST(LiveTap, HandsOverOneSampleForEachThatIsAskedFor) {
  const auto pool = make_sample_pool(4, 16);
  LiveTap tap({{true, 16}, {false, 0}}, false);
  tap.sample(0, sample_of(*pool, 1));
  EXPECT_FALSE(tap.take(0)) << "nobody asked";
  EXPECT_EQ(pool->in_use(), 0u);
  tap.want(0);
  tap.sample(0, sample_of(*pool, 2));
  tap.sample(0, sample_of(*pool, 3));
  EXPECT_EQ(pool->in_use(), 1u) << "one was asked for, one is held";
  {
    const SampleLease got = tap.take(0);
    ASSERT_TRUE(got);
    EXPECT_EQ(got->stamp.sequence, 2u);
  }
  EXPECT_EQ(pool->in_use(), 0u);
  EXPECT_FALSE(tap.take(0));
}

TEST(LiveTap, HoldsNoSlotOfAChannelInVirtualTime) {
  const auto pool = make_sample_pool(1, 16);
  LiveTap tap({{true, 16}, {false, 0}}, true);
  tap.want(0);
  tap.sample(0, sample_of(*pool, 1));
  EXPECT_EQ(pool->in_use(), 0u);
  const SampleLease got = tap.take(0);
  ASSERT_TRUE(got);
  EXPECT_EQ(got->stamp.sequence, 1u);
  EXPECT_EQ(std::memcmp(got->bytes().data(), "abcd", 4), 0);
}

TEST(LiveTap, MakesEventsOfNotesAtTheCycleThatTakesThem) {
  LiveTap tap({{true, 16}, {false, 0}}, false);
  ASSERT_TRUE(tap.note(kEventWorldEdit, 7, "size_m = 2"));
  const SampleLease note = tap.next_note(BenchTime(123));
  ASSERT_TRUE(note);
  EXPECT_EQ(note->stamp.t_capture, BenchTime(123));
  EXPECT_EQ(note->as<EventInfo>()->code, kEventWorldEdit);
  EXPECT_STREQ(note->as<EventInfo>()->text.data(), "size_m = 2");
  EXPECT_FALSE(tap.next_note(BenchTime(124)));
  int taken = 0;
  while (taken < 1000 && tap.note(kEventWorldEdit, 7, "again")) ++taken;
  EXPECT_LT(taken, 1000) << "more than the ring holds are refused";
}

TEST(LiveBins, KnowPercentilesToHalfAnOctave) {
  LiveBins bins;
  for (int i = 0; i < 99; ++i) bins.record(microseconds(100));
  bins.record(milliseconds(10));
  bins.record(Duration(-5));
  const auto r = bins.read();
  EXPECT_EQ(r.total, 101u);
  EXPECT_EQ(r.count[0], 1u);
  EXPECT_GE(r.percentile_us(0.5), 100);
  EXPECT_LE(r.percentile_us(0.5), 100 * std::sqrt(2.0));
  EXPECT_EQ(r.percentile_us(1), 10'000);
  EXPECT_EQ(LiveBins{}.read().percentile_us(0.5), 0);
  for (const double us : {1.0, 1.41, 1.42, 2.0, 3.0, 1000.0, 1e6}) {  // each in the bin whose edges hold it
    LiveBins one;
    one.record(Duration(static_cast<std::int64_t>(us * 1e3)));
    const auto counts = one.read().count;
    const auto at = static_cast<std::size_t>(std::find(counts.begin(), counts.end(), 1u) - counts.begin());
    EXPECT_LE(LiveBins::lower_us(at), us * 1.0001);
    EXPECT_GT(LiveBins::lower_us(at + 1), us);
  }
}

class LiveShapes : public ::testing::Test {
 protected:
  LiveShapes() : db(world::Database::create()) {
    EXPECT_TRUE(world::define_semantic_types(*db));
    const world::types::Body body(db->schema());
    const world::types::Tree tree(db->schema());
    auto tx = db->begin();
    box = *tx.create(body.type);
    pole = *tx.create(body.type);
    oak = *tx.create(tree.type);
    world::Pose pose = world::Pose::Identity();
    pose.translation() = world::Vector3(5, 0, 1);
    EXPECT_TRUE(tx.set(box, body.pose, pose) && tx.set(box, body.size_m, world::Vector3(2, 2, 2)));
    pose.translation() = world::Vector3(5, 10, 1);
    EXPECT_TRUE(tx.set(pole, body.pose, pose) && tx.set(pole, body.shape, std::string("cylinder")) &&
                tx.set(pole, body.size_m, world::Vector3(1, 1, 2)));
    EXPECT_TRUE(tx.set(oak, tree.position, world::Vector3(20, 0, std::nan(""))) &&
                tx.set(oak, tree.dbh_m, 0.4) && tx.set(oak, tree.height_m, 20.0) &&
                tx.set(oak, tree.crown_base_m, 8.0) && tx.set(oak, tree.crown_radius_m, 3.0));
    EXPECT_TRUE(tx.commit());
    shapes = shapes_of(db->snapshot(), BenchTime(), ground, {});
  }
  std::optional<Hit> look(world::Vector3 from, const world::Vector3& to) const {
    return first_hit(shapes, from, (to - from).normalized(), ground, terrain);
  }
  std::unique_ptr<world::Database> db;
  world::NodeId box, pole, oak, terrain{999};
  std::vector<Shape> shapes;
  GroundHeight ground = [](double x, double) { return x > 100 ? std::nan("") : 0.0; };
};

TEST_F(LiveShapes, AreMetByRays) {
  ASSERT_EQ(shapes.size(), 3u);
  const world::Vector3 eye(0, 0, 1);
  auto hit = look(eye, {5, 0, 1});
  ASSERT_TRUE(hit);
  EXPECT_EQ(hit->node, box);
  EXPECT_NEAR(hit->distance_m, 4, 1e-9);
  hit = look({5, 0, 1.5}, {5, 10, 1.5});
  EXPECT_EQ(hit->node, box) << "from within";
  hit = look({0, 10, 1.5}, {5, 10, 1.5});
  EXPECT_EQ(hit->node, pole);
  EXPECT_NEAR(hit->distance_m, 4.5, 1e-9);
  EXPECT_EQ(look({0, 0, 5}, {20, 0, 5})->node, oak) << "its trunk, above the box";
  EXPECT_NEAR(look({0, 0, 5}, {20, 0, 5})->distance_m, 19.8, 1e-6);
  EXPECT_EQ(look({0, 2, 14}, {20, 2, 14})->node, oak) << "its crown";
  EXPECT_FALSE(look({0, 2, 5}, {20, 2, 5}) && look({0, 2, 5}, {20, 2, 5})->node == oak) << "under its crown";
  hit = look({-5, 0, 1}, {-6, 0, 0});
  ASSERT_TRUE(hit);
  EXPECT_EQ(hit->node, terrain);
  EXPECT_NEAR(hit->point_m.x(), -6, 0.02);
  EXPECT_FALSE(look(eye, {0, 0, 2})) << "the sky";
}

TEST_F(LiveShapes, AreFoundOnTheMap) {
  EXPECT_EQ(at_place(shapes, 5.9, 0.9, ground, terrain)->node, box);
  EXPECT_EQ(at_place(shapes, 5.4, 10, ground, terrain)->node, pole);
  EXPECT_EQ(at_place(shapes, 5.45, 10.45, ground, terrain)->node, terrain) << "beside the round one";
  EXPECT_EQ(at_place(shapes, 22, 1, ground, terrain)->node, oak) << "within its crown";
  EXPECT_FALSE(at_place(shapes, 200, 0, ground, terrain));
}

TEST_F(LiveShapes, ThatLieCoverTheGroundAlongTheirLength) {
  const world::types::Body body(db->schema());
  world::Pose pose = world::Pose::Identity();  // a trunk of 10 m along y, 0.2 m thick
  pose.translation() = world::Vector3(-20, 5, 0.1);
  pose.linear() = Eigen::AngleAxisd(-std::numbers::pi / 2, world::Vector3::UnitX()).toRotationMatrix();
  auto tx = db->begin();
  ASSERT_TRUE(tx.set(pole, body.pose, pose) && tx.set(pole, body.size_m, world::Vector3(0.2, 0.2, 10)));
  ASSERT_TRUE(tx.commit());
  shapes = shapes_of(db->snapshot(), BenchTime(), ground, {});
  const auto trunk =
      std::find_if(shapes.begin(), shapes.end(), [&](const Shape& s) { return s.node == pole; });
  ASSERT_NE(trunk, shapes.end());
  EXPECT_TRUE(leans(*trunk));
  EXPECT_FALSE(
      std::any_of(shapes.begin(), shapes.end(), [&](const Shape& s) { return s.node != pole && leans(s); }));
  const std::vector<double> ring = ground_plan(*trunk);
  ASSERT_EQ(ring.size(), 8u);
  double area = 0;
  for (std::size_t i = 0, j = 6; i < 8; j = i, i += 2) {
    EXPECT_NEAR(std::abs(ring[i] + 20), 0.1, 1e-9);
    EXPECT_NEAR(std::abs(ring[i + 1] - 5), 5, 1e-9);
    area += (ring[j] * ring[i + 1] - ring[j + 1] * ring[i]) / 2;
  }
  EXPECT_NEAR(area, 2, 1e-9);  // anticlockwise
  EXPECT_EQ(at_place(shapes, -20.05, 9.9, ground, terrain)->node, pole);
  EXPECT_EQ(at_place(shapes, -20.05, 0.1, ground, terrain)->node, pole);
  EXPECT_EQ(at_place(shapes, -20.05, 10.1, ground, terrain)->node, terrain) << "beyond its end";
  EXPECT_EQ(at_place(shapes, -20.15, 5, ground, terrain)->node, terrain) << "beside it";
}

TEST_F(LiveShapes, LeaveOutWhatIsPartOfAPlatform) {
  const world::types::Body body(db->schema());
  auto tx = db->begin();
  ASSERT_TRUE(tx.connect(pole, body.part_of, box));
  ASSERT_TRUE(tx.commit());
  const auto left = shapes_of(db->snapshot(), BenchTime(), ground, {box});
  ASSERT_EQ(left.size(), 1u);
  EXPECT_EQ(left[0].node, oak);
  EXPECT_EQ(parts_of(db->snapshot(), BenchTime(), box).size(), 2u);
  EXPECT_EQ(parts_of(db->snapshot(), BenchTime(), pole).size(), 1u);
}

TEST(LiveValues, GoThroughJsonAndBack) {
  using nlohmann::json;
  world::Pose pose = world::Pose::Identity();
  pose.translation() = world::Vector3(1, 2, 3);
  pose.linear() = Eigen::AngleAxisd(0.3, world::Vector3::UnitZ()).toRotationMatrix();
  for (const world::Value& v :
       {world::Value(true), world::Value(std::int64_t{-7}), world::Value(2.5), world::Value(std::nan("")),
        world::Value(std::string("oak")), world::Value(world::Vector3(1, 2, std::nan(""))),
        world::Value(world::Numbers({1, 2, 3}))}) {
    const auto back = value_from(json::parse(value_json(v).dump()), world::kind_of(v), "x");
    ASSERT_TRUE(back) << back.error().text();
    EXPECT_TRUE(world::same_value(v, *back)) << value_json(v);
  }
  const auto back = value_from(value_json(pose), world::ValueKind::pose, "x");
  ASSERT_TRUE(back);
  EXPECT_TRUE(std::get<world::Pose>(*back).isApprox(pose, 1e-12));
  const std::pair<const char*, world::ValueKind> wrong[] = {
      {"1", world::ValueKind::flag},
      {"1.5", world::ValueKind::integer},
      {"\"a\"", world::ValueKind::number},
      {"7", world::ValueKind::text},
      {"[1,2]", world::ValueKind::vector3},
      {"[1,\"a\"]", world::ValueKind::numbers},
      {"18446744073709551615", world::ValueKind::integer},
      {R"({"position_m":[0,0,0],"quaternion_wxyz":[2,0,0,0]})", world::ValueKind::pose},
      {R"({"position_m":[0,0,null],"quaternion_wxyz":[1,0,0,0]})", world::ValueKind::pose},
      {"\"12 bytes\"", world::ValueKind::blob}};
  for (const auto& [text, kind] : wrong) {
    const auto refused = value_from(json::parse(text), kind, "height_m");
    EXPECT_FALSE(refused) << text;
    if (!refused) {
      EXPECT_THAT(refused.error().text(), ::testing::HasSubstr("height_m: expected"));
    }
  }
}

}  // namespace
}  // namespace rigor::live
