#include "sensor-hal/record/mcap_reader.h"

#include <algorithm>
#include <array>

#include "sensor-hal/record/chunk_records.h"
#include "sensor-hal/record/crc32.h"
#include "sensor-hal/record/mcap_parse.h"
#include "sensor-hal/record/recording_schema.h"

namespace rigor::record {

struct McapReader::Footer {
  std::uint64_t offset = 0;
  std::uint64_t summary_start = 0;
  std::uint32_t crc = 0;
};

namespace {
constexpr std::uint64_t kFooterCovered =
    kRecordHeaderBytes + kFooterBytes - 4;  // bytes that the summary's CRC includes
}

McapReader::McapReader(std::unique_ptr<ByteSource> source, ReaderOptions options)
    : source_(std::move(source)), options_(options) {}

Result<std::unique_ptr<McapReader>> McapReader::open(const std::string& path, ReaderOptions options) {
  auto source = open_file_source(path);
  if (!source) return tl::unexpected(source.error());
  return open(std::move(*source), options);
}

Result<std::unique_ptr<McapReader>> McapReader::open(std::unique_ptr<ByteSource> source,
                                                     ReaderOptions options) {
  std::unique_ptr<McapReader> reader(new McapReader(std::move(source), options));
  if (Status status = reader->read_header(); !status) return tl::unexpected(status.error());
  bool indexed = false;
  if (!options.scan) {
    const Result<bool> by_index = reader->open_by_index();
    if (!by_index) {
      if (by_index.error().code != ErrorCode::protocol) return tl::unexpected(by_index.error());
      reader->note(by_index.error().message);
    }
    indexed = by_index && *by_index;
  }
  if (!indexed) {
    reader->schemas_.clear();
    reader->channels_.clear();
    reader->counts_.clear();
    reader->segments_.clear();
    reader->metadata_refs_.clear();
    reader->attachment_refs_.clear();
    reader->scanning_ = true;
    if (Status status = reader->scan(); !status) return tl::unexpected(status.error());
    reader->scanning_ = false;
  }
  if (!options.any_schema)
    if (Status status = check_schema(reader->name(), reader->readable_metadata()); !status)
      return tl::unexpected(status.error());
  return reader;
}

Error McapReader::damage(std::uint64_t offset, const std::string& what) const {
  return {ErrorCode::protocol, source_->name(), "byte " + std::to_string(offset) + ": " + what};
}

std::uint64_t McapReader::message_count() const {
  std::uint64_t sum = 0;
  for (const auto& [channel, count] : counts_) sum += count;
  return sum;
}

Result<Bytes> McapReader::read_record(std::uint64_t offset, std::uint64_t length) {
  if (length > options_.max_loaded_bytes)
    return tl::unexpected(
        damage(offset, "a record of " + std::to_string(length) + " bytes is more than the " +
                           std::to_string(options_.max_loaded_bytes) + " that may be held in memory"));
  if (const std::uint64_t size = source_->size(); offset > size || length > size - offset)
    return tl::unexpected(
        damage(offset, "a record of " + std::to_string(length) + " bytes goes beyond the file's end"));
  record_.clear();
  record_.resize(static_cast<std::size_t>(length));
  if (Status status = source_->read(offset, {record_.data(), record_.size()}); !status)
    return tl::unexpected(status.error());
  return record_.bytes();
}

Status McapReader::read_header() {
  const std::uint64_t size = source_->size();
  std::array<std::byte, 8> magic{};
  const std::size_t got = static_cast<std::size_t>(std::min<std::uint64_t>(size, magic.size()));
  if (Status status = source_->read(0, std::span(magic).first(got)); !status) return status;
  if (got < magic.size() || std::memcmp(magic.data(), kMagic.data(), magic.size()) != 0)
    return fail(ErrorCode::bad_input, source_->name(),
                got < magic.size()
                    ? "expected an MCAP recording, the file ends after " + std::to_string(got) + " bytes"
                    : "expected an MCAP recording, the file starts with other bytes");
  return {};
}

/// None where the file does not end as a complete one does.
Result<std::optional<McapReader::Footer>> McapReader::read_footer() {
  constexpr std::uint64_t kTail = kRecordHeaderBytes + kFooterBytes + kMagic.size();
  const std::uint64_t size = source_->size();
  if (size < kMagic.size() + kTail) return std::nullopt;
  std::array<std::byte, kTail> tail{};
  if (Status status = source_->read(size - kTail, tail); !status) return tl::unexpected(status.error());
  FieldReader in(tail);
  const auto op = static_cast<Opcode>(in.get<std::uint8_t>());
  const auto length = in.get<std::uint64_t>();
  Footer footer;
  footer.offset = size - kTail;
  footer.summary_start = in.get<std::uint64_t>();
  in.get<std::uint64_t>();  // where the summary offsets start: nothing here needs them
  footer.crc = in.get<std::uint32_t>();
  const Bytes magic = in.take(kMagic.size());
  if (op != Opcode::footer || length != kFooterBytes ||
      std::memcmp(magic.data(), kMagic.data(), kMagic.size()) != 0)
    return std::nullopt;
  return footer;
}

/// False where there is no index to go by; an error of kind protocol where there is one that cannot be
/// trusted.
Result<bool> McapReader::open_by_index() {
  auto footer = read_footer();
  if (!footer) return tl::unexpected(footer.error());
  if (!*footer || (*footer)->summary_start == 0) return false;
  const Footer end = **footer;
  if (end.summary_start < kMagic.size() || end.summary_start > end.offset)
    return tl::unexpected(damage(end.offset, "the footer points outside the file"));

  auto header =
      read_record(kMagic.size(), std::min<std::uint64_t>(end.summary_start - kMagic.size(), 64u << 10));
  if (!header) return tl::unexpected(header.error());
  FieldReader start(*header);
  const auto first = next_record(start);
  if (!first || first->op != Opcode::header)
    return tl::unexpected(damage(kMagic.size(), "expected a header"));
  FieldReader fields(first->body);
  profile_ = fields.text();
  library_ = fields.text();
  if (!fields.ok()) return tl::unexpected(damage(kMagic.size(), "the header is damaged"));

  auto summary = read_record(end.summary_start, end.offset - end.summary_start + kFooterCovered);
  if (!summary) return tl::unexpected(summary.error());
  if (end.crc != 0 && crc32(*summary) != end.crc)
    return tl::unexpected(damage(end.summary_start,
                                 "the checksum of the summary does not match; the file was scanned instead"));
  if (Status status = parse_summary(summary->first(summary->size() - kFooterCovered), end.summary_start);
      !status)
    return tl::unexpected(status.error());
  if (segments_.empty() && message_count() > 0) return false;  // messages outside of chunks have no index
  health_.indexed = true;
  health_.whole_bytes = source_->size();
  return true;
}

Status McapReader::parse_summary(Bytes summary, std::uint64_t summary_start) {
  FieldReader in(summary);
  bool statistics = false;
  const auto bad = [&](const RecordView& record, const char* what) {
    return tl::unexpected(
        damage(summary_start + record.offset, std::string(what) + " in the summary is damaged"));
  };
  while (const auto record = next_record(in)) {
    FieldReader fields(record->body);
    switch (record->op) {
      case Opcode::schema: {
        auto schema = parse_schema(record->body);
        if (!schema) return bad(*record, "a schema");
        if (Status status = declare(std::move(*schema)); !status) return status;
        break;
      }
      case Opcode::channel: {
        auto channel = parse_channel(record->body);
        if (!channel) return bad(*record, "a channel");
        if (Status status = declare(std::move(*channel)); !status) return status;
        break;
      }
      case Opcode::statistics: {
        fields.take(8 + 2 + 4 + 4 + 4 + 4 + 8 + 8);
        FieldReader counts(fields.take(fields.get<std::uint32_t>()));
        while (fields.ok() && counts.ok() && counts.left() > 0) {
          const auto channel = counts.get<std::uint16_t>();
          counts_[channel] = counts.get<std::uint64_t>();
        }
        if (!fields.ok() || !counts.ok()) return bad(*record, "the statistics record");
        statistics = true;
        break;
      }
      case Opcode::chunk_index: {
        Segment segment;
        segment.start_ns = fields.get<std::uint64_t>();
        segment.end_ns = fields.get<std::uint64_t>();
        segment.offset = fields.get<std::uint64_t>();
        segment.length = fields.get<std::uint64_t>();
        FieldReader offsets(fields.take(fields.get<std::uint32_t>()));
        while (fields.ok() && offsets.ok() && offsets.left() > 0) {
          segment.channels.insert(offsets.get<std::uint16_t>());
          offsets.get<std::uint64_t>();
        }
        fields.get<std::uint64_t>();
        segment.compression = fields.text();
        segment.stored = fields.get<std::uint64_t>();
        segment.uncompressed = fields.get<std::uint64_t>();
        const bool within = segment.offset >= kMagic.size() && segment.offset < summary_start &&
                            segment.length > kRecordHeaderBytes &&
                            segment.length <= summary_start - segment.offset;
        if (!fields.ok() || !offsets.ok() || !within) return bad(*record, "a chunk index");
        segments_.push_back(std::move(segment));
        break;
      }
      case Opcode::metadata_index:
      case Opcode::attachment_index: {
        SegmentRef ref;
        ref.offset = fields.get<std::uint64_t>();
        ref.length = fields.get<std::uint64_t>();
        const bool within = ref.offset >= kMagic.size() && ref.offset < summary_start &&
                            ref.length > kRecordHeaderBytes && ref.length <= summary_start - ref.offset;
        if (!fields.ok() || !within) return bad(*record, "an index record");
        (record->op == Opcode::metadata_index ? metadata_refs_ : attachment_refs_).push_back(ref);
        break;
      }
      default:
        break;
    }
  }
  if (in.left() > 0)
    return tl::unexpected(damage(summary_start + in.position(), "the summary ends within a record"));
  if (!statistics && segments_.empty())
    return tl::unexpected(
        damage(summary_start, "the summary has neither statistics nor chunks; the file was scanned instead"));

  const auto by_offset = [](const auto& a, const auto& b) { return a.offset < b.offset; };
  std::sort(segments_.begin(), segments_.end(), by_offset);
  std::sort(metadata_refs_.begin(), metadata_refs_.end(), by_offset);
  std::sort(attachment_refs_.begin(), attachment_refs_.end(), by_offset);
  for (std::size_t i = 1; i < segments_.size(); ++i)
    if (segments_[i].offset - segments_[i - 1].offset < segments_[i - 1].length)
      return tl::unexpected(damage(segments_[i].offset, "two chunks of the index overlap"));
  return {};
}

Status McapReader::declare(Schema schema) {
  const auto [at, fresh] = schemas_.try_emplace(schema.id, schema);
  if (!fresh && (at->second.name != schema.name || at->second.encoding != schema.encoding ||
                 at->second.text != schema.text))
    return fail(ErrorCode::protocol, source_->name(),
                "schema " + std::to_string(schema.id) + " is declared twice, as " + at->second.name +
                    " and as " + schema.name);
  return {};
}

Status McapReader::declare(Channel channel) {
  const auto [at, fresh] = channels_.try_emplace(channel.id, channel);
  if (!fresh && (at->second.topic != channel.topic || at->second.schema != channel.schema ||
                 at->second.message_encoding != channel.message_encoding))
    return fail(ErrorCode::protocol, source_->name(),
                "channel " + std::to_string(channel.id) + " is declared twice, as " + at->second.topic +
                    " and as " + channel.topic);
  return {};
}

Status McapReader::scan() {
  const std::uint64_t size = source_->size();
  std::uint64_t at = kMagic.size();
  std::uint32_t data_crc = crc32(std::as_bytes(std::span(kMagic)));
  bool crc_known = true;
  bool in_data = true;
  bool complete = false;
  Segment* plain = nullptr;  // the run of bare records that is being read

  while (in_data && size - at >= kRecordHeaderBytes) {
    std::array<std::byte, kRecordHeaderBytes> start{};
    if (Status status = source_->read(at, start); !status) return status;
    FieldReader header(start);
    const auto op = static_cast<Opcode>(header.get<std::uint8_t>());
    const auto length = header.get<std::uint64_t>();
    if (op == Opcode{}) {
      note("byte " + std::to_string(at) +
           ": expected a record, found zeros: never written before the power went");
      break;
    }
    if (length > size - at - kRecordHeaderBytes) {
      if (op == Opcode::chunk && options_.salvage_tail)
        if (Status status = salvage(at); !status) return status;
      break;
    }
    const std::uint64_t whole = kRecordHeaderBytes + length;
    const bool bare = op == Opcode::schema || op == Opcode::channel || op == Opcode::message;
    if (!bare) plain = nullptr;
    if (op == Opcode::attachment) {
      attachment_refs_.push_back({at, whole});
      if (whole > options_.max_loaded_bytes) {
        crc_known = false;
        at += whole;
        continue;
      }
    }
    auto record = read_record(at, whole);
    if (!record) return tl::unexpected(record.error());
    const Bytes body = record->subspan(kRecordHeaderBytes);
    FieldReader fields(body);
    if (op == Opcode::data_end) {
      const auto crc = fields.get<std::uint32_t>();
      if (!fields.ok()) note("byte " + std::to_string(at) + ": the end of the data is damaged");
      if (crc != 0 && crc_known && crc != data_crc)
        note("the checksum over all data does not match: some byte of the file was changed");
      in_data = false;
    } else {
      data_crc = crc32(*record, data_crc);
    }
    if (op == Opcode::footer) break;  // without an end of the data: broken
    if (op == Opcode::header) {
      profile_ = fields.text();
      library_ = fields.text();
    } else if (op == Opcode::chunk) {
      if (Status status = scan_chunk(at, *record); !status) return status;
    } else if (bare) {
      if (Status status = scan_plain(at, *record, plain); !status) return status;
    } else if (op == Opcode::metadata) {
      metadata_refs_.push_back({at, whole});
    }
    at += whole;
  }
  if (!in_data) {
    auto footer = read_footer();
    if (!footer) return tl::unexpected(footer.error());
    complete = footer->has_value();
    if (complete)
      if (Status status = check_summary(**footer, at); !status) return status;
  }
  health_.whole_bytes = complete ? size : at;
  health_.lost_bytes = size - health_.whole_bytes;
  health_.truncated = !complete;
  if (!complete)
    note(in_data ? "the file ends at byte " + std::to_string(size) +
                       " before its end was written; whole records reach to byte " + std::to_string(at)
                 : "the data are complete, the index behind them is not");
  return {};
}

/// Notes what is wrong behind the data, which a scan has no use for.
Status McapReader::check_summary(const Footer& footer, std::uint64_t data_end) {
  if (footer.summary_start != 0 && footer.summary_start != data_end) {
    note("byte " + std::to_string(footer.offset) +
         ": the footer and the end of the data disagree about where the summary starts");
    return {};
  }
  auto summary = read_record(data_end, footer.offset - data_end + kFooterCovered);
  if (!summary) return tl::unexpected(summary.error());
  if (footer.crc != 0 && crc32(*summary) != footer.crc)
    note("byte " + std::to_string(data_end) + ": the checksum of the summary does not match");
  return {};
}

Status McapReader::scan_chunk(std::uint64_t offset, Bytes record) {
  Segment segment;
  segment.offset = offset;
  segment.length = record.size();
  FieldReader in(record.subspan(kRecordHeaderBytes));
  const auto header = parse_chunk_header(in);
  if (!header || header->stored != in.left()) {
    segment.damaged = true;
    ++health_.damaged_chunks;
    note("byte " + std::to_string(offset) + ": the head of this chunk is damaged");
    segments_.push_back(std::move(segment));
    return {};
  }
  segment.compression = header->compression;
  segment.stored = header->stored;
  segment.uncompressed = header->uncompressed;
  segment.start_ns = header->start_ns;
  segment.end_ns = header->end_ns;

  ByteBuffer data;
  std::vector<Entry> entries;
  const Status status = load(segment, data, entries);
  if (!status && status.error().code != ErrorCode::protocol) return status;
  if (!status) {
    segment.damaged = true;
    ++health_.damaged_chunks;
    note(status.error().message);
  }
  segments_.push_back(std::move(segment));
  return {};
}

Status McapReader::scan_plain(std::uint64_t offset, Bytes record, Segment*& plain) {
  constexpr std::uint64_t kRunBytes = 4u << 20;
  Segment part;
  part.chunk = false;
  std::vector<Entry> entries;
  if (Status status = list_messages(part, record, entries); !status) {
    note(damage(offset, status.error().message).message);
    plain = nullptr;
    return {};
  }
  if (plain == nullptr || plain->length + record.size() > kRunBytes) {
    segments_.emplace_back();
    plain = &segments_.back();
    plain->chunk = false;
    plain->offset = offset;
  }
  plain->length += record.size();
  plain->stored = plain->uncompressed = plain->length;
  if (part.messages > 0) {
    plain->start_ns = plain->messages == 0 ? part.start_ns : std::min(plain->start_ns, part.start_ns);
    plain->end_ns = std::max(plain->end_ns, part.end_ns);
    plain->messages += part.messages;
    plain->channels.merge(part.channels);
  }
  return {};
}

/// The chunk at `offset` was cut. If its records lie there as they are, those that are whole become a
/// segment.
Status McapReader::salvage(std::uint64_t offset) {
  const std::uint64_t available = std::min(source_->size() - offset, options_.max_loaded_bytes);
  auto bytes = read_record(offset, available);
  if (!bytes) return tl::unexpected(bytes.error());
  FieldReader head(bytes->subspan(kRecordHeaderBytes));
  const auto header = parse_chunk_header(head);
  if (!header || !header->compression.empty()) return {};
  const std::size_t records_at = kRecordHeaderBytes + head.position();
  const Bytes records = bytes->subspan(records_at);
  FieldReader in(records);
  std::size_t whole = 0;
  while (const auto record = next_record(in)) {
    if (record->op != Opcode::schema && record->op != Opcode::channel && record->op != Opcode::message) break;
    whole = in.position();
  }
  Segment segment;
  segment.chunk = false;
  segment.offset = offset + records_at;
  segment.length = segment.stored = segment.uncompressed = whole;
  std::vector<Entry> entries;
  if (Status status = list_messages(segment, records.first(whole), entries); !status || segment.messages == 0)
    return {};
  health_.unverified_messages += segment.messages;
  note("byte " + std::to_string(offset) + ": this chunk was cut; " + std::to_string(segment.messages) +
       " messages in front of the cut are whole, though no checksum covers them");
  segments_.push_back(std::move(segment));
  return {};
}

Status McapReader::load(Segment& segment, ByteBuffer& data, std::vector<Entry>& entries) {
  if (segment.damaged)
    return tl::unexpected(
        damage(segment.offset, "this chunk is damaged; rigor inspect --repair keeps the others"));
  data.clear();
  entries.clear();
  if (!segment.chunk) {
    if (segment.length > options_.max_loaded_bytes)
      return tl::unexpected(damage(segment.offset, "too large to hold in memory"));
    data.resize(static_cast<std::size_t>(segment.length));
    if (Status status = source_->read(segment.offset, {data.data(), data.size()}); !status) return status;
    return list_messages(segment, data.bytes(), entries);
  }
  auto record = read_record(segment.offset, segment.length);
  if (!record) return tl::unexpected(record.error());
  auto records = chunk_records(segment, *record, data, name(), {.max_bytes = options_.max_loaded_bytes});
  if (!records) return tl::unexpected(records.error());
  if (segment.compression.empty()) data.append(*records);
  if (Status status = list_messages(segment, data.bytes(), entries); !status)
    return tl::unexpected(damage(segment.offset, status.error().message));
  return {};
}

/// Declares what the records declare, and lists their messages in file order. A chunk's stated times are
/// checked.
Status McapReader::list_messages(Segment& segment, Bytes records, std::vector<Entry>& entries) {
  const auto bad = [](std::string what) { return fail(ErrorCode::protocol, "", std::move(what)); };
  FieldReader in(records);
  std::uint64_t start_ns = ~std::uint64_t{0};
  std::uint64_t end_ns = 0;
  std::map<std::uint16_t, std::uint64_t> counts;
  while (const auto record = next_record(in)) {
    if (record->op == Opcode::schema) {
      auto schema = parse_schema(record->body);
      if (!schema) return bad("a schema is damaged");
      if (Status status = declare(std::move(*schema)); !status) return status;
    } else if (record->op == Opcode::channel) {
      auto channel = parse_channel(record->body);
      if (!channel) return bad("a channel is damaged");
      if (Status status = declare(std::move(*channel)); !status) return status;
    } else if (record->op == Opcode::message) {
      FieldReader fields(record->body);
      const auto channel = fields.get<std::uint16_t>();
      fields.get<std::uint32_t>();
      const auto time_ns = fields.get<std::uint64_t>();
      fields.get<std::uint64_t>();
      if (!fields.ok()) return bad("a message is shorter than its head");
      if (!channels_.contains(channel))
        return bad("a message belongs to channel " + std::to_string(channel) + ", which is not declared");
      entries.push_back({time_ns, record->offset});
      start_ns = std::min(start_ns, time_ns);
      end_ns = std::max(end_ns, time_ns);
      ++counts[channel];
    }
  }
  if (in.left() > 0) return bad("its last record is cut short");
  if (!entries.empty()) {
    if (segment.chunk && (start_ns < segment.start_ns || end_ns > segment.end_ns))
      return bad("a message lies outside of the times that its chunk states");
    if (!segment.chunk) segment.start_ns = start_ns, segment.end_ns = end_ns;
  }
  segment.messages = entries.size();
  for (const auto& [channel, count] : counts) {
    segment.channels.insert(channel);
    if (scanning_) counts_[channel] += count;
  }
  return {};
}

std::optional<Metadata> McapReader::read_metadata(const SegmentRef& ref) {
  const auto record = read_record(ref.offset, ref.length);
  if (!record) return std::nullopt;
  FieldReader in(*record);
  const auto view = next_record(in);
  if (!view || view->op != Opcode::metadata || in.left() > 0) return std::nullopt;
  return parse_metadata(view->body);
}

Result<std::vector<Metadata>> McapReader::metadata() {
  std::vector<Metadata> all;
  for (const SegmentRef& ref : metadata_refs_) {
    auto metadata = read_metadata(ref);
    if (!metadata) return tl::unexpected(damage(ref.offset, "a metadata record is damaged"));
    all.push_back(std::move(*metadata));
  }
  return all;
}

std::vector<Metadata> McapReader::readable_metadata() {
  std::vector<Metadata> all;
  for (const SegmentRef& ref : metadata_refs_)
    if (auto metadata = read_metadata(ref)) all.push_back(std::move(*metadata));
  return all;
}

Result<Attachment> McapReader::attachment(std::size_t i) {
  if (i >= attachment_refs_.size())
    return fail(ErrorCode::bad_input, source_->name(), "there is no attachment " + std::to_string(i));
  const SegmentRef ref = attachment_refs_[i];
  auto record = read_record(ref.offset, ref.length);
  if (!record) return tl::unexpected(record.error());
  FieldReader in(*record);
  const auto view = next_record(in);
  auto attachment =
      view && view->op == Opcode::attachment && in.left() == 0 ? parse_attachment(view->body) : std::nullopt;
  if (!attachment) return tl::unexpected(damage(ref.offset, "an attachment is damaged"));
  return std::move(*attachment);
}

}  // namespace rigor::record
