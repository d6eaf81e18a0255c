#include "sensor-hal/record/message_access.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>

#include "sensor-hal/record/chunk_records.h"
#include "sensor-hal/record/mcap_parse.h"

namespace rigor::record {
namespace {

/// A file as memory, read-only.
class Mapping {
 public:
  explicit Mapping(const std::string& path) {
    const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (fd < 0) return;
    struct stat info {};
    if (fstat(fd, &info) == 0 && S_ISREG(info.st_mode) && info.st_size > 0) {
      void* memory = mmap(nullptr, static_cast<std::size_t>(info.st_size), PROT_READ, MAP_SHARED, fd, 0);
      if (memory != MAP_FAILED) {
        data_ = memory;
        size_ = static_cast<std::size_t>(info.st_size);
      }
    }
    ::close(fd);
  }
  ~Mapping() {
    if (data_) munmap(data_, size_);
  }
  Mapping(const Mapping&) = delete;
  Mapping& operator=(const Mapping&) = delete;
  [[nodiscard]] Bytes bytes() const { return {static_cast<const std::byte*>(data_), size_}; }

 private:
  void* data_ = nullptr;
  std::size_t size_ = 0;
};

}  // namespace

MessageAccess::~MessageAccess() = default;

Result<std::unique_ptr<MessageAccess>> MessageAccess::open(const std::string& path,
                                                           MessageAccessOptions options) {
  std::unique_ptr<MessageAccess> access(new MessageAccess);
  access->options_ = options;
  auto mapping = std::make_shared<const Mapping>(path);
  const ReaderOptions how{.skip_damaged = options.skip_damaged};
  // A file that cannot be mapped (missing, empty, a folder) is opened for the reader's own words about it.
  auto reader = mapping->bytes().empty() ? McapReader::open(path, how)
                                         : McapReader::open(memory_source(mapping->bytes(), path), how);
  if (!reader) return tl::unexpected(reader.error());
  access->file_ = mapping->bytes();
  access->mapping_ = std::move(mapping);
  access->reader_ = std::move(*reader);
  access->verified_.resize(access->reader_->segments().size());
  return access;
}

Result<MessageAccess::Records> MessageAccess::records(std::uint32_t index) {
  const Segment& segment = reader_->segments()[index];
  if (segment.offset > file_.size() || segment.length > file_.size() - segment.offset)
    return fail(ErrorCode::protocol, reader_->name(),
                "byte " + std::to_string(segment.offset) + ": a chunk reaches beyond the end of the file");
  const Bytes record =
      file_.subspan(static_cast<std::size_t>(segment.offset), static_cast<std::size_t>(segment.length));
  if (!segment.chunk) return Records{mapping_, record};
  for (auto c = cache_.begin(); c != cache_.end(); ++c)
    if (c->segment == index) {
      cache_.splice(cache_.begin(), cache_, c);
      return c->records;
    }
  auto unpacked = std::make_shared<ByteBuffer>();
  const bool check = options_.verify && !verified_[index];
  const auto bytes = chunk_records(segment, record, *unpacked, reader_->name(), {.verify = check});
  if (!bytes) return tl::unexpected(bytes.error());
  verified_[index] = true;
  if (segment.compression.empty()) return Records{mapping_, *bytes};
  cached_bytes_ += unpacked->size();
  cache_.push_front({index, {std::move(unpacked), *bytes}});
  while (cached_bytes_ > options_.cache_bytes && cache_.size() > 1) {
    cached_bytes_ -= cache_.back().records.bytes.size();
    cache_.pop_back();
  }
  return cache_.front().records;
}

/// From the message indexes behind a chunk. False: they are not all there, or say what cannot be.
bool MessageAccess::read_index(std::uint32_t index) {
  const Segment& segment = reader_->segments()[index];
  if (!segment.chunk || segment.channels.empty() || segment.offset + segment.length > file_.size())
    return false;
  FieldReader in(file_.subspan(static_cast<std::size_t>(segment.offset + segment.length)));
  std::vector<MessagePlace> found;
  std::set<std::uint16_t> channels;
  while (channels.size() < segment.channels.size()) {
    const auto record = next_record(in);
    if (!record || record->op != Opcode::message_index) return false;
    FieldReader fields(record->body);
    const auto channel = fields.get<std::uint16_t>();
    const auto bytes = fields.get<std::uint32_t>();
    if (!fields.ok() || bytes != fields.left() || bytes % 16 != 0 || !segment.channels.contains(channel) ||
        !channels.insert(channel).second)
      return false;
    for (std::uint32_t i = 0; i < bytes / 16; ++i) {
      MessagePlace place;
      place.log_time_ns = fields.get<std::uint64_t>();
      place.offset = fields.get<std::uint64_t>();
      if (place.offset >= segment.uncompressed) return false;
      place.segment = index;
      place.channel = channel;
      found.push_back(place);
    }
  }
  for (const MessagePlace& place : found) places_[place.channel].push_back(place);
  return true;
}

/// From the messages themselves.
Status MessageAccess::list(std::uint32_t index) {
  const auto bytes = records(index);
  if (!bytes) return tl::unexpected(bytes.error());
  FieldReader in(bytes->bytes);
  while (const auto record = next_record(in)) {
    if (record->op != Opcode::message) continue;
    FieldReader fields(record->body);
    MessagePlace place;
    place.channel = fields.get<std::uint16_t>();
    (void)fields.get<std::uint32_t>();
    place.log_time_ns = fields.get<std::uint64_t>();
    if (!fields.ok()) break;
    place.offset = record->offset;
    place.segment = index;
    places_[place.channel].push_back(place);
  }
  return {};
}

Status MessageAccess::find_places() {
  if (found_) return {};
  places_.clear();
  const auto count = static_cast<std::uint32_t>(reader_->segments().size());
  for (std::uint32_t i = 0; i < count; ++i) {
    if (reader_->segments()[i].damaged) {
      if (options_.skip_damaged) continue;
      return fail(ErrorCode::protocol, reader_->name(),
                  "byte " + std::to_string(reader_->segments()[i].offset) +
                      ": this chunk is damaged; rigor inspect --repair keeps the others");
    }
    if (read_index(i)) continue;
    if (auto s = list(i); !s && !options_.skip_damaged) return s;
  }
  const auto earlier = [](const MessagePlace& a, const MessagePlace& b) {
    return a.log_time_ns < b.log_time_ns;
  };
  for (auto& [channel, list] : places_)
    if (!std::is_sorted(list.begin(), list.end(), earlier))
      std::stable_sort(list.begin(), list.end(), earlier);
  found_ = true;
  return {};
}

Result<std::span<const MessagePlace>> MessageAccess::places(std::uint16_t channel) {
  const std::scoped_lock lock(mutex_);
  if (auto s = find_places(); !s) return tl::unexpected(s.error());
  const auto found = places_.find(channel);
  if (found == places_.end()) return std::span<const MessagePlace>{};
  return std::span<const MessagePlace>(found->second);
}

Result<HeldMessage> MessageAccess::at(const MessagePlace& place) {
  const std::scoped_lock lock(mutex_);
  if (place.segment >= reader_->segments().size())
    return fail(ErrorCode::bad_input, reader_->name(), "expected a place that places() gave");
  const auto wrong = [&](const char* what) {
    return fail(ErrorCode::protocol, reader_->name(),
                "byte " + std::to_string(reader_->segments()[place.segment].offset) + ": " + what +
                    "; rigor inspect --repair makes an index that fits");
  };
  auto bytes = records(place.segment);
  if (!bytes) return tl::unexpected(bytes.error());
  if (place.offset >= bytes->bytes.size()) return wrong("the index of this chunk points outside it");
  FieldReader in(bytes->bytes.subspan(static_cast<std::size_t>(place.offset)));
  const auto record = next_record(in);
  if (!record || record->op != Opcode::message) return wrong("the index of this chunk points at no message");
  FieldReader fields(record->body);
  HeldMessage message;
  const auto channel = fields.get<std::uint16_t>();
  message.sequence = fields.get<std::uint32_t>();
  message.log_time_ns = fields.get<std::uint64_t>();
  message.publish_time_ns = fields.get<std::uint64_t>();
  if (!fields.ok()) return wrong("a message is shorter than its head");
  if (channel != place.channel || message.log_time_ns != place.log_time_ns)
    return wrong("the index of this chunk points at another message");
  message.data = fields.take(fields.left());
  message.keeper = std::move(bytes->keeper);
  return message;
}

}  // namespace rigor::record
