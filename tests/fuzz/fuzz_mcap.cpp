// A whole file as it comes from anywhere: by its index and by a scan, every message, metadata, attachment,
// samples where there are any; then repaired, and what the repair wrote must be a good recording of as many
// messages.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>

#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/mcap_repair.h"
#include "sensor-hal/record/sample_codec.h"

using namespace rigor;
using namespace rigor::record;

namespace {

constexpr std::uint64_t kMayHold = 1u << 20;

class Keep final : public ByteSink {
 public:
  explicit Keep(MemorySink& to) : to_(to) {}
  Status append(Pieces pieces) override { return to_.append(pieces); }
  Status truncate(std::uint64_t size) override { return to_.truncate(size); }
  Status sync() override { return {}; }
  std::string name() const override { return "fuzz"; }

 private:
  MemorySink& to_;
};

void check(bool holds) {
  if (!holds) std::abort();
}

void walk(Bytes file, ReaderOptions options) {
  const auto reader = McapReader::open(memory_source(file), options);
  if (!reader) return;
  MessageCursor cursor = (*reader)->messages();
  SampleDecoder decoder("/dut/data");
  MessageView m;
  std::uint64_t last_ns = 0;
  for (int n = 0; n < 10'000; ++n) {
    const Result<bool> more = cursor.next(m);
    if (!more || !*more) break;
    check(m.log_time_ns >= last_ns);
    last_ns = m.log_time_ns;
    const Result<bool> complete = decoder.take(m);
    if (!complete || !*complete || decoder.size_bytes() > kMayHold) continue;
    Sample sample;
    sample.reserve(decoder.size_bytes());
    check(decoder.fill(sample).has_value());
  }
  (void)(*reader)->readable_metadata();
  for (std::size_t i = 0; i < (*reader)->attachment_count(); ++i) (void)(*reader)->attachment(i);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const Bytes file(reinterpret_cast<const std::byte*>(data), size);
  walk(file, {.max_loaded_bytes = kMayHold});
  walk(file, {.scan = true, .skip_damaged = true, .max_loaded_bytes = kMayHold});

  MemorySink repaired;
  const auto report =
      repair(memory_source(file), std::make_unique<Keep>(repaired), {.max_loaded_bytes = kMayHold});
  if (!report) return 0;
  const auto again = McapReader::open(memory_source(repaired.bytes()), {.scan = true});
  check(again.has_value());
  check((*again)->health().good());
  check((*again)->message_count() == report->messages);
  return 0;
}
