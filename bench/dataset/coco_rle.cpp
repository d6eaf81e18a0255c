#include "bench/dataset/coco_rle.h"

namespace rigor::coco {

std::vector<std::vector<std::uint32_t>> runs_of(std::span<const std::uint16_t> ids, std::uint32_t width,
                                                std::uint32_t height, std::size_t count) {
  std::vector<std::vector<std::uint32_t>> runs(count + 1);
  std::vector<std::uint32_t> end(count + 1, 0);
  const auto total = static_cast<std::uint32_t>(ids.size());
  std::uint32_t begin = 0;
  const auto close = [&](std::uint16_t id, std::uint32_t at) {
    if (id == 0 || id > count) return;
    runs[id].push_back(begin - end[id]);
    runs[id].push_back(at - begin);
    end[id] = at;
  };
  std::uint16_t last = 0;
  std::uint32_t at = 0;
  for (std::uint32_t x = 0; x < width; ++x)
    for (std::uint32_t y = 0; y < height; ++y, ++at) {
      const std::uint16_t id = ids[std::size_t{y} * width + x];
      if (id == last) continue;
      close(last, at);
      last = id;
      begin = at;
    }
  close(last, at);
  for (std::size_t id = 1; id <= count; ++id)
    if (end[id] < total) runs[id].push_back(total - end[id]);
  runs.erase(runs.begin());
  return runs;
}

std::string compress(std::span<const std::uint32_t> runs) {
  std::string text;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    std::int64_t x = runs[i];
    if (i > 2) x -= runs[i - 2];
    for (bool more = true; more;) {
      auto c = static_cast<unsigned>(x & 0x1F);
      x >>= 5;
      more = (c & 0x10U) != 0 ? x != -1 : x != 0;
      if (more) c |= 0x20U;
      text.push_back(static_cast<char>(c + 48));
    }
  }
  return text;
}

}  // namespace rigor::coco
