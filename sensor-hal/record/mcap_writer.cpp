#include "sensor-hal/record/mcap_writer.h"

#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>
#include <limits>

#include "sensor-hal/record/crc32.h"

namespace rigor::record {
namespace {

constexpr std::size_t kSummaryPiece = std::size_t{256} << 10;

/// Opens a record in `out`, and fills in its length when it is done.
class Record {
 public:
  Record(ByteBuffer& out, Opcode op) : out_(out) {
    out_.put(op);
    out_.put(std::uint64_t{0});
    body_ = out_.size();
  }
  ~Record() {
    const std::uint64_t length = out_.size() - body_;
    std::memcpy(out_.data() + body_ - 8, &length, 8);
  }
  Record(const Record&) = delete;
  Record& operator=(const Record&) = delete;

 private:
  ByteBuffer& out_;
  std::size_t body_;
};

void put_schema(ByteBuffer& out, const Schema& schema) {
  const Record record(out, Opcode::schema);
  out.put(schema.id);
  out.put(std::string_view(schema.name));
  out.put(std::string_view(schema.encoding));
  out.put(std::string_view(schema.text));
}

void put_channel(ByteBuffer& out, const Channel& channel) {
  const Record record(out, Opcode::channel);
  out.put(channel.id);
  out.put(channel.schema);
  out.put(std::string_view(channel.topic));
  out.put(std::string_view(channel.message_encoding));
  out.put(channel.metadata);
}

}  // namespace

struct McapWriter::Compressor {
  ZSTD_CCtx* zstd = nullptr;
  ByteBuffer out;
  Compressor() = default;
  Compressor(const Compressor&) = delete;
  Compressor& operator=(const Compressor&) = delete;
  ~Compressor() { ZSTD_freeCCtx(zstd); }
};

McapWriter::McapWriter(std::unique_ptr<ByteSink> sink, WriterOptions options)
    : sink_(std::move(sink)), options_(std::move(options)), compressor_(std::make_unique<Compressor>()) {
  chunk_.reserve(options_.chunk_bytes + (options_.chunk_bytes >> 3));
}

McapWriter::~McapWriter() {
  if (!closed_) (void)close();
}

Result<std::unique_ptr<McapWriter>> McapWriter::open(std::unique_ptr<ByteSink> sink, WriterOptions options) {
  std::unique_ptr<McapWriter> writer(new McapWriter(std::move(sink), std::move(options)));
  if (writer->options_.compression == Compression::zstd) {
    writer->compressor_->zstd = ZSTD_createCCtx();
    const std::size_t set = ZSTD_CCtx_setParameter(writer->compressor_->zstd, ZSTD_c_compressionLevel,
                                                   writer->options_.zstd_level);
    if (ZSTD_isError(set) != 0) {
      writer->closed_ = true;
      return fail(ErrorCode::bad_input, writer->sink_->name(), "zstd does not know this compression level");
    }
  }
  ByteBuffer start;
  start.append(kMagic.data(), kMagic.size());
  {
    const Record record(start, Opcode::header);
    start.put(std::string_view(writer->options_.profile));
    start.put(std::string_view(writer->options_.library));
  }
  const Bytes bytes = start.bytes();
  if (Status status = writer->append({&bytes, 1}); !status) {
    writer->closed_ = true;
    return tl::unexpected(status.error());
  }
  return writer;
}

Status McapWriter::ready() const {
  if (error_) return tl::unexpected(*error_);
  if (closed_) return fail(ErrorCode::wrong_state, sink_->name(), "this recording is closed already");
  return {};
}

/// Appends whole records, or nothing.
Status McapWriter::append(Pieces pieces) {
  Status status = sink_->append(pieces);
  if (!status) {
    error_ = status.error();
    if (Status cut = sink_->truncate(position_); !cut) error_->message += "; " + cut.error().message;
    return tl::unexpected(*error_);
  }
  for (const Bytes& piece : pieces) {
    position_ += piece.size();
    if (options_.checksums && !closed_) data_crc_ = crc32(piece, data_crc_);
  }
  statistics_.file_bytes = position_;
  return {};
}

Result<std::uint16_t> McapWriter::add_schema(const std::string& name, const std::string& encoding,
                                             const std::string& text) {
  if (Status status = ready(); !status) return tl::unexpected(status.error());
  if (schemas_.size() >= std::numeric_limits<std::uint16_t>::max())
    return fail(ErrorCode::bad_input, sink_->name(), "a recording holds at most 65535 schemas");
  schemas_.push_back({static_cast<std::uint16_t>(schemas_.size() + 1), name, encoding, text});
  put_schema(chunk_, schemas_.back());
  return schemas_.back().id;
}

Result<std::uint16_t> McapWriter::add_channel(const ChannelOptions& channel) {
  if (Status status = ready(); !status) return tl::unexpected(status.error());
  if (channel.schema > schemas_.size())
    return fail(ErrorCode::internal, channel.topic,
                "schema " + std::to_string(channel.schema) + " was not added");
  if (channels_.size() >= std::numeric_limits<std::uint16_t>::max())
    return fail(ErrorCode::bad_input, sink_->name(), "a recording holds at most 65535 channels");
  channels_.push_back({static_cast<std::uint16_t>(channels_.size()), channel.schema, channel.topic,
                       channel.message_encoding, channel.metadata});
  channel_messages_.push_back(0);
  indexes_.emplace_back();
  put_channel(chunk_, channels_.back());
  return channels_.back().id;
}

Status McapWriter::write(const MessageInfo& message, Pieces pieces) {
  if (Status status = advance(message.log_time_ns); !status) return status;
  if (message.channel >= channels_.size())
    return fail(ErrorCode::internal, sink_->name(),
                "channel " + std::to_string(message.channel) + " was not added to this recording");
  std::uint64_t length = kMessageHeaderBytes;
  for (const Bytes& piece : pieces) length += piece.size();

  if (chunk_messages_ == 0) {
    chunk_first_ns_ = chunk_start_ns_ = chunk_end_ns_ = message.log_time_ns;
  } else {
    chunk_start_ns_ = std::min(chunk_start_ns_, message.log_time_ns);
    chunk_end_ns_ = std::max(chunk_end_ns_, message.log_time_ns);
  }
  ++chunk_messages_;
  auto& index = indexes_[message.channel];
  if (index.empty()) touched_.push_back(message.channel);
  index.push_back({message.log_time_ns, chunk_.size()});

  chunk_.put(Opcode::message);
  chunk_.put(length);
  chunk_.put(message.channel);
  chunk_.put(message.sequence);
  chunk_.put(message.log_time_ns);
  chunk_.put(message.publish_time_ns);
  if (options_.compression == Compression::none && length >= options_.direct_bytes) return end_chunk(pieces);
  for (const Bytes& piece : pieces) chunk_.append(piece);
  return chunk_.size() >= options_.chunk_bytes ? end_chunk({}) : Status{};
}

Status McapWriter::advance(std::uint64_t log_time_ns) {
  if (Status status = ready(); !status) return status;
  const auto span_ns = static_cast<std::uint64_t>(options_.chunk_span.ns());
  if (chunk_messages_ > 0 && log_time_ns >= chunk_first_ns_ && log_time_ns - chunk_first_ns_ >= span_ns)
    return end_chunk({});
  return {};
}

Status McapWriter::flush() {
  if (Status status = ready(); !status) return status;
  return chunk_.empty() ? Status{} : end_chunk({});
}

Bytes McapWriter::compress() {
  ByteBuffer& out = compressor_->out;
  const Bytes in = chunk_.bytes();
  if (options_.compression == Compression::zstd) {
    out.resize(ZSTD_compressBound(in.size()));
    const std::size_t size = ZSTD_compress2(compressor_->zstd, out.data(), out.size(), in.data(), in.size());
    if (ZSTD_isError(size) != 0) return {};
    out.resize(size);
  } else {
    LZ4F_preferences_t preferences{};
    preferences.frameInfo.contentSize = in.size();
    preferences.frameInfo.blockSizeID = LZ4F_max1MB;
    preferences.frameInfo.blockMode = LZ4F_blockIndependent;
    out.resize(LZ4F_compressFrameBound(in.size(), &preferences));
    const std::size_t size = LZ4F_compressFrame(out.data(), out.size(), in.data(), in.size(), &preferences);
    if (LZ4F_isError(size) != 0) return {};
    out.resize(size);
  }
  return out.bytes();
}

/// Hands the open chunk to the sink, `tail` being the end of its last message.
Status McapWriter::end_chunk(Pieces tail) {
  std::uint64_t uncompressed = chunk_.size();
  std::uint32_t chunk_crc = 0;
  if (options_.checksums) chunk_crc = crc32(chunk_.bytes());
  for (const Bytes& piece : tail) {
    uncompressed += piece.size();
    if (options_.checksums) chunk_crc = crc32(piece, chunk_crc);
  }
  Bytes records = chunk_.bytes();
  if (options_.compression != Compression::none) {
    records = compress();
    if (records.empty()) {
      error_ = Error{ErrorCode::internal, sink_->name(), "the compressor failed"};
      return tl::unexpected(*error_);
    }
  }
  std::uint64_t stored = records.size();
  for (const Bytes& piece : tail) stored += piece.size();

  scratch_.clear();
  const std::string_view compression = to_string(options_.compression);
  scratch_.put(Opcode::chunk);
  scratch_.put(std::uint64_t{8 + 8 + 8 + 4 + 4 + compression.size() + 8} + stored);
  scratch_.put(chunk_messages_ > 0 ? chunk_start_ns_ : std::uint64_t{0});
  scratch_.put(chunk_messages_ > 0 ? chunk_end_ns_ : std::uint64_t{0});
  scratch_.put(uncompressed);
  scratch_.put(chunk_crc);
  scratch_.put(compression);
  scratch_.put(stored);

  ChunkPlace& chunk = place_;
  chunk.start_ns = chunk_messages_ > 0 ? chunk_start_ns_ : 0;
  chunk.end_ns = chunk_messages_ > 0 ? chunk_end_ns_ : 0;
  chunk.offset = position_;
  chunk.length = scratch_.size() + stored;
  chunk.compressed = stored;
  chunk.uncompressed = uncompressed;

  chunk.index_offsets.clear();
  index_scratch_.clear();
  std::sort(touched_.begin(), touched_.end());
  for (const std::uint16_t channel : touched_) {
    auto& entries = indexes_[channel];
    chunk.index_offsets.emplace_back(channel, position_ + chunk.length + index_scratch_.size());
    const Record record(index_scratch_, Opcode::message_index);
    index_scratch_.put(channel);
    const auto bytes = entries.size() * sizeof(IndexEntry);
    index_scratch_.put(static_cast<std::uint32_t>(bytes));
    index_scratch_.append(entries.data(), bytes);
  }
  chunk.index_length = index_scratch_.size();

  pieces_.clear();
  pieces_.push_back(scratch_.bytes());
  pieces_.push_back(records);
  pieces_.insert(pieces_.end(), tail.begin(), tail.end());
  pieces_.push_back(index_scratch_.bytes());
  Status status = sink_->append(pieces_);
  if (!status) {
    error_ = status.error();
    statistics_.lost_messages += chunk_messages_;
    if (Status cut = sink_->truncate(position_); !cut) error_->message += "; " + cut.error().message;
    return tl::unexpected(*error_);
  }
  if (options_.checksums) {
    data_crc_ = crc32(scratch_.bytes(), data_crc_);
    const std::uint32_t stored_crc = options_.compression == Compression::none ? chunk_crc : crc32(records);
    data_crc_ = crc32_combine(data_crc_, stored_crc, stored);
    data_crc_ = crc32(index_scratch_.bytes(), data_crc_);
  }
  position_ += chunk.length + chunk.index_length;

  if (chunk_messages_ > 0) {
    first_ns_ = statistics_.messages == 0 ? chunk_start_ns_ : std::min(first_ns_, chunk_start_ns_);
    last_ns_ = std::max(last_ns_, chunk_end_ns_);
  }
  statistics_.messages += chunk_messages_;
  ++statistics_.chunks;
  statistics_.file_bytes = position_;
  for (const std::uint16_t channel : touched_) {
    channel_messages_[channel] += indexes_[channel].size();
    indexes_[channel].clear();
  }
  touched_.clear();
  chunks_.add(chunk);
  chunk_.clear();
  chunk_messages_ = 0;
  return {};
}

Status McapWriter::add_metadata(const Metadata& metadata) {
  if (Status status = flush(); !status) return status;
  scratch_.clear();
  {
    const Record record(scratch_, Opcode::metadata);
    scratch_.put(std::string_view(metadata.name));
    scratch_.put(metadata.values);
  }
  const std::uint64_t offset = position_;
  const Bytes bytes = scratch_.bytes();
  if (Status status = append({&bytes, 1}); !status) return status;
  const Record record(metadata_indexes_, Opcode::metadata_index);
  metadata_indexes_.put(offset);
  metadata_indexes_.put(std::uint64_t{bytes.size()});
  metadata_indexes_.put(std::string_view(metadata.name));
  ++metadata_;
  return {};
}

Status McapWriter::add_attachment(const Attachment& attachment) {
  if (Status status = flush(); !status) return status;
  scratch_.clear();
  scratch_.put(Opcode::attachment);
  scratch_.put(std::uint64_t{8 + 8 + 4 + attachment.name.size() + 4 + attachment.media_type.size() + 8 +
                             attachment.data.size() + 4});
  scratch_.put(attachment.log_time_ns);
  scratch_.put(attachment.create_time_ns);
  scratch_.put(std::string_view(attachment.name));
  scratch_.put(std::string_view(attachment.media_type));
  scratch_.put(std::uint64_t{attachment.data.size()});
  const std::uint32_t crc =
      options_.checksums ? crc32(attachment.data, crc32(scratch_.bytes().subspan(kRecordHeaderBytes))) : 0;
  const std::array<Bytes, 3> pieces{scratch_.bytes(), Bytes(attachment.data),
                                    std::as_bytes(std::span(&crc, 1))};
  const std::uint64_t offset = position_;
  if (Status status = append(pieces); !status) return status;
  const Record record(attachment_indexes_, Opcode::attachment_index);
  attachment_indexes_.put(offset);
  attachment_indexes_.put(position_ - offset);
  attachment_indexes_.put(attachment.log_time_ns);
  attachment_indexes_.put(attachment.create_time_ns);
  attachment_indexes_.put(std::uint64_t{attachment.data.size()});
  attachment_indexes_.put(std::string_view(attachment.name));
  attachment_indexes_.put(std::string_view(attachment.media_type));
  ++attachments_;
  return {};
}

/// Appends the end of the file: all of it, or nothing.
Status McapWriter::append_summary() {
  const std::uint64_t start = position_;
  Status status = append_summary(scratch_);
  if (status || position_ == start) return status;
  position_ = start;
  statistics_.file_bytes = start;
  if (Status cut = sink_->truncate(start); !cut) error_->message += "; " + cut.error().message;
  return tl::unexpected(*error_);
}

/// Through `out`, in pieces of about kSummaryPiece.
Status McapWriter::append_summary(ByteBuffer& out) {
  out.clear();
  {
    const Record record(out, Opcode::data_end);
    out.put(data_crc_);
  }
  const std::uint64_t summary_start = position_ + out.size();
  std::size_t not_of_summary = out.size();  // at the start of `out`
  std::uint32_t crc = 0;
  Status status;
  const auto append_piece = [&] {
    if (!status) return;
    if (options_.checksums) crc = crc32(out.bytes().subspan(not_of_summary), crc);
    not_of_summary = 0;
    const Bytes bytes = out.bytes();
    status = append({&bytes, 1});
    out.clear();
  };
  ByteBuffer offsets;
  const auto group = [&](Opcode op, auto&& fill) {
    const std::uint64_t start = position_ + out.size();
    fill();
    const std::uint64_t length = position_ + out.size() - start;
    if (length == 0) return;
    const Record record(offsets, Opcode::summary_offset);
    offsets.put(op);
    offsets.put(start);
    offsets.put(length);
  };
  group(Opcode::schema, [&] {
    for (const Schema& schema : schemas_) put_schema(out, schema);
  });
  group(Opcode::channel, [&] {
    for (const Channel& channel : channels_) put_channel(out, channel);
  });
  group(Opcode::statistics, [&] {
    const Record record(out, Opcode::statistics);
    out.put(statistics_.messages);
    out.put(static_cast<std::uint16_t>(schemas_.size()));
    out.put(static_cast<std::uint32_t>(channels_.size()));
    out.put(attachments_);
    out.put(metadata_);
    out.put(static_cast<std::uint32_t>(chunks_.size()));
    out.put(first_ns_);
    out.put(last_ns_);
    out.put(static_cast<std::uint32_t>(channels_.size() * 10));
    for (std::size_t i = 0; i < channels_.size(); ++i)
      out.put(channels_[i].id), out.put(channel_messages_[i]);
  });
  group(Opcode::chunk_index, [&] {
    ChunkList::Cursor cursor(chunks_);
    while (const ChunkPlace* chunk = cursor.next()) {
      if (out.size() >= kSummaryPiece) append_piece();
      if (!status) return;
      const Record record(out, Opcode::chunk_index);
      out.put(chunk->start_ns);
      out.put(chunk->end_ns);
      out.put(chunk->offset);
      out.put(chunk->length);
      out.put(static_cast<std::uint32_t>(chunk->index_offsets.size() * 10));
      for (const auto& [channel, offset] : chunk->index_offsets) out.put(channel), out.put(offset);
      out.put(chunk->index_length);
      out.put(to_string(options_.compression));
      out.put(chunk->compressed);
      out.put(chunk->uncompressed);
    }
  });
  group(Opcode::attachment_index, [&] { out.append(attachment_indexes_.bytes()); });
  group(Opcode::metadata_index, [&] { out.append(metadata_indexes_.bytes()); });
  const std::uint64_t offsets_start = position_ + out.size();
  out.append(offsets.bytes());
  out.put(Opcode::footer);
  out.put(std::uint64_t{kFooterBytes});
  out.put(summary_start);
  out.put(offsets_start);
  out.put(options_.checksums ? crc32(out.bytes().subspan(not_of_summary), crc) : std::uint32_t{0});
  out.append(kMagic.data(), kMagic.size());
  const Bytes bytes = out.bytes();
  return status ? append({&bytes, 1}) : status;
}

Status McapWriter::close() {
  if (closed_) return error_ ? Status(tl::unexpected(*error_)) : Status{};
  Status status = flush();
  closed_ = true;
  if (!error_) return append_summary();
  if (error_->code != ErrorCode::disk_full) return status;
  // Cutting back the broken chunk has made some room: often enough for the summary, and then the file is
  // complete.
  const Error first = *error_;
  (void)append_summary();
  error_ = first;
  return tl::unexpected(first);
}

}  // namespace rigor::record
