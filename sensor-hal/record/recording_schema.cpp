#include "sensor-hal/record/recording_schema.h"

#include <algorithm>
#include <charconv>

namespace rigor::record {
namespace {

constexpr std::size_t kLongestShown = 32;  // of texts that a file brings along

bool is_short_text(const std::string& text) {
  return text.size() <= kLongestShown &&
         std::all_of(text.begin(), text.end(), [](unsigned char c) { return c > ' ' && c < 0x7f; });
}

}  // namespace

RecordingWriter writer_of(const std::vector<Metadata>& metadata) {
  RecordingWriter writer;
  for (const Metadata& m : metadata) {
    if (m.name != "rigor") continue;
    if (const auto at = m.values.find(kRecordingSchemaKey); at != m.values.end())
      writer.schema = is_short_text(at->second) && !at->second.empty() ? at->second : "?";
    if (const auto at = m.values.find("version"); at != m.values.end() && is_short_text(at->second))
      writer.version = at->second;
  }
  return writer;
}

bool RecordingWriter::readable() const {
  if (schema.empty()) return true;
  int number = 0;
  const char* end = schema.data() + schema.size();
  const auto [stop, error] = std::from_chars(schema.data(), end, number);
  return error == std::errc{} && stop == end && number >= 1 && number <= kRecordingSchema;
}

Status check_schema(const std::string& name, const std::vector<Metadata>& metadata) {
  const RecordingWriter writer = writer_of(metadata);
  if (writer.readable()) return {};
  return fail(ErrorCode::bad_input, name,
              "expected a recording of schema " +
                  std::string(kRecordingSchema == 1 ? "1" : "1 to " + std::to_string(kRecordingSchema)) +
                  ", got schema " + writer.schema + ", written by rigor" +
                  (writer.version.empty() ? "" : " " + writer.version) +
                  "; read it with that version of Rigor or a newer one");
}

}  // namespace rigor::record
