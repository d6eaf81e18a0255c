// The records within a chunk of a recording, checked.
#pragma once

#include <string>

#include "sensor-hal/record/mcap_reader.h"

namespace rigor::record {

struct ChunkLimits {
  bool verify = true;  ///< the checksum, too
  std::uint64_t max_bytes = ReaderOptions{}.max_loaded_bytes;
};

/// The records of a chunk, `record` being the whole of it as it lies in the file: within `record` where they
/// are not compressed, else unpacked into `unpacked`. Any thread. Errors: protocol, with `file` and the
/// byte, where the chunk is damaged, is not what the segment says, or does not match its checksum.
[[nodiscard]] Result<Bytes> chunk_records(const Segment& segment, Bytes record, ByteBuffer& unpacked,
                                          const std::string& file, const ChunkLimits& limits = {});

}  // namespace rigor::record
