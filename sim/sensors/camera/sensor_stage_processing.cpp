#include "sim/sensors/camera/sensor_stage_processing.h"
#include "sim/sensors/camera/rows.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>

namespace rigor::sensor_stage {
namespace {

/// Mirrored about the first and the last index, which keeps a mosaic's colours; for any distance.
int mirrored(int i, int size) {
  if (size == 1) return 0;
  const int period = 2 * (size - 1);
  i %= period;
  if (i < 0) i += period;
  return i < size ? i : period - i;
}

/// A copy of the row with `margin` mirrored pixels on both sides.
const std::uint16_t* padded_row(const NumberPlane& in, int y, int margin, std::vector<std::uint16_t>& out) {
  const std::uint16_t* const row = in.row(mirrored(y, in.height));
  out.resize(static_cast<std::size_t>(in.width + 2 * margin));
  for (int x = -margin; x < 0; ++x) out[static_cast<std::size_t>(x + margin)] = row[mirrored(x, in.width)];
  std::copy(row, row + in.width, out.begin() + margin);
  for (int x = in.width; x < in.width + margin; ++x)
    out[static_cast<std::size_t>(x + margin)] = row[mirrored(x, in.width)];
  return out.data() + margin;
}

using Rows = std::array<std::vector<std::uint16_t>, 5>;

void order(std::uint16_t& a, std::uint16_t& b) {
  const std::uint16_t low = std::min(a, b), high = std::max(a, b);
  a = low;
  b = high;
}

/// Paeth's network of 19 exchanges ("Median finding on a 3x3 grid", Graphics Gems, 1990).
std::uint16_t median_of_nine(std::uint16_t p[9]) {
  order(p[1], p[2]), order(p[4], p[5]), order(p[7], p[8]);
  order(p[0], p[1]), order(p[3], p[4]), order(p[6], p[7]);
  order(p[1], p[2]), order(p[4], p[5]), order(p[7], p[8]);
  order(p[0], p[3]), order(p[5], p[8]), order(p[4], p[7]);
  order(p[3], p[6]), order(p[1], p[4]), order(p[2], p[5]);
  order(p[4], p[7]), order(p[4], p[2]), order(p[6], p[4]);
  order(p[4], p[2]);
  return p[4];
}

}  // namespace

void median_3x3(const NumberPlane& in, int step, NumberPlane& out) {
  out.resize(in.width, in.height);
  for_rows(in.height, [&](int y) {
    thread_local Rows rows;
    const std::uint16_t* const r[3] = {padded_row(in, y - step, step, rows[0]),
                                       padded_row(in, y, step, rows[1]),
                                       padded_row(in, y + step, step, rows[2])};
    std::uint16_t* const to = out.row(y);
    for (int x = 0; x < in.width; ++x) {
      std::uint16_t p[9];
      for (int k = 0; k < 3; ++k) {
        p[3 * k] = r[k][x - step];
        p[3 * k + 1] = r[k][x];
        p[3 * k + 2] = r[k][x + step];
      }
      to[x] = median_of_nine(p);
    }
  });
}

void demosaic(const NumberPlane& mosaic, std::uint16_t max_dn, std::array<NumberPlane, 3>& colours) {
  for (NumberPlane& c : colours) c.resize(mosaic.width, mosaic.height);
  for_rows(mosaic.height, [&](int y) {
    thread_local Rows rows;
    const std::uint16_t* r[5];
    for (int k = 0; k < 5; ++k) r[k] = padded_row(mosaic, y + k - 2, 2, rows[static_cast<std::size_t>(k)]);
    // Sixteenths, so that the paper's halves are whole; rounded half up.
    const auto clip = [max_dn](int sixteenths) {
      return static_cast<std::uint16_t>(std::clamp((sixteenths + 8) >> 4, 0, static_cast<int>(max_dn)));
    };
    const bool red_row = y % 2 == 0;
    std::uint16_t* const along = colours[red_row ? 0 : 2].row(y);   // the colour that this row measures
    std::uint16_t* const across = colours[red_row ? 2 : 0].row(y);  // and that of the rows next to it
    std::uint16_t* const green = colours[1].row(y);
    for (int x = 0; x < mosaic.width; ++x) {
      const int c = r[2][x];
      const int near_h = r[2][x - 1] + r[2][x + 1], near_v = r[1][x] + r[3][x];
      const int far_h = r[2][x - 2] + r[2][x + 2], far_v = r[0][x] + r[4][x];
      const int diagonal = r[1][x - 1] + r[1][x + 1] + r[3][x - 1] + r[3][x + 1];
      const bool coloured = (x % 2 == 0) == red_row;  // red or blue
      if (coloured) {
        along[x] = static_cast<std::uint16_t>(c);
        green[x] = clip(8 * c + 4 * (near_h + near_v) - 2 * (far_h + far_v));
        across[x] = clip(12 * c + 4 * diagonal - 3 * (far_h + far_v));
      } else {
        green[x] = static_cast<std::uint16_t>(c);
        along[x] = clip(10 * c + 8 * near_h - 2 * far_h - 2 * diagonal + far_v);
        across[x] = clip(10 * c + 8 * near_v - 2 * far_v - 2 * diagonal + far_h);
      }
    }
  });
}

void pack_12p(std::span<const std::uint16_t> numbers, std::byte* out) {
  const std::size_t pairs = numbers.size() / 2;
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pairs, 4096),
                    [&](const tbb::blocked_range<std::size_t>& r) {
                      for (std::size_t i = r.begin(); i < r.end(); ++i) {
                        const unsigned a = numbers[2 * i], b = numbers[2 * i + 1];
                        out[3 * i] = static_cast<std::byte>(a);
                        out[3 * i + 1] = static_cast<std::byte>(a >> 8 | b << 4);
                        out[3 * i + 2] = static_cast<std::byte>(b >> 4);
                      }
                    });
  if (numbers.size() % 2 != 0) {
    const unsigned a = numbers.back();
    out[3 * pairs] = static_cast<std::byte>(a);
    out[3 * pairs + 1] = static_cast<std::byte>(a >> 8);
  }
}

}  // namespace rigor::sensor_stage
