// Writes a recording: one MCAP file, complete with chunks, indexes, statistics and checksums.
//
//   auto writer = McapWriter::open(std::move(sink), {.compression = Compression::zstd});
//   auto schema = (*writer)->add_schema("sensor_msgs/msg/Image", "ros2msg", text);
//   auto channel = (*writer)->add_channel({.schema = *schema, .topic = "/camera/image_raw"});
//   (*writer)->write({.channel = *channel, .log_time_ns = t}, pieces);
//   (*writer)->close();
//
// A chunk is what survives: it goes to the sink in one call, with its indexes, and a file that ends after any
// chunk can be read and repaired. Chunks close when they hold `chunk_bytes`, or when a message comes (or
// advance() says) that bench time has moved on by `chunk_span`; never on wall time, so that the same messages
// give the same bytes. With the default span of 0.5 s a process that is killed loses less than the last
// second.
//
// Uncompressed, a message of `direct_bytes` or more ends its chunk at once, and its pieces go from the
// caller's memory to the kernel without a copy in between.
//
// What is kept in memory until close(): for each chunk some 30 bytes and 2 or 3 for each topic in it
// (chunk_list.h).
//
// All calls: one thread at a time, an I/O thread; may block and allocate. After a failed append the output is
// cut back to its last whole chunk, and every further write gives the same error.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sensor-hal/record/byte_io.h"
#include "sensor-hal/record/chunk_list.h"
#include "sensor-hal/record/mcap_format.h"
#include "sensor-hal/record/message_writer.h"

namespace rigor::record {

struct WriterOptions {
  std::string profile = "ros2";
  std::string library = "rigor";
  Compression compression = Compression::none;
  int zstd_level = 1;
  std::size_t chunk_bytes = std::size_t{1} << 20;
  Duration chunk_span = milliseconds(500);  ///< of log time
  std::size_t direct_bytes = std::size_t{128} << 10;
  bool checksums = true;
};

class McapWriter final : public MessageWriter {
 public:
  /// Writes the start of the file.
  [[nodiscard]] static Result<std::unique_ptr<McapWriter>> open(std::unique_ptr<ByteSink> sink,
                                                                WriterOptions options = {});
  /// Closes the file if close() was not called; an error is then lost, so call it.
  ~McapWriter() override;
  McapWriter(const McapWriter&) = delete;
  McapWriter& operator=(const McapWriter&) = delete;

  [[nodiscard]] Result<std::uint16_t> add_schema(const std::string& name, const std::string& encoding,
                                                 const std::string& text) override;
  [[nodiscard]] Result<std::uint16_t> add_channel(const ChannelOptions& channel) override;
  [[nodiscard]] Status write(const MessageInfo& message, Pieces pieces) override;
  [[nodiscard]] Status write(const MessageInfo& message, Bytes data) {
    return write(message, Pieces(&data, 1));
  }
  /// Bench time has come this far, though there may be no message to say so: closes a chunk that is old
  /// enough.
  [[nodiscard]] Status advance(std::uint64_t log_time_ns) override;
  [[nodiscard]] Status add_metadata(const Metadata& metadata) override;
  [[nodiscard]] Status add_attachment(const Attachment& attachment);
  /// Ends the open chunk and hands it to the sink.
  [[nodiscard]] Status flush();
  /// Writes the rest, the summary and the end of the file. Later calls of any kind are errors (wrong_state).
  [[nodiscard]] Status close() override;

  /// After close(): returns when the file is safe against loss of power.
  [[nodiscard]] Status sync() { return sink_->sync(); }

  [[nodiscard]] const WriterStatistics& statistics() const override { return statistics_; }

 private:
  struct IndexEntry {
    std::uint64_t log_time_ns;
    std::uint64_t offset;
  };
  struct Compressor;

  McapWriter(std::unique_ptr<ByteSink> sink, WriterOptions options);
  Status ready() const;
  Status append(Pieces pieces);
  Status end_chunk(Pieces tail);
  Status append_summary();
  Status append_summary(ByteBuffer& out);
  Bytes compress();

  std::unique_ptr<ByteSink> sink_;
  WriterOptions options_;
  std::unique_ptr<Compressor> compressor_;
  std::optional<Error> error_;
  bool closed_ = false;

  std::uint64_t position_ = 0;  ///< bytes in the sink: the end of the last whole record
  std::uint32_t data_crc_ = 0;  ///< of those bytes

  std::vector<Schema> schemas_;
  std::vector<Channel> channels_;
  std::vector<std::uint64_t> channel_messages_;

  ByteBuffer chunk_;                              ///< records of the open chunk
  std::vector<std::vector<IndexEntry>> indexes_;  ///< of the open chunk, by channel
  std::vector<std::uint16_t> touched_;            ///< channels with messages in the open chunk
  std::uint64_t chunk_first_ns_ = 0;              ///< log time of the first message
  std::uint64_t chunk_start_ns_ = 0;
  std::uint64_t chunk_end_ns_ = 0;
  std::uint64_t chunk_messages_ = 0;

  ChunkList chunks_;
  ChunkPlace place_;  ///< of the chunk that is being handed over
  ByteBuffer attachment_indexes_;
  ByteBuffer metadata_indexes_;
  std::uint32_t attachments_ = 0;
  std::uint32_t metadata_ = 0;
  std::uint64_t first_ns_ = 0;
  std::uint64_t last_ns_ = 0;

  ByteBuffer scratch_;
  ByteBuffer index_scratch_;
  std::vector<Bytes> pieces_;
  WriterStatistics statistics_;
};

}  // namespace rigor::record
