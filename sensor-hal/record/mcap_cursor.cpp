// Messages in order, out of segments whose times may overlap: a segment is loaded when the next message could
// be in it, and a heap holds those that are open.
#include <algorithm>
#include <tuple>

#include "sensor-hal/record/mcap_parse.h"
#include "sensor-hal/record/mcap_reader.h"

namespace rigor::record {

struct MessageCursor::Loaded {
  std::size_t segment = 0;
  ByteBuffer data;
  std::vector<McapReader::Entry> entries;
  std::size_t at = 0;

  [[nodiscard]] std::uint64_t bytes() const {
    return data.size() + entries.size() * sizeof(McapReader::Entry);
  }
  [[nodiscard]] std::tuple<std::uint64_t, std::size_t> key() const {
    return {entries[at].log_time_ns, segment};
  }
};

void MessageCursor::Drop::operator()(Loaded* loaded) const { delete loaded; }

namespace {
/// Puts the earliest in front of a heap.
constexpr auto later = [](const auto& a, const auto& b) { return a->key() > b->key(); };
}  // namespace

MessageCursor::MessageCursor(McapReader& reader, MessageFilter filter)
    : reader_(&reader), filter_(std::move(filter)) {
  std::set<std::uint16_t> wanted;
  for (const auto& [id, channel] : reader.channels_)
    if (filter_.topics.empty() || filter_.topics.contains(channel.topic)) wanted.insert(id);
  for (std::size_t i = 0; i < reader.segments_.size(); ++i) {
    const Segment& segment = reader.segments_[i];
    if (segment.end_ns < filter_.start_ns || segment.start_ns > filter_.end_ns) continue;
    if (!filter_.topics.empty() && !segment.damaged &&
        std::none_of(segment.channels.begin(), segment.channels.end(),
                     [&](auto id) { return wanted.contains(id); }))
      continue;
    pending_.push_back(i);
  }
  if (filter_.order == MessageOrder::log_time)
    std::stable_sort(pending_.begin(), pending_.end(), [&](std::size_t a, std::size_t b) {
      return reader.segments_[a].start_ns < reader.segments_[b].start_ns;
    });
  std::reverse(pending_.begin(), pending_.end());
}

Status MessageCursor::load_next() {
  const std::size_t index = pending_.back();
  pending_.pop_back();
  Segment& segment = reader_->segments_[index];
  LoadedPtr loaded;
  if (spare_.empty()) {
    loaded.reset(new Loaded);
  } else {
    loaded = std::move(spare_.back());
    spare_.pop_back();
  }
  loaded->segment = index;
  loaded->at = 0;
  Status status = reader_->load(segment, loaded->data, loaded->entries);
  if (!status) {
    if (status.error().code != ErrorCode::protocol || !reader_->options_.skip_damaged) return status;
    ++skipped_;
    return {};
  }
  std::erase_if(loaded->entries, [&](const McapReader::Entry& entry) {
    if (entry.log_time_ns < filter_.start_ns || entry.log_time_ns > filter_.end_ns) return true;
    if (filter_.topics.empty()) return false;
    std::uint16_t id = 0;
    std::memcpy(&id, loaded->data.data() + entry.offset + kRecordHeaderBytes, sizeof id);
    return !filter_.topics.contains(reader_->channels_.at(id).topic);
  });
  if (filter_.order == MessageOrder::log_time)
    std::stable_sort(loaded->entries.begin(), loaded->entries.end(),
                     [](const auto& a, const auto& b) { return a.log_time_ns < b.log_time_ns; });
  if (loaded->entries.empty()) {
    spare_.push_back(std::move(loaded));
    return {};
  }
  loaded_bytes_ += loaded->bytes();
  if (loaded_bytes_ > reader_->options_.max_loaded_bytes)
    return tl::unexpected(
        reader_->damage(segment.offset, "so many chunks overlap in time here that more than " +
                                            std::to_string(reader_->options_.max_loaded_bytes) +
                                            " bytes would have to be held; read it in file order"));
  loaded_.push_back(std::move(loaded));
  std::push_heap(loaded_.begin(), loaded_.end(), later);
  return {};
}

Result<bool> MessageCursor::next(MessageView& message) {
  if (current_) spare_.push_back(std::move(current_));
  const auto may_come_first = [this] {
    if (loaded_.empty()) return true;
    if (filter_.order == MessageOrder::file) return false;
    const std::size_t next = pending_.back();
    return std::tuple(reader_->segments_[next].start_ns, next) < loaded_.front()->key();
  };
  while (!pending_.empty() && may_come_first())
    if (Status status = load_next(); !status) return tl::unexpected(status.error());
  if (loaded_.empty()) return false;

  Loaded& first = *loaded_.front();
  const std::size_t offset = first.entries[first.at].offset;
  FieldReader in(first.data.bytes().subspan(offset));
  FieldReader fields(next_record(in)->body);  // both were checked when the segment was loaded
  const Channel& channel = reader_->channels_.at(fields.get<std::uint16_t>());
  const auto schema = reader_->schemas_.find(channel.schema);
  message.channel = &channel;
  message.schema = schema == reader_->schemas_.end() ? nullptr : &schema->second;
  message.sequence = fields.get<std::uint32_t>();
  message.log_time_ns = fields.get<std::uint64_t>();
  message.publish_time_ns = fields.get<std::uint64_t>();
  message.data = fields.take(fields.left());

  std::pop_heap(loaded_.begin(), loaded_.end(), later);
  if (++first.at < first.entries.size()) {
    std::push_heap(loaded_.begin(), loaded_.end(), later);
  } else {
    loaded_bytes_ -= first.bytes();
    current_ = std::move(loaded_.back());
    loaded_.pop_back();
  }
  return true;
}

}  // namespace rigor::record
