#include "sensor-hal/record/chunk_records.h"

#include "sensor-hal/record/crc32.h"
#include "sensor-hal/record/mcap_parse.h"

namespace rigor::record {

Result<Bytes> chunk_records(const Segment& segment, Bytes record, ByteBuffer& unpacked,
                            const std::string& file, const ChunkLimits& limits) {
  const auto damaged = [&](const std::string& what) {
    return fail(ErrorCode::protocol, file, "byte " + std::to_string(segment.offset) + ": " + what);
  };
  FieldReader in(record);
  const auto op = static_cast<Opcode>(in.get<std::uint8_t>());
  const auto length = in.get<std::uint64_t>();
  const auto header = parse_chunk_header(in);
  if (op != Opcode::chunk || length != segment.length - kRecordHeaderBytes || !header ||
      header->stored != in.left())
    return damaged("expected a chunk of " + std::to_string(segment.length) + " bytes");
  if (header->compression != segment.compression || header->uncompressed != segment.uncompressed ||
      header->start_ns != segment.start_ns || header->end_ns != segment.end_ns)
    return damaged("the chunk and its index disagree");
  Bytes records = in.take(in.left());
  if (header->uncompressed > limits.max_bytes)
    return damaged("a chunk of " + std::to_string(header->uncompressed) +
                   " bytes is more than may be held in memory");
  if (!plausible_size(header->compression, records, header->uncompressed) ||
      (header->compression.empty() && header->uncompressed != records.size()))
    return damaged("the chunk cannot have the size that it states, " + std::to_string(header->uncompressed) +
                   " bytes");
  if (!header->compression.empty()) {
    unpacked.resize(static_cast<std::size_t>(header->uncompressed));
    if (Status status = decompress(header->compression, records, {unpacked.data(), unpacked.size()}); !status)
      return damaged(status.error().message);
    records = unpacked.bytes();
  }
  if (limits.verify && header->crc != 0 && crc32(records) != header->crc)
    return damaged("the checksum of this chunk does not match its content");
  return records;
}

}  // namespace rigor::record
