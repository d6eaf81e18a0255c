#include "sensor-hal/record/mcap_parse.h"

#include <lz4frame.h>
#include <zstd.h>

#include "sensor-hal/record/crc32.h"

namespace rigor::record {

StringMap FieldReader::map() {
  StringMap result;
  FieldReader in(take(get<std::uint32_t>()));
  while (ok_ && in.left() > 0) {
    const std::string_view key = in.text();
    const std::string_view value = in.text();
    if (!in.ok() || !result.emplace(key, value).second) ok_ = false;
  }
  return result;
}

std::optional<RecordView> next_record(FieldReader& in) {
  if (in.left() < kRecordHeaderBytes) return std::nullopt;
  FieldReader peek = in;
  RecordView record;
  record.offset = in.position();
  record.op = static_cast<Opcode>(peek.get<std::uint8_t>());
  record.body = peek.take(peek.get<std::uint64_t>());
  if (!peek.ok()) return std::nullopt;
  in = peek;
  return record;
}

std::optional<Schema> parse_schema(Bytes body) {
  FieldReader in(body);
  Schema schema;
  schema.id = in.get<std::uint16_t>();
  schema.name = in.text();
  schema.encoding = in.text();
  schema.text = in.text();
  if (!in.ok() || schema.id == 0) return std::nullopt;
  return schema;
}

std::optional<Channel> parse_channel(Bytes body) {
  FieldReader in(body);
  Channel channel;
  channel.id = in.get<std::uint16_t>();
  channel.schema = in.get<std::uint16_t>();
  channel.topic = in.text();
  channel.message_encoding = in.text();
  channel.metadata = in.map();
  if (!in.ok()) return std::nullopt;
  return channel;
}

std::optional<Metadata> parse_metadata(Bytes body) {
  FieldReader in(body);
  Metadata metadata;
  metadata.name = in.text();
  metadata.values = in.map();
  if (!in.ok()) return std::nullopt;
  return metadata;
}

std::optional<Attachment> parse_attachment(Bytes body) {
  FieldReader in(body);
  Attachment attachment;
  attachment.log_time_ns = in.get<std::uint64_t>();
  attachment.create_time_ns = in.get<std::uint64_t>();
  attachment.name = in.text();
  attachment.media_type = in.text();
  const Bytes data = in.take(in.get<std::uint64_t>());
  const std::size_t covered = in.position();
  const auto crc = in.get<std::uint32_t>();
  if (!in.ok() || (crc != 0 && crc != crc32(body.first(covered)))) return std::nullopt;
  attachment.data.assign(data.begin(), data.end());
  return attachment;
}

std::optional<ChunkHeader> parse_chunk_header(FieldReader& in) {
  ChunkHeader chunk;
  chunk.start_ns = in.get<std::uint64_t>();
  chunk.end_ns = in.get<std::uint64_t>();
  chunk.uncompressed = in.get<std::uint64_t>();
  chunk.crc = in.get<std::uint32_t>();
  chunk.compression = in.text();
  chunk.stored = in.get<std::uint64_t>();
  if (!in.ok()) return std::nullopt;
  return chunk;
}

namespace {

Status bad(std::string message) { return fail(ErrorCode::protocol, "", std::move(message)); }

Status decompress_lz4(Bytes in, std::span<std::byte> out) {
  LZ4F_dctx* context = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION)) != 0)
    return fail(ErrorCode::internal, "", "lz4 has no memory");
  const std::unique_ptr<LZ4F_dctx, LZ4F_errorCode_t (*)(LZ4F_dctx*)> owner(context,
                                                                           LZ4F_freeDecompressionContext);
  std::size_t hint = 1;
  std::size_t filled = 0;
  while (hint != 0) {
    std::size_t room = out.size() - filled;
    std::size_t used = in.size();
    hint = LZ4F_decompress(context, out.data() + filled, &room, in.data(), &used, nullptr);
    if (LZ4F_isError(hint) != 0)
      return bad(std::string("the lz4 data are damaged: ") + LZ4F_getErrorName(hint));
    filled += room;
    in = in.subspan(used);
    if (hint != 0 && room == 0 && used == 0) break;  // wants more input, or has more output than was said
  }
  if (hint != 0 || filled != out.size() || !in.empty())
    return bad("the lz4 data do not have the size that the chunk states");
  return {};
}

}  // namespace

bool plausible_size(const std::string& compression, Bytes in, std::uint64_t uncompressed) {
  if (compression.empty()) return uncompressed == in.size();
  if (compression == "lz4") return uncompressed / 255 <= in.size();  // the format cannot do better
  if (compression != "zstd") return true;
  const unsigned long long stated = ZSTD_getFrameContentSize(in.data(), in.size());
  if (stated == ZSTD_CONTENTSIZE_ERROR) return uncompressed == 0 && in.empty();
  if (stated == ZSTD_CONTENTSIZE_UNKNOWN)
    return uncompressed / (128u << 10) <= in.size();  // a block is 4 bytes at least
  return stated == uncompressed;
}

Status decompress(const std::string& compression, Bytes in, std::span<std::byte> out) {
  if (compression.empty()) {
    if (in.size() != out.size()) return bad("a chunk without compression must have one size, it states two");
    if (!in.empty()) std::memcpy(out.data(), in.data(), in.size());
    return {};
  }
  if (compression == "lz4") return decompress_lz4(in, out);
  if (compression == "zstd") {
    // One for each thread: to set one up takes longer than to unpack a small chunk.
    thread_local const std::unique_ptr<ZSTD_DCtx, std::size_t (*)(ZSTD_DCtx*)> context(ZSTD_createDCtx(),
                                                                                       ZSTD_freeDCtx);
    if (!context) return fail(ErrorCode::unavailable, "", "zstd has no memory");
    const std::size_t size = ZSTD_decompressDCtx(context.get(), out.data(), out.size(), in.data(), in.size());
    if (ZSTD_isError(size) != 0)
      return bad(std::string("the zstd data are damaged: ") + ZSTD_getErrorName(size));
    if (size != out.size()) return bad("the zstd data do not have the size that the chunk states");
    return {};
  }
  return bad("expected a chunk compressed by lz4, zstd or nothing, got '" + compression.substr(0, 32) + "'");
}

}  // namespace rigor::record
