// The registers of the emulated camera as one table. From its rows come the GenICam description, reads,
// writes and what writes are refused; a row says where a register lies, what it takes, and which features are
// made of it.
//
//   rows.add(reg::kGain, Kind::real, "Gain", "Analogue gain").unit("dB").within(0,
//   24).value<&Camera::gain_db_>();
//
// A number is 4 or 8 bytes, big-endian; 8 bytes are read in any halves, and written by one WRITEMEM of both.
// A row without a number is a piece of the bootstrap block: a text, or a constant.
#pragma once

#include <bit>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "drivers/aravis/gige_registers.h"
#include "drivers/aravis/gvcp_codec.h"
#include "rt-core/time.h"

namespace rigor::gige {

class GigeDeviceModel;
struct Endpoint;
struct FrameRequest;
struct GvcpAnswer;

/// Circumstances of a write.
struct Change {
  const Endpoint& from;
  DeviceTime now;
  GvcpAnswer& answer;  ///< what the write caused
};

enum class Access : std::uint8_t { read_only, write_only, read_write };

/// Limits of a number. A real number has no step.
struct Bounds {
  double min = 0, max = std::numeric_limits<std::uint32_t>::max();
  std::uint32_t step = 1;
};

struct Choice {
  std::string name;
  std::uint32_t value = 0;
};

/// A feature of the GenICam description, made of a register or of some of its bits.
struct Feature {
  enum class Kind : std::uint8_t { integer, real, flag, choice, command, text };
  Kind kind = Kind::integer;
  const char *category = "", *name = "", *tooltip = "", *unit = "", *visibility = "Expert";
  Access access = Access::read_only;
  int lsb = -1, msb = -1;             ///< bits, of which 0 is the most significant; -1: the whole register
  std::uint32_t command_value = 1;    ///< what executes the command
  std::optional<Bounds> bounds = {};  ///< that the description says
  std::vector<Choice> choices = {};
  std::vector<const char*> selects = {};  ///< the features that a selector is for
  std::string fixed = {};                 ///< of a feature without a register: its only value
};

class Register {
 public:
  using Kind = Feature::Kind;
  reg::Address address = 0;
  std::uint16_t size = 4;  ///< bytes; 0: features that no register is behind
  Access access = Access::read_only;
  bool locked = false;     ///< refuses writes while a client or an acquisition locks the parameters
  bool anyone = false;     ///< a client without control may write it
  bool clamped = false;    ///< what is out of bounds becomes the nearest value within
  bool is_signed = false;  ///< of 8 bytes
  std::optional<Bounds> bounds;
  reg::Address whole = 0, used = 0;  ///< where not 0: the maximum is what register `used` leaves of `whole`
  std::vector<Feature> features;
  std::uint64_t (*read)(const GigeDeviceModel&) =
      nullptr;  ///< bits of the number; null: of the bootstrap block
  GvStatus (*write)(GigeDeviceModel&, std::uint64_t bits, const Change&) = nullptr;

  [[nodiscard]] bool is_number() const { return read != nullptr; }
  [[nodiscard]] bool is_real() const { return !features.empty() && features[0].kind == Kind::real; }

  // What makes a row. The features' part means the newest one.
  Register& in(const char* category) { return features.back().category = category, *this; }
  Register& unit(const char* u) { return features.back().unit = u, *this; }
  Register& beginner() { return features.back().visibility = "Beginner", *this; }
  Register& within(double min, double max, std::uint32_t step = 1) {
    return bounds = {min, max, step}, *this;
  }
  Register& nearest_within(double min, double max) { return clamped = true, within(min, max); }
  Register& lock() { return locked = true, *this; }
  Register& choices(std::vector<Choice> all) { return features.back().choices = std::move(all), *this; }
  Register& selects(std::vector<const char*> all) { return features.back().selects = std::move(all), *this; }
  /// The bits from `lsb` to `msb` alone.
  Register& bits(int lsb, int msb, std::optional<Bounds> told = {}) {
    features.back().lsb = lsb, features.back().msb = msb, features.back().bounds = told;
    return *this;
  }
  /// One more feature of this register, writable or not.
  Register& also(Kind kind, const char* name, const char* tooltip, Access a = Access::read_only) {
    features.push_back(
        {.kind = kind, .category = features.front().category, .name = name, .tooltip = tooltip, .access = a});
    return *this;
  }
  /// Shows the model's member at this path of pointers to members.
  template <auto... kPath>
  Register& shows() {
    return shows([](const GigeDeviceModel& m) { return to_bits((m.*....*kPath)); });
  }
  Register& shows(std::uint64_t (*number)(const GigeDeviceModel&)) { return read = number, *this; }
  /// Shows and sets it.
  template <auto... kPath>
  Register& value() {
    shows<kPath...>();
    return does([](GigeDeviceModel& m, std::uint64_t bits, const Change&) {
      from_bits(bits, (m.*....*kPath));
      return GvStatus::success;
    });
  }
  /// What a write does; a command has nothing to show.
  Register& does(GvStatus (*what)(GigeDeviceModel&, std::uint64_t, const Change&)) {
    write = what;
    if (read == nullptr) read = [](const GigeDeviceModel&) { return std::uint64_t{0}; };
    return writable();
  }
  /// Of a row of commands, what executes each.
  Register& command_values(std::initializer_list<std::uint32_t> all) {
    for (std::size_t i = 0; i < all.size(); ++i) features[i].command_value = all.begin()[i];
    return *this;
  }
  Register& writable(Access a = Access::read_write) {
    access = a;
    for (Feature& f : features) f.access = a;
    return *this;
  }

 private:
  template <class T>
  static std::uint64_t to_bits(T v) {
    if constexpr (std::is_same_v<T, double>)
      return std::bit_cast<std::uint64_t>(v);
    else
      return static_cast<std::uint64_t>(v);
  }
  template <class T>
  static void from_bits(std::uint64_t bits, T& v) {
    if constexpr (std::is_same_v<T, double>)
      v = std::bit_cast<double>(bits);
    else
      v = static_cast<T>(bits);
  }
};

/// All rows.
class RegisterTable {
 public:
  using Kind = Feature::Kind;
  /// Category of the rows that follow.
  void category(const char* name) { category_ = name; }
  Register& add(reg::Address address, Kind kind, const char* name, const char* tooltip);
  /// `size` bytes of the bootstrap block, or a number that no feature is made of.
  Register& add(reg::Address address, std::uint16_t size = 4);
  /// A feature that has one value and no register.
  Register& fixed(Kind kind, const char* name, const char* tooltip, const char* value);
  /// Orders the rows for find(); after the last one.
  void sort();

  /// The register that has this byte, or null.
  [[nodiscard]] const Register* find(reg::Address address) const;
  [[nodiscard]] std::span<const Register> rows() const& { return rows_; }
  std::span<const Register> rows() const&& = delete;  // they end with the table

 private:
  const char* category_ = "";
  std::vector<Register> rows_;             // as they were added, which is the order of the description
  std::vector<std::uint16_t> by_address_;  // places in rows_
};

/// What follows a picture. All but the picture itself have 8 bytes.
struct Chunk {
  std::uint32_t id = 0;
  const char *name = "", *tooltip = "";
  Feature::Kind kind = Feature::Kind::integer;
  std::uint64_t (*value)(const FrameRequest&) = nullptr;
};
/// By id, without gaps, from kChunkImage on.
[[nodiscard]] std::span<const Chunk> chunk_table();

}  // namespace rigor::gige
