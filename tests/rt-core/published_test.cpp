#include "rt-core/published.h"

#include <gtest/gtest.h>

#include <thread>

namespace rigor {
namespace {

struct Wide {
  std::uint64_t v[9];
};

// Seen to fail when load() does not look at the sequence again.
TEST(Published, ReadersNeverSeeHalfOfAWrite) {
  Published<Wide> published;
  std::atomic<bool> end{false};
  std::atomic<std::uint64_t> torn{0}, back{0}, reads{0};
  const auto read = [&] {
    std::uint64_t last = 0;
    while (!end) {
      const Wide w = published.load();
      for (const std::uint64_t v : w.v) torn += v != w.v[0];
      back += w.v[0] < last;
      last = w.v[0];
      ++reads;
    }
  };
  std::thread a(read), b(read);
  std::uint64_t i = 0;
  while (i < 100'000 || reads < 1000) {
    Wide w;
    ++i;
    for (std::uint64_t& v : w.v) v = i;
    published.store(w);
    if (i % 1024 == 0) std::this_thread::yield();
  }
  end = true;
  a.join();
  b.join();
  EXPECT_EQ(torn, 0u);
  EXPECT_EQ(back, 0u);
}

}  // namespace
}  // namespace rigor
