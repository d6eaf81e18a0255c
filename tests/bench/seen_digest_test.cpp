// The digest of what an application sees.
#include "bench/run/seen_digest.h"

#include <gtest/gtest.h>

namespace rigor {
namespace {

ImageInfo picture_info(std::uint32_t side_px) {
  ImageInfo info;
  info.width_px = info.height_px = side_px;
  return info;
}

struct SeenDigestTest : ::testing::Test {
  /// Of one sample, shown once.
  static std::string of(SampleKind kind, const decltype(Sample::info)& info,
                        std::uint32_t validity = kValid) {
    SamplePool pool(2);
    SampleLease slot = pool.try_acquire();
    slot.edit().info = info;
    slot.edit().size_bytes = 0;
    slot.edit().stamp = {};
    slot.edit().stamp.validity = validity;
    SeenDigest digest({kind}, true);
    digest.saw(7, BenchTime(7000), 0, PortStatus::fresh, slot);
    return digest.finish();
  }
};

TEST_F(SeenDigestTest, TellsFramesApartByTheirFlags) {
  CanFrame frame;
  frame.id = 0x123;
  frame.length = 2;
  const std::string plain = of(SampleKind::can_frame, frame);
  EXPECT_EQ(plain.size(), 64u);
  EXPECT_EQ(plain, of(SampleKind::can_frame, frame));
  for (bool CanFrame::*flag : {&CanFrame::extended, &CanFrame::remote, &CanFrame::error, &CanFrame::fd}) {
    CanFrame other = frame;
    other.*flag = true;
    EXPECT_NE(of(SampleKind::can_frame, other), plain);
  }
  EXPECT_NE(of(SampleKind::can_frame, frame, kClockUnsure), plain);
}

TEST_F(SeenDigestTest, HoldsFewOfAPortsPicturesWhereTheLoopDoesNotWait) {
  constexpr std::size_t kSlots = 12;
  SamplePool pool(kSlots);
  SeenDigest digest({SampleKind::image}, false);
  {
    std::vector<SampleLease> pictures;
    for (std::uint64_t i = 0; i < kSlots; ++i) {
      SampleLease slot = pool.try_acquire();
      ASSERT_TRUE(slot);
      Sample& s = slot.edit();
      s.reserve(2048 * 2048);
      s.info = picture_info(2048);
      s.size_bytes = 2048 * 2048;
      s.stamp.sequence = i;
      pictures.push_back(std::move(slot));
    }
    for (const SampleLease& p : pictures)
      digest.saw(p->stamp.sequence, BenchTime(0), 0, PortStatus::fresh, p);
  }
  std::size_t free = 0;
  std::vector<SampleLease> taken;
  while (SampleLease slot = pool.try_acquire()) ++free, taken.push_back(std::move(slot));
  EXPECT_GE(free, kSlots - SeenDigest::kLeases);
  EXPECT_EQ(digest.finish(), "") << "pictures were left out";
}

TEST_F(SeenDigestTest, IsOfEveryPictureWhereTheLoopWaits) {
  SamplePool pool(1);
  SeenDigest digest({SampleKind::image}, true);
  for (std::uint64_t i = 0; i < 50; ++i) {
    SampleLease slot;
    while (!(slot = pool.try_acquire())) std::this_thread::yield();
    Sample& s = slot.edit();
    if (i == 0) s.reserve(64);
    s.info = picture_info(8);
    s.size_bytes = 64;
    digest.saw(i, BenchTime(0), 0, PortStatus::fresh, slot);
  }
  EXPECT_EQ(digest.finish().size(), 64u);
}

}  // namespace
}  // namespace rigor
