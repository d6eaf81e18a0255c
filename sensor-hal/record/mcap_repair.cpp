#include "sensor-hal/record/mcap_repair.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <system_error>

#include "sensor-hal/record/mcap_writer.h"

namespace rigor::record {
namespace {

Compression compression_of(const McapReader& reader) {
  for (const Segment& segment : reader.segments()) {
    if (segment.compression == "zstd") return Compression::zstd;
    if (segment.compression == "lz4") return Compression::lz4;
  }
  return Compression::none;
}

}  // namespace

Result<RepairReport> repair(std::unique_ptr<ByteSource> input, std::unique_ptr<ByteSink> output,
                            RepairOptions options) {
  RepairReport report;
  report.input_bytes = input->size();
  auto opened = McapReader::open(std::move(input), {.scan = true,
                                                    .skip_damaged = true,
                                                    .any_schema = true,
                                                    .salvage_tail = options.salvage_tail,
                                                    .max_loaded_bytes = options.max_loaded_bytes});
  if (!opened) return tl::unexpected(opened.error());
  McapReader& reader = **opened;
  report.health = reader.health();
  report.was_good = reader.health().good();

  // A small recording needs no memory for large chunks.
  const auto chunk_bytes =
      std::clamp<std::uint64_t>(report.input_bytes, 128u << 10, WriterOptions{}.chunk_bytes);
  auto created =
      McapWriter::open(std::move(output), {.profile = reader.profile().empty() ? "ros2" : reader.profile(),
                                           .library = "rigor",
                                           .compression = compression_of(reader),
                                           .chunk_bytes = static_cast<std::size_t>(chunk_bytes)});
  if (!created) return tl::unexpected(created.error());
  McapWriter& writer = **created;
  std::map<std::uint16_t, std::uint16_t> schemas{{std::uint16_t{0}, std::uint16_t{0}}};
  std::map<std::uint16_t, std::uint16_t> channels;
  for (const auto& [id, schema] : reader.schemas()) {
    auto added = writer.add_schema(schema.name, schema.encoding, schema.text);
    if (!added) return tl::unexpected(added.error());
    schemas[id] = *added;
  }
  for (const auto& [id, channel] : reader.channels()) {
    const auto schema = schemas.find(channel.schema);
    auto added = writer.add_channel({.schema = schema == schemas.end() ? std::uint16_t{0} : schema->second,
                                     .topic = channel.topic,
                                     .message_encoding = channel.message_encoding,
                                     .metadata = channel.metadata});
    if (!added) return tl::unexpected(added.error());
    channels[id] = *added;
  }
  MessageCursor cursor = reader.messages({.order = MessageOrder::file});
  MessageView message;
  while (true) {
    Result<bool> more = cursor.next(message);
    if (!more) return tl::unexpected(more.error());
    if (!*more) break;
    const MessageInfo info{channels.at(message.channel->id), message.sequence, message.log_time_ns,
                           message.publish_time_ns};
    if (Status status = writer.write(info, message.data); !status) return tl::unexpected(status.error());
    ++report.messages;
  }
  for (std::size_t i = 0; i < reader.attachment_count(); ++i) {
    const auto attachment = reader.attachment(i);
    if (!attachment) {
      ++report.attachments_lost;
      continue;
    }
    if (Status status = writer.add_attachment(*attachment); !status) return tl::unexpected(status.error());
  }
  for (const Metadata& metadata : reader.readable_metadata())
    if (Status status = writer.add_metadata(metadata); !status) return tl::unexpected(status.error());
  if (Status status = writer.close(); !status) return tl::unexpected(status.error());
  if (Status status = writer.sync(); !status) return tl::unexpected(status.error());
  report.output_bytes = writer.statistics().file_bytes;
  return report;
}

Result<RepairReport> repair(const std::string& input, const std::string& output, RepairOptions options) {
  auto source = open_file_source(input);
  if (!source) return tl::unexpected(source.error());
  const std::string temporary = output + ".repair";
  auto sink = open_file_sink(temporary, {.overwrite = true});
  if (!sink) return tl::unexpected(sink.error());
  auto report = repair(std::move(*source), std::move(*sink), options);
  if (!report) {
    ::unlink(temporary.c_str());
    return report;
  }
  if (std::rename(temporary.c_str(), output.c_str()) != 0) {
    const int error = errno;
    ::unlink(temporary.c_str());
    return fail(ErrorCode::not_writable, output,
                "cannot give the repaired file its name: " + std::generic_category().message(error));
  }
  return report;
}

}  // namespace rigor::record
