// Reads a recording, whole or cut short.
//
// A file with an intact summary is read by its index. Any other is scanned once from its start, and
// everything up to the cut is found: each whole chunk, and, where the last chunk is not compressed, the whole
// messages in front of the cut (those no checksum covers: `Health::unverified_messages` counts them).
//
//   auto reader = McapReader::open(path);
//   auto cursor = (*reader)->messages({.topics = {"/camera/image_raw"}});
//   MessageView m;
//   while (true) { auto more = cursor.next(m); if (!more) …error…; if (!*more) break; … }
//
// Nothing in the file is trusted: lengths, offsets, checksums and times are checked, and at most
// `max_loaded_bytes` are held. One thread at a time; allocates, blocks. Errors: protocol with the byte of the
// file, and what to do.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "sensor-hal/record/byte_io.h"
#include "sensor-hal/record/mcap_format.h"

namespace rigor::record {

struct ReaderOptions {
  bool scan = false;  ///< do not use the index; this also checks the checksum over the whole file
  bool skip_damaged =
      false;  ///< pass over chunks whose content is damaged instead of stopping there with an error
  bool any_schema = false;   ///< open a recording, too, that this program may misread (recording_schema.h)
  bool salvage_tail = true;  ///< whole messages of a last chunk that was cut, though no checksum covers them
  std::uint64_t max_loaded_bytes = std::uint64_t{1} << 30;
};

/// What is wrong with a file.
struct Health {
  bool indexed = false;           ///< was read by its index
  bool truncated = false;         ///< ends before its end was written
  std::uint64_t whole_bytes = 0;  ///< up to the end of the last whole record
  std::uint64_t lost_bytes = 0;   ///< after that
  std::uint64_t damaged_chunks = 0;
  std::uint64_t unverified_messages = 0;
  std::vector<std::string> notes;  ///< one sentence for each finding
  [[nodiscard]] bool good() const { return !truncated && damaged_chunks == 0 && notes.empty(); }
};

/// A stretch of the file that holds messages: a chunk, or bare records of a file without chunks.
struct Segment {
  std::uint64_t offset = 0;  ///< in the file: of the chunk record; of the first bare record
  std::uint64_t length = 0;  ///< in the file, with the record header
  bool chunk = true;
  std::string compression;
  std::uint64_t stored = 0;        ///< bytes of records as they lie in the file
  std::uint64_t uncompressed = 0;  ///< bytes of records as they are read
  std::uint64_t start_ns = 0;      ///< log time of the earliest message
  std::uint64_t end_ns = 0;        ///< of the latest
  std::uint64_t messages = 0;      ///< known after a scan only
  bool damaged = false;
  std::set<std::uint16_t> channels;  ///< with a message here; empty: unknown
};

/// Valid until the cursor moves on.
struct MessageView {
  const Channel* channel = nullptr;
  const Schema* schema = nullptr;  ///< null where the channel has none
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0;
  std::uint64_t publish_time_ns = 0;
  Bytes data;
};

enum class MessageOrder : std::uint8_t {
  log_time,  ///< by log time, and as they lie in the file where that is equal
  file       ///< as they lie in the file
};

struct MessageFilter {
  std::set<std::string> topics{};            ///< empty: all
  std::uint64_t start_ns = 0;                ///< log time, inclusive
  std::uint64_t end_ns = ~std::uint64_t{0};  ///< log time, inclusive
  MessageOrder order = MessageOrder::log_time;
};

struct SegmentRef {
  std::uint64_t offset = 0;
  std::uint64_t length = 0;
};

class McapReader;

/// Walks messages; several may be open on one reader, which must outlive them.
class MessageCursor {
 public:
  /// True and a message, false at the end, or an error.
  [[nodiscard]] Result<bool> next(MessageView& message);
  /// Damaged chunks that were passed over (ReaderOptions::skip_damaged).
  [[nodiscard]] std::uint64_t skipped_segments() const { return skipped_; }

 private:
  friend class McapReader;
  struct Loaded;
  struct Drop {
    void operator()(Loaded* loaded) const;
  };
  using LoadedPtr = std::unique_ptr<Loaded, Drop>;

  MessageCursor(McapReader& reader, MessageFilter filter);
  Status load_next();

