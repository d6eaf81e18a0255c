// The digest of what an application sees.
#include "bench/run/input_digest.h"

#include <gtest/gtest.h>

namespace rigor {
namespace {

ImageInfo picture_info(std::uint32_t side_px) {
  ImageInfo info;
  info.width_px = info.height_px = side_px;
  return info;
}

struct InputDigestTest : ::testing::Test {
  /// Of one sample, shown once.
  static std::string of(SampleKind kind, const decltype(Sample::info)& info,
                        std::uint32_t validity = kValid) {
    SamplePool pool(2);
    SampleSlot slot = pool.try_acquire();
    slot->info = info;
    slot->size_bytes = 0;
    slot->stamp = {};
    slot->stamp.validity = validity;
    InputDigest digest({kind}, true);
    digest.saw(7, BenchTime(7000), 0, PortStatus::fresh, std::move(slot));
    return digest.finish();
  }
};

TEST_F(InputDigestTest, TellsFramesApartByTheirFlags) {
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

TEST_F(InputDigestTest, HoldsFewOfAPortsPicturesWhereTheLoopDoesNotWait) {
  constexpr std::size_t kSlots = 12;
  SamplePool pool(kSlots);
  InputDigest digest({SampleKind::image}, false);
  {
    std::vector<SampleLease> pictures;
    for (std::uint64_t i = 0; i < kSlots; ++i) {
      SampleSlot slot = pool.try_acquire();
      ASSERT_TRUE(slot);
      Sample& s = *slot;
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
  while (SampleSlot slot = pool.try_acquire()) ++free, taken.push_back(std::move(slot));
  EXPECT_GE(free, kSlots - InputDigest::kLeases);
  EXPECT_EQ(digest.finish(), "") << "pictures were left out";
}

TEST_F(InputDigestTest, IsOfEveryPictureWhereTheLoopWaits) {
  SamplePool pool(1);
  InputDigest digest({SampleKind::image}, true);
  for (std::uint64_t i = 0; i < 50; ++i) {
    SampleSlot slot;
    while (!(slot = pool.try_acquire())) std::this_thread::yield();
    Sample& s = *slot;
    if (i == 0) s.reserve(64);
    s.info = picture_info(8);
    s.size_bytes = 64;
    digest.saw(i, BenchTime(0), 0, PortStatus::fresh, std::move(slot));
  }
  EXPECT_EQ(digest.finish().size(), 64u);
}

}  // namespace
}  // namespace rigor
