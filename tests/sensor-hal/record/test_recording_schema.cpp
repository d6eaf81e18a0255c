// Recordings of another schema than this program's, and what the present schema is.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "sensor-hal/record/crc32.h"
#include "sensor-hal/record/inspect.h"
#include "sensor-hal/record/mcap_repair.h"
#include "sensor-hal/record/recording_schema.h"
#include "sensor-hal/record/ros2_messages.h"
#include "tests/sensor-hal/record/recording_fixture.h"

namespace rigor::record {
namespace {

using namespace test;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

const std::string kNext = std::to_string(kRecordingSchema + 1);

/// As `rigor run` begins a file; `closed`: with its index.
std::vector<std::byte> recording_of(StringMap said, bool closed = true) {
  MemorySink memory;
  auto writer = must(McapWriter::open(std::make_unique<SharedSink>(memory), small_chunks()));
  must(writer->add_metadata({"rigor", std::move(said)}));
  write_messages(*writer, 40);
  if (closed) must(writer->close());
  return memory.bytes();
}

std::string refusal(const StringMap& said, bool closed = true) {
  const auto bytes = recording_of(said, closed);
  const auto reader = McapReader::open(memory_source(bytes, "run.mcap"));
  return reader ? "" : reader.error().text();
}

TEST(RecordingSchema, OfANewerVersionIsRefusedWithIndexAndWithout) {
  for (const bool closed : {true, false})
    EXPECT_THAT(refusal({{kRecordingSchemaKey, kNext}, {"version", "9.8.7"}}, closed),
                AllOf(HasSubstr("run.mcap"), HasSubstr("expected a recording of schema 1"),
                      HasSubstr("got schema " + kNext + ", written by rigor 9.8.7"), HasSubstr("newer")));
}

TEST(RecordingSchema, OfThisVersionOrOfAnotherProgramIsRead) {
  EXPECT_EQ(refusal({{kRecordingSchemaKey, std::to_string(kRecordingSchema)}, {"version", "0.0.1"}}), "");
  EXPECT_EQ(refusal({{"seed", "7"}}), "");
}

TEST(RecordingSchema, ThatIsNoNumberIsRefusedAndShownOnlyWhereItIsShort) {
  for (const char* said : {"", "0", "-1", "1x", "99999999999999999999", "two"})
    EXPECT_THAT(refusal({{kRecordingSchemaKey, said}}), HasSubstr("got schema")) << said;
  EXPECT_THAT(refusal({{kRecordingSchemaKey, std::string(5000, '7')}, {"version", "\x1b[2J"}}),
              AllOf(HasSubstr("got schema ?, written by rigor;"), Not(HasSubstr("\x1b"))));
}

TEST(RecordingSchema, OfANewerVersionIsInspectedWithAWarningAndRepaired) {
  const auto bytes = recording_of({{kRecordingSchemaKey, kNext}, {"version", "9.8.7"}}, false);
  const RecordingReport report = must(inspect(memory_source(bytes)));
  EXPECT_GT(report.messages, 0u) << "but for the last chunk, which was not finished";
  EXPECT_EQ(to_json(report)["schema"], kNext);
  EXPECT_THAT(to_text(report), AllOf(HasSubstr("9.8.7, schema " + kNext), HasSubstr("may be misread")));
  MemorySink whole;
  const RepairReport repaired = must(repair(memory_source(bytes), std::make_unique<SharedSink>(whole)));
  EXPECT_EQ(repaired.messages, report.messages);
  EXPECT_EQ(must(inspect(memory_source(whole.bytes()))).writer.schema, kNext) << "the schema is kept";
  const auto ours = recording_of({{kRecordingSchemaKey, std::to_string(kRecordingSchema)}});
  EXPECT_THAT(to_text(must(inspect(memory_source(ours)))), Not(HasSubstr("misread")));
}

/// A checksum over the definitions of all types that Rigor defines itself.
std::uint32_t definitions() {
  std::string all;
  for (const std::string_view type :
       {msg::SampleStamp::kType, msg::ImageSettings::kType, msg::CanFdFrame::kType, msg::RegisterBlock::kType,
        msg::NavFixQuality::kType, msg::PortVisibility::kType, msg::Event::kType, msg::Fault::kType,
        msg::Command::kType})
    all += schema_text(type);
  return crc32(std::as_bytes(std::span(all)));
}

TEST(RecordingSchema, IsAnotherOneWhereDefinitionsOfMessagesChange) {
  // One pair for the schema of today. Who changes a definition raises kRecordingSchema, and writes both here.
  EXPECT_EQ(kRecordingSchema, 1);
  EXPECT_EQ(definitions(), 0xb6672947U);
}

}  // namespace
}  // namespace rigor::record
