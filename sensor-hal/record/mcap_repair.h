// Makes a complete, indexed recording out of one that was cut short or damaged.
//
// Everything that McapReader finds in a scan is written anew, in the order in which it lay in the file, to a
// temporary file beside the output, which then takes the output's name. The original is only replaced when
// the output has its name.
#pragma once

#include <string>

#include "sensor-hal/record/mcap_reader.h"

namespace rigor::record {

struct RepairOptions {
  bool salvage_tail = true;  ///< keep whole messages of a cut chunk though no checksum covers them
  std::uint64_t max_loaded_bytes = ReaderOptions{}.max_loaded_bytes;
};

struct RepairReport {
  bool was_good = false;       ///< nothing was wrong; the output is written all the same
  Health health;               ///< of the input
  std::uint64_t messages = 0;  ///< kept
  std::uint64_t attachments_lost = 0;
  std::uint64_t input_bytes = 0;
  std::uint64_t output_bytes = 0;
};

/// Setup context; reads and writes files. Errors: those of McapReader::open and of the output.
[[nodiscard]] Result<RepairReport> repair(const std::string& input, const std::string& output,
                                          RepairOptions options = {});

/// The same between any source and sink, without the temporary file.
[[nodiscard]] Result<RepairReport> repair(std::unique_ptr<ByteSource> input, std::unique_ptr<ByteSink> output,
                                          RepairOptions options = {});

}  // namespace rigor::record
