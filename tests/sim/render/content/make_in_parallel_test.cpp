#include <gtest/gtest.h>

#include <atomic>
#include <stdexcept>
#include <thread>

#include "sim/render/content/content.h"

namespace rigor::render {
namespace {

TEST(MakeInParallel, GivesSerialsInTheOrderOfNumbersWhicheverIsMadeFirst) {
  constexpr std::size_t kCount = 40;
  std::vector<std::vector<std::uint64_t>> serials(kCount);
  std::atomic<int> under_way{0};
  make_in_parallel(kCount, [&](std::size_t i) {
    ++under_way;
    under_way.notify_all();
    for (std::size_t k = 0; k <= i % 3; ++k) serials[i].push_back(next_serial());
    // Others overtake the first one, where there is a second thread.
    if (i == 0 && std::thread::hardware_concurrency() > 1)
      for (int now; (now = under_way) < 4;) under_way.wait(now);
    serials[i].push_back(next_serial());
  });
  std::uint64_t last = 0;
  for (const auto& of_one : serials) {
    ASSERT_FALSE(of_one.empty());
    for (const std::uint64_t s : of_one) {
      EXPECT_GT(s, last);
      last = s;
    }
  }
  EXPECT_GT(next_serial(), last);
}

TEST(MakeInParallel, ThrowsWhatTheFirstByNumberThrewWhenAllAreDone) {
  std::atomic<int> done{0};
  try {
    make_in_parallel(9, [&](std::size_t i) {
      ++done;
      if (i == 3 || i == 7) throw std::runtime_error(std::to_string(i));
    });
    ADD_FAILURE() << "nothing was thrown";
  } catch (const std::runtime_error& e) {
    EXPECT_STREQ(e.what(), "3");
  }
  EXPECT_EQ(done, 9);
  const std::uint64_t a = next_serial();
  EXPECT_EQ(next_serial(), a + 1);
}

TEST(MakeInParallel, OfNothingDoesNothing) {
  make_in_parallel(0, [](std::size_t) { ADD_FAILURE(); });
}

}  // namespace
}  // namespace rigor::render
