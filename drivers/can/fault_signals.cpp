#include "drivers/can/fault_signals.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "drivers/can/dbc.h"
#include "drivers/can/signal_codec.h"

namespace rigor {
namespace {

class DbcSignal final : public FrameSignal {
 public:
  DbcSignal(std::shared_ptr<const can::Dbc> dbc, const can::Message& message, std::size_t signal)
      : dbc_(std::move(dbc)), message_(message), index_(signal) {}

  double read(const CanFrame& frame) const noexcept override {
    if (frame.error || frame.remote || frame.id != message_.id || frame.extended != message_.extended)
      return std::numeric_limits<double>::quiet_NaN();
    return can::decode(message_, index_, {frame.data.data(), frame.length});
  }

  bool write(CanFrame& frame, double value) const noexcept override {
    const can::Signal& s = message_.signals[index_];
    std::uint64_t raw = 0;
    auto status = can::raw_of(s, value, raw);
    if (status == can::EncodeStatus::out_of_range) {
      // To the nearest end of what is stated, or of what the bits hold.
      double low = s.minimum, high = s.maximum;
      if (!s.has_range()) {
        const int bits = std::min<int>(s.length_bits, 52) - (s.is_signed ? 1 : 0);
        const double top = std::exp2(bits) - 1, bottom = s.is_signed ? -std::exp2(bits) : 0;
        low = std::min(bottom * s.factor, top * s.factor) + s.offset;
        high = std::max(bottom * s.factor, top * s.factor) + s.offset;
      }
      status = can::raw_of(s, std::clamp(value, low, high), raw);
    }
    if (status != can::EncodeStatus::good) return false;
    can::write_raw(s, {frame.data.data(), frame.length}, raw);
    return true;
  }

 private:
  std::shared_ptr<const can::Dbc> dbc_;
  const can::Message& message_;
  std::size_t index_;
};

}  // namespace

std::shared_ptr<const FrameSignal> find_dbc_signal(const ConfigNode& fault, const std::string& name) {
  auto loaded = can::load_dbc(fault.base_dir() / fault.text("dbc"));
  if (!loaded) throw fault.error("dbc", loaded.error().text());
  const auto dbc = std::make_shared<const can::Dbc>(std::move(*loaded));
  std::vector<std::string> names;
  std::vector<std::pair<const can::Message*, std::size_t>> fits;
  for (const can::Message& m : dbc->messages)
    for (std::size_t i = 0; i < m.signals.size(); ++i) {
      const std::string full = m.name + "." + m.signals[i].name;
      names.push_back(m.signals[i].name);
      names.push_back(full);
      if (m.fits_a_frame() && (name == m.signals[i].name || name == full)) fits.emplace_back(&m, i);
    }
  if (fits.size() == 1) return std::make_shared<DbcSignal>(dbc, *fits.front().first, fits.front().second);
  const std::string near = nearest(name, names);
  throw fault.error("value", fits.empty() ? "expected a signal of " + dbc->name + ", got " + name +
                                                (near.empty() ? "" : "; did you mean '" + near + "'?")
                                          : "expected one signal, got " + name +
                                                ", which several messages have; "
                                                "write MESSAGE." +
                                                name);
}

}  // namespace rigor
