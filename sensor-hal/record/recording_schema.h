// The version of what Rigor writes into an MCAP file: topics, message definitions and keys of the metadata. A
// recording names it in its metadata record `rigor`, and McapReader::open refuses one that is newer than this
// program knows: what it would read might mean something else.
#pragma once

#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/record/mcap_format.h"

namespace rigor::record {

/// Goes up by one with each change that a reader of the version before would misread: a field of a message, a
/// topic that moves, a key of the metadata that changes its meaning. A new topic or key does not change it.
/// tests/sensor-hal/record/test_recording_schema.cpp holds the definitions of each version.
inline constexpr int kRecordingSchema = 1;
/// Its key in the metadata record `rigor`.
inline constexpr const char* kRecordingSchemaKey = "rigor_run";

/// What a file says of the program that wrote it, as it stands there; empty texts where it does not.
struct RecordingWriter {
  std::string schema;
  std::string version;  ///< of Rigor; empty where it is not a short printable text
  /// Nothing is said (a recording by another program), or a schema that this program reads.
  [[nodiscard]] bool readable() const;
};
[[nodiscard]] RecordingWriter writer_of(const std::vector<Metadata>& metadata);

/// bad_input where the recording `name` is of a schema that this program does not read.
[[nodiscard]] Status check_schema(const std::string& name, const std::vector<Metadata>& metadata);

}  // namespace rigor::record
