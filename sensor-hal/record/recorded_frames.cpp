// The frames of a recording, for its replay.
#include <map>
#include <optional>

#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/frame_tree.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/ros2_time.h"

namespace rigor::record {
namespace {

constexpr const char *kStatic = "/tf_static", *kMoving = "/tf";

class OfRecording final : public FrameSource {
 public:
  explicit OfRecording(std::unique_ptr<McapReader> reader, Duration to_utc)
      : reader_(std::move(reader)), to_utc_(to_utc) {}

  /// False: the recording has no frames.
  Result<bool> open() {
    bool any = false;
    for (const auto& [id, channel] : reader_->channels()) {
      if (channel.topic == kMoving) moves_ = any = true;
      if (channel.topic == kStatic) any = true;
    }
    std::map<std::string, msg::TransformStamped> newest;  // by child: a latched topic may be sent again
    auto cursor = reader_->messages({.topics = {kStatic}});
    MessageView view;
    msg::TFMessage m;
    while (true) {
      const auto more = cursor.next(view);
      if (!more) return tl::unexpected<Error>(more.error());
      if (!*more) break;
      if (auto s = read(view, m); !s) return tl::unexpected<Error>(s.error());
      for (msg::TransformStamped& t : m.transforms) newest[t.child_frame_id] = std::move(t);
    }
    for (auto& [child, t] : newest) fixed_.transforms.push_back(std::move(t));
    if (moves_) cursor_.emplace(reader_->messages({.topics = {kMoving}}));
    return any;
  }

  [[nodiscard]] msg::TFMessage fixed(const msg::Time& stamp) const override {
    msg::TFMessage m = fixed_;
    for (msg::TransformStamped& t : m.transforms) t.header.stamp = stamp;
    return m;
  }
  [[nodiscard]] bool moves() const override { return moves_; }
  /// The newest that was recorded up to `t`.
  [[nodiscard]] bool moving(const WorldMotion& /*motion*/, BenchTime t, BenchTime /*t0*/,
                            const msg::Time& /*stamp*/, msg::TFMessage& out) override {
    const std::int64_t until = t.ns() + to_utc_.ns();
    bool found = false;
    while (cursor_) {
      if (!ahead_) {
        MessageView view;
        const auto more = cursor_->next(view);
        msg::TFMessage m;
        // What is damaged was told when the replay's own samples came to it; frames end here.
        if (!more || !*more || !read(view, m)) {
          cursor_.reset();
          break;
        }
        ahead_.emplace(static_cast<std::int64_t>(view.log_time_ns), std::move(m));
      }
      if (ahead_->first > until) break;
      out = std::move(ahead_->second);
      ahead_.reset();
      found = true;
    }
    return found;
  }

 private:
  static Status read(const MessageView& view, msg::TFMessage& m) {
    if (!view.schema || view.schema->name != msg::TFMessage::kType || view.channel->message_encoding != "cdr")
      return fail(ErrorCode::protocol, view.channel->topic,
                  "expected messages of type tf2_msgs/msg/TFMessage as cdr, got others");
    if (auto s = CdrReader::read(view.data, m); !s)
      return fail(ErrorCode::protocol, view.channel->topic, s.error().message);
    return {};
  }

  std::unique_ptr<McapReader> reader_;
  Duration to_utc_;
  bool moves_ = false;
  msg::TFMessage fixed_;
  std::optional<MessageCursor> cursor_;
  std::optional<std::pair<std::int64_t, msg::TFMessage>> ahead_;
};

}  // namespace

Result<std::unique_ptr<FrameSource>> recorded_frames(const std::string& path, Duration to_utc) {
  auto reader = McapReader::open(path);
  if (!reader) return tl::unexpected<Error>(reader.error());
  auto source = std::make_unique<OfRecording>(std::move(*reader), to_utc);
  const auto any = source->open();
  if (!any) return tl::unexpected<Error>(any.error());
  if (!*any) return std::unique_ptr<FrameSource>();
  return std::unique_ptr<FrameSource>(std::move(source));
}

}  // namespace rigor::record
