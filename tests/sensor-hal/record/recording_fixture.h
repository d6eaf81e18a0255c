// Small recordings for the tests of writer, reader and repair.
#pragma once

#include <gtest/gtest.h>

#include <random>
#include <string>
#include <vector>

#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/mcap_writer.h"

namespace rigor::record::test {

inline std::vector<std::byte> noise(std::size_t size, std::uint32_t seed) {
  std::minstd_rand random(seed);
  std::vector<std::byte> bytes(size);
  for (std::byte& b : bytes) b = static_cast<std::byte>(random() >> 3);
  return bytes;
}

/// What a message is, by value.
struct Kept {
  std::string topic;
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0;
  std::uint64_t publish_time_ns = 0;
  std::vector<std::byte> data;
  bool operator==(const Kept&) const = default;
};

/// Writes to a MemorySink that outlives the writer.
class SharedSink final : public ByteSink {
 public:
  explicit SharedSink(MemorySink& to) : to_(&to) {}
  Status append(Pieces pieces) override { return to_->append(pieces); }
  Status truncate(std::uint64_t size) override { return to_->truncate(size); }
  Status sync() override { return {}; }
  std::string name() const override { return "memory"; }

 private:
  MemorySink* to_;
};

template <class T>
T must(Result<T> result) {
  if (!result) throw std::runtime_error(result.error().text());
  return std::move(*result);
}
inline void must(Status status) {
  if (!status) throw std::runtime_error(status.error().text());
}

/// Some messages on two channels, of which a few are large enough to end a chunk; returns what was written.
inline std::vector<Kept> write_messages(McapWriter& writer, std::size_t count,
                                        std::size_t large_bytes = 300) {
  const auto schema = must(writer.add_schema("std_msgs/msg/String", "ros2msg", "string data"));
  const auto a =
      must(writer.add_channel({.schema = schema, .topic = "/a", .metadata = {{"offered_qos_profiles", ""}}}));
  const auto b = must(writer.add_channel({.schema = schema, .topic = "/b"}));
  std::vector<Kept> kept;
  for (std::uint32_t i = 0; i < count; ++i) {
    const bool large = i % 4 == 3;
    Kept m{large ? "/b" : "/a", i, 1'000'000'000ull + i * 10'000'000ull, 999'000'000ull + i * 10'000'000ull,
           noise(large ? large_bytes : 10 + i, i)};
    must(writer.write({large ? b : a, m.sequence, m.log_time_ns, m.publish_time_ns}, Bytes(m.data)));
    kept.push_back(std::move(m));
  }
  return kept;
}

inline WriterOptions small_chunks(Compression compression = Compression::none) {
  return {.compression = compression, .chunk_bytes = 512, .direct_bytes = 256};
}

struct Recording {
  std::vector<std::byte> bytes;
  std::vector<Kept> messages;
};

inline Recording make_recording(WriterOptions options, std::size_t count = 24, bool closed = true) {
  MemorySink memory;
  auto writer = must(McapWriter::open(std::make_unique<SharedSink>(memory), options));
  Recording recording;
  recording.messages = write_messages(*writer, count);
  must(writer->add_metadata({"rig", {{"seed", "7"}, {"name", "bench"}}}));
  must(writer->add_attachment({"rig.yaml", "text/yaml", 5, 6, noise(40, 1)}));
  if (closed) must(writer->close());
  recording.bytes = memory.bytes();
  return recording;
}

inline std::vector<Kept> read_all(McapReader& reader, MessageFilter filter = {}) {
  MessageCursor cursor = reader.messages(std::move(filter));
  std::vector<Kept> kept;
  MessageView m;
  while (must(cursor.next(m)))
    kept.push_back(
        {m.channel->topic, m.sequence, m.log_time_ns, m.publish_time_ns, {m.data.begin(), m.data.end()}});
  return kept;
}

inline std::unique_ptr<McapReader> open_bytes(Bytes bytes, ReaderOptions options = {}) {
  return must(McapReader::open(memory_source(bytes), options));
}

}  // namespace rigor::record::test
