// Where the messages of a run go: into a file (mcap_writer.h), or to other programs while the run goes on (a
// bridge). The Recorder writes to this interface.
#pragma once

#include <cstdint>
#include <string>

#include "rt-core/result.h"
#include "sensor-hal/record/byte_io.h"
#include "sensor-hal/record/mcap_format.h"
#include "sensor-hal/types/sample.h"

namespace rigor::record {

struct ChannelOptions {
  std::uint16_t schema = 0;
  std::string topic{};
  std::string message_encoding = "cdr";
  StringMap metadata{};
};

struct MessageInfo {
  std::uint16_t channel = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0;
  std::uint64_t publish_time_ns = 0;
};

struct WriterStatistics {
  std::uint64_t messages = 0;
  std::uint64_t chunks = 0;
  std::uint64_t file_bytes = 0;
  std::uint64_t lost_messages = 0;  ///< accepted into a chunk that could then not be written
};

/// One thread at a time, an I/O thread; may block and allocate.
class MessageWriter {
 public:
  virtual ~MessageWriter() = default;
  /// `text`: the type's definition, in `encoding` (`ros2msg`). The id that channels name.
  [[nodiscard]] virtual Result<std::uint16_t> add_schema(const std::string& name, const std::string& encoding,
                                                         const std::string& text) = 0;
  /// The id that messages name.
  [[nodiscard]] virtual Result<std::uint16_t> add_channel(const ChannelOptions& channel) = 0;
  /// The message's bytes are those of the pieces one after the other; they are not used after the call.
  [[nodiscard]] virtual Status write(const MessageInfo& message, Pieces pieces) = 0;
  /// The same, of a message whose pieces borrow from the bytes of `sample`. A writer that needs these after
  /// the call keeps a lease of it.
  [[nodiscard]] virtual Status write_sample(const MessageInfo& message, Pieces pieces,
                                            const SampleLease& sample) {
    (void)sample;
    return write(message, pieces);
  }
  /// Bench time has come this far, though there may be no message to say so.
  [[nodiscard]] virtual Status advance(std::uint64_t log_time_ns) = 0;
  [[nodiscard]] virtual Status add_metadata(const Metadata& metadata) = 0;
  /// Later calls of any kind are errors (wrong_state).
  [[nodiscard]] virtual Status close() = 0;
  [[nodiscard]] virtual const WriterStatistics& statistics() const = 0;
};

}  // namespace rigor::record
