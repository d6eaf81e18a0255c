// How long the commands of a sink take to be safe once something went wrong. For this room alone.
//
//   wrong      ........├───────────────────────────────────┤......     a stretch: a fault is on, a channel is
//   lost commands   moving moving moving safe safe safe safe safe
//                      ├──── took ──┤
//                      ├─── within ──────┼─────────────────┤ here they must be safe
//
// A stretch that ends sooner than `within` asks for nothing; where the commands became safe in it, it counts
// all the same. A command counts from when it takes effect, with the latency of its sink. Before the first
// command a sink has its safe values.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "sensor-hal/channel/channel.h"

namespace rigor::expect {

/// What came of the stretches. Plain data.
struct Reactions {
  std::uint64_t begun = 0;
  std::uint64_t judged = 0;   ///< of these
  std::uint64_t failed = 0;   ///< of these
  Duration minimum, maximum;  ///< `took`, of those that were judged; of one that never was safe, its length
  /// Of the first that failed.
  enum class How : std::uint8_t {
    none,
    late,   ///< safe after `took`
    never,  ///< not safe until it ended
    left    ///< safe after `took`, and not any more from `t_failed` on
  } how = How::none;
  BenchTime t_began, t_failed;  ///< `t_failed`: the first instant at which it was not as it had to be
  Duration took;
};

class SafeState {
 public:
  /// What it has seen so far. Plain data.
  struct Seen {
    Reactions reactions;
    BenchTime t_safe;    ///< from when on the commands were safe the last time
    BenchTime t_unsafe;  ///< and were not
    BenchTime t_began;   ///< of the stretch
    bool safe = true, was_wrong = false;
    bool open = false;     ///< in a stretch that counts
    bool decided = false;  ///< its `within` is over
    bool failed = false, first_failed = false, waiting = false;
  };

  /// `safe`: values by their places in a command. Setup context.
  SafeState(Duration within, std::vector<std::pair<std::size_t, double>> safe)
      : within_(within), safe_(std::move(safe)) {}

  // Loop thread; no allocation.
  void begin(BenchTime t0) noexcept;
  void command(const Command& command) noexcept;
  /// The sink has its safe values though nobody commanded them.
  void made_safe(BenchTime t) noexcept;
  /// Last in each cycle. `counts`: a stretch that begins now is judged.
  void cycle(BenchTime t, bool wrong, bool counts) noexcept;

  [[nodiscard]] const Seen& seen() const noexcept { return seen_; }
  /// Any thread. `ended`: nothing comes after `now`, else what is under way is left open.
  [[nodiscard]] Reactions reactions(Seen seen, BenchTime now, bool ended) const noexcept;

 private:
  void decide(Seen& s) const noexcept;
  void close(Seen& s, BenchTime t) const noexcept;

  Duration within_;
  std::vector<std::pair<std::size_t, double>> safe_;
  Seen seen_;
};

}  // namespace rigor::expect