  McapReader* reader_;
  MessageFilter filter_;
  std::vector<std::size_t> pending_;  ///< segments not loaded yet, the next one last
  std::vector<LoadedPtr> loaded_;     ///< a heap, the earliest message in front
  std::vector<LoadedPtr> spare_;
  LoadedPtr current_;  ///< holds the message that was handed out last, if its segment is used up
  std::uint64_t loaded_bytes_ = 0;
  std::uint64_t skipped_ = 0;
};

class McapReader {
 public:
  /// Errors: not_found, bad_input where this is no MCAP file at all or of a newer schema, io, protocol.
  [[nodiscard]] static Result<std::unique_ptr<McapReader>> open(const std::string& path,
                                                                ReaderOptions options = {});
  [[nodiscard]] static Result<std::unique_ptr<McapReader>> open(std::unique_ptr<ByteSource> source,
                                                                ReaderOptions options = {});

  [[nodiscard]] const Health& health() const { return health_; }
  [[nodiscard]] const std::string& profile() const { return profile_; }
  [[nodiscard]] const std::string& library() const { return library_; }
  [[nodiscard]] const std::map<std::uint16_t, Schema>& schemas() const { return schemas_; }
  [[nodiscard]] const std::map<std::uint16_t, Channel>& channels() const { return channels_; }
  /// Messages per channel; of a scanned file those that can be read.
  [[nodiscard]] const std::map<std::uint16_t, std::uint64_t>& message_counts() const { return counts_; }
  [[nodiscard]] std::uint64_t message_count() const;
  [[nodiscard]] const std::vector<Segment>& segments() const { return segments_; }
  [[nodiscard]] std::uint64_t file_bytes() const { return source_->size(); }
  [[nodiscard]] std::string name() const { return source_->name(); }

  [[nodiscard]] MessageCursor messages(MessageFilter filter = {}) {
    return MessageCursor(*this, std::move(filter));
  }
  /// All metadata records, in file order.
  [[nodiscard]] Result<std::vector<Metadata>> metadata();
  /// Those that are not damaged.
  [[nodiscard]] std::vector<Metadata> readable_metadata();
  [[nodiscard]] std::size_t attachment_count() const { return attachment_refs_.size(); }
  [[nodiscard]] Result<Attachment> attachment(std::size_t i);

 private:
  friend class MessageCursor;
  struct Entry {
    std::uint64_t log_time_ns;
    std::size_t offset;  ///< of the message's record header
  };

  McapReader(std::unique_ptr<ByteSource> source, ReaderOptions options);
  struct Footer;
  Status read_header();
  Result<std::optional<Footer>> read_footer();
  Result<bool> open_by_index();
  Status parse_summary(Bytes summary, std::uint64_t summary_start);
  Status scan();
  Status scan_chunk(std::uint64_t offset, Bytes record);
  Status scan_plain(std::uint64_t offset, Bytes record, Segment*& plain);
  Status check_summary(const Footer& footer, std::uint64_t data_end);
  Status salvage(std::uint64_t offset);
  void note(std::string text) { health_.notes.push_back(std::move(text)); }
  /// The bytes of a record, header included, in `record_`.
  Result<Bytes> read_record(std::uint64_t offset, std::uint64_t length);
  Status declare(Schema schema);
  Status declare(Channel channel);
  std::optional<Metadata> read_metadata(const SegmentRef& ref);
  /// Reads and unpacks a segment, and lists its messages in file order.
  Status load(Segment& segment, ByteBuffer& data, std::vector<Entry>& entries);
  Status list_messages(Segment& segment, Bytes records, std::vector<Entry>& entries);
  Error damage(std::uint64_t offset, const std::string& what) const;

  std::unique_ptr<ByteSource> source_;
  ReaderOptions options_;
  Health health_;
  bool scanning_ = false;
  std::string profile_;
  std::string library_;
  std::map<std::uint16_t, Schema> schemas_;
  std::map<std::uint16_t, Channel> channels_;
  std::map<std::uint16_t, std::uint64_t> counts_;
  std::vector<Segment> segments_;
  std::vector<SegmentRef> metadata_refs_;
  std::vector<SegmentRef> attachment_refs_;
  ByteBuffer record_;
};

}  // namespace rigor::record
