#include "bench/dataset/dataset_recording.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <utility>

#include "bench/dataset/dataset_json.h"
#include "bench/files/manifest.h"
#include "bench/files/output_file.h"
#include "bench/sensing/camera_info.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/mcap_writer.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;
namespace msg = record::msg;
using nlohmann::json;

constexpr const char* kMetadata = "rigor.dataset";
constexpr const char* kSamplesTopic = "/samples";
constexpr const char* kSampleSchema =
    R"({"type":"object","title":"rigor.DatasetSample","properties":{"sample":{"type":"integer"},"split":{"type":"string"},)"
    R"("conditions":{"type":"object"},"rejected":{"type":"array"},"T_world_carrier":{"type":"object"},"channels":{"type":"object"}}})";
constexpr std::uint64_t kSample_ns = 1'000'000'000;

/// What the label of a point is in the cloud of its truth.
struct LabelledPoint {
  float x_m, y_m, z_m, true_range_m;
  std::uint32_t category, node_low, node_high;
};

std::vector<msg::PointField> label_fields() {
  constexpr std::uint8_t kUint32 = 6, kFloat32 = 7;
  return {{"x", 0, kFloat32, 1},           {"y", 4, kFloat32, 1},     {"z", 8, kFloat32, 1},
          {"true_range", 12, kFloat32, 1}, {"class", 16, kUint32, 1}, {"node_low", 20, kUint32, 1},
          {"node_high", 24, kUint32, 1}};
}

msg::TransformStamped transform(const msg::Header& header, const DatasetView& view) {
  const Eigen::Quaterniond q(view.T_world_sensor.linear());
  const Eigen::Vector3d p = view.T_world_sensor.translation();
  return {header, view.channel, {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}}};
}

}  // namespace

struct DatasetRecording::Impl {
  Impl(fs::path to, fs::path written, fs::path left, const Dataset& samples, DatasetOutputOptions how)
      : file(std::move(to)),
        part(std::move(written)),
        old(std::move(left)),
        dataset(samples),
        options(std::move(how)) {}
  fs::path file, part, old;  ///< the dataset; what is being written; what a process left that was ended
  const Dataset& dataset;
  DatasetOutputOptions options;
  json manifest;
  int lock = -1;                  ///< of `part`
  fs::path source;                ///< what has the samples so far; empty: none
  std::set<std::uint64_t> whole;  ///< samples
  std::unique_ptr<record::McapWriter> writer;
  std::map<std::string, std::uint16_t> schemas, channels;  ///< by name, by topic
  std::map<std::string, record::SampleEncoder> encoders;   ///< by channel
  record::CdrWriter cdr;
  DatasetSummary summary;
  bool finished = false;

  Status take();
  Status find_source();
  Status read_source(const fs::path& from, bool own);
  Status begin();
  Status copy();
  void count(const json& sample);
  Result<std::uint16_t> channel(const std::string& topic, const std::string& type, const char* encoding,
                                const std::string& schema, const char* messages);
  Status put(const std::string& topic, std::string_view type, std::uint64_t index, record::Pieces pieces);
  template <class M>
  Status put(const std::string& topic, std::uint64_t index, const M& message) {
    auto pieces = cdr.write(message);
    if (!pieces) return tl::unexpected<Error>(pieces.error());
    return put(topic, M::kType, index, *pieces);
  }
  Status put_measurement(const DatasetView& view, std::uint64_t index);
  Status put_truth(const DatasetView& view, std::uint64_t index, const msg::Header& header);
};

DatasetRecording::DatasetRecording(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

DatasetRecording::~DatasetRecording() {
  Impl& f = *impl_;
  if (f.writer)
    (void)f.writer->close();  // whole chunks; the error, if there is one, was told by write()
  else if (std::error_code ec; f.lock >= 0 && !f.finished && fs::file_size(f.part, ec) == 0)
    ::unlink(f.part.c_str());
  if (f.lock >= 0) ::close(f.lock);
}

Result<std::unique_ptr<DatasetRecording>> DatasetRecording::open(const fs::path& file, const Dataset& dataset,
                                                                 const DatasetOutputOptions& given) {
  auto options = checked_output_options(given, dataset);
  if (!options) return tl::unexpected<Error>(options.error());
  const std::string name = file.filename().string();
  const fs::path part = file.parent_path() / ("." + name + ".part");
  std::unique_ptr<DatasetRecording> output(new DatasetRecording(
      std::make_unique<Impl>(file, part, fs::path(part) += ".old", dataset, std::move(*options))));
  Impl& f = *output->impl_;
  f.manifest = dataset.manifest();
  f.manifest["recording"] = {{"layers", f.options.layers}, {"min_area_px", f.options.min_area_px}};
  if (auto s = f.take(); !s) return tl::unexpected<Error>(s.error());
  if (auto s = f.find_source(); !s) return tl::unexpected<Error>(s.error());
  return output;
}

/// Holds the file by a lock on its part, which goes with the process, however that ends; a part that another
/// one left becomes `old`.
Status DatasetRecording::Impl::take() {
  std::error_code ec;
  if (!file.parent_path().empty()) fs::create_directories(file.parent_path(), ec);
  if (ec) return tl::unexpected<Error>(output_error(file, ec.value()));
  const auto hold = [&]() -> Status {
    lock = ::open(part.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (lock < 0) return tl::unexpected<Error>(output_error(part, errno));
    if (::flock(lock, LOCK_EX | LOCK_NB) == 0) return {};
    ::close(std::exchange(lock, -1));  // the part is the other process's
    return fail(ErrorCode::bad_input, file.string(),
                "another process is writing this dataset; wait for it, or give another file with -o");
  };
  if (auto s = hold(); !s) return s;
  if (fs::file_size(part, ec) == 0) return {};
  if (fs::exists(old, ec)) {  // it was being copied from `old`, which has all of it
    if (::ftruncate(lock, 0) != 0) return tl::unexpected<Error>(output_error(part, errno));
    return {};
  }
  if (std::rename(part.c_str(), old.c_str()) != 0) return tl::unexpected<Error>(output_error(part, errno));
  ::close(lock);
  return hold();
}

/// The file, or what a process left that was ended, whichever has more samples: until all of the file is
/// copied, that is the file.
Status DatasetRecording::Impl::find_source() {
  std::error_code ec;
  if (fs::exists(file, ec))
    if (auto s = read_source(file, false); !s) return s;
  if (!fs::exists(old, ec)) return {};
  const fs::path before = std::exchange(source, {});
  const std::set<std::uint64_t> whole_before = std::exchange(whole, {});
  const DatasetSummary summary_before = std::exchange(summary, {});
  const Status read = read_source(old, true);
  if (read && whole.size() > whole_before.size()) return {};
  if (!read && read.error().code != ErrorCode::not_found) return read;
  fs::remove(old, ec);
  source = before;
  whole = whole_before;
  summary = summary_before;
  return {};
}

/// `own`: it may be cut short, as the process that wrote it ended.
Status DatasetRecording::Impl::read_source(const fs::path& from, bool own) {
  auto reader = record::McapReader::open(from.string(), {.skip_damaged = own});
  if (!reader && own) return fail(ErrorCode::not_found, from.string(), "ended before its first record");
  if (!reader) return tl::unexpected<Error>(reader.error());
  json there;
  for (const record::Metadata& m : (*reader)->readable_metadata())
    if (m.name == kMetadata && m.values.contains("manifest"))
      there = json::parse(m.values.at("manifest"), nullptr, false);
  if (!there.is_object()) {
    if (own) return fail(ErrorCode::not_found, from.string(), "holds no manifest");
    return fail(
        ErrorCode::bad_input, file.string(),
        "expected what an earlier `rigor dataset` wrote, got another recording; give another file with -o");
  }
  if (const std::string d = manifest_difference(there, manifest); !d.empty())
    return fail(ErrorCode::bad_input, from.string(),
                "expected a file of the same dataset, to be continued; " + d + "; give another file with -o" +
                    (own ? ", or delete this one" : ""));
  auto cursor = (*reader)->messages({.topics = {kSamplesTopic}});
  record::MessageView m;
  while (true) {
    const auto more = cursor.next(m);
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) break;
    const json sample =
        json::parse(reinterpret_cast<const char*>(m.data.data()),
                    reinterpret_cast<const char*>(m.data.data()) + m.data.size(), nullptr, false);
    if (sample.is_object() && whole.insert(m.log_time_ns / kSample_ns).second) count(sample);
  }
  source = from;
  return {};
}

void DatasetRecording::Impl::count(const json& sample) {
  const json channels_there = sample.value("channels", json::object());
  if (channels_there.empty())
    ++summary.left_out;
  else
    ++summary.samples;
  for (const auto& view : channels_there)
    for (const auto& thing : view.value("instances", json::array()))
      if (thing.contains("counts")) ++summary.annotations;
  for (const auto& pose : sample.value("rejected", json::array())) {
    const std::string reason = pose.value("reason", "");
    auto known = std::find_if(summary.rejected.begin(), summary.rejected.end(),
                              [&](const auto& r) { return r.first == reason; });
    if (known == summary.rejected.end()) known = summary.rejected.insert(known, {reason, 0});
    ++known->second;
  }
}

/// Opens the part, with what the source has.
Status DatasetRecording::Impl::begin() {
  const int fd = ::fcntl(lock, F_DUPFD_CLOEXEC, 0);
  if (fd < 0) return tl::unexpected<Error>(output_error(part, errno));
  auto opened = record::McapWriter::open(record::file_sink(fd, part.string()),
                                         {.compression = record::Compression::zstd});
  if (!opened) return tl::unexpected<Error>(opened.error());
  writer = std::move(*opened);
  json categories = json::array();
  for (const DatasetCategory& c : dataset.categories())
    categories.push_back(
        {{"id", c.id}, {"name", c.name}, {"supercategory", c.base}, {"isthing", c.thing ? 1 : 0}});
  if (auto s = writer->add_metadata(
          {kMetadata, {{"manifest", manifest.dump()}, {"categories", categories.dump()}}});
      !s)
    return s;
  return source.empty() ? Status{} : copy();
}

Status DatasetRecording::Impl::copy() {
  auto reader = record::McapReader::open(source.string(), {.skip_damaged = source == old});
  if (!reader) return tl::unexpected<Error>(reader.error());
  auto cursor = (*reader)->messages({.order = record::MessageOrder::file});
  record::MessageView m;
  while (true) {
    const auto more = cursor.next(m);
    if (!more) return tl::unexpected<Error>(more.error());
    if (!*more) return writer->flush();
    if (!whole.contains(m.log_time_ns / kSample_ns)) continue;
    const auto to =
        channel(m.channel->topic, m.schema ? m.schema->name : "", m.schema ? m.schema->encoding.c_str() : "",
                m.schema ? m.schema->text : "", m.channel->message_encoding.c_str());
    if (!to) return tl::unexpected<Error>(to.error());
    if (auto s = writer->write({*to, m.sequence, m.log_time_ns, m.publish_time_ns}, m.data); !s) return s;
  }
}

Result<std::uint16_t> DatasetRecording::Impl::channel(const std::string& topic, const std::string& type,
                                                      const char* encoding, const std::string& schema,
                                                      const char* messages) {
  if (const auto known = channels.find(topic); known != channels.end()) return known->second;
  auto of_type = schemas.find(type);
  if (of_type == schemas.end()) {
    const auto id = writer->add_schema(type, encoding, schema);
    if (!id) return id;
    of_type = schemas.emplace(type, *id).first;
  }
  const auto id = writer->add_channel({of_type->second, topic, messages, {}});
  if (id) channels.emplace(topic, *id);
  return id;
}

Status DatasetRecording::Impl::put(const std::string& topic, std::string_view type, std::uint64_t index,
                                   record::Pieces pieces) {
  const std::string name(type);
  const auto to =
      channel(topic, name, "ros2msg", channels.contains(topic) ? "" : record::schema_text(type), "cdr");
  if (!to) return tl::unexpected<Error>(to.error());
  return writer->write({*to, static_cast<std::uint32_t>(index), index * kSample_ns, index * kSample_ns},
                       pieces);
}

Status DatasetRecording::Impl::put_measurement(const DatasetView& view, std::uint64_t index) {
  Sample sample;
  sample.stamp.sequence = index;
  sample.stamp.t_capture = sample.stamp.t_release = sample.stamp.t_arrival =
      BenchTime(static_cast<std::int64_t>(index * kSample_ns));
  const auto fill = [&](std::initializer_list<std::span<const std::byte>> blocks) {
    std::size_t size = 0;
    for (const auto& b : blocks) size += b.size();
    sample.reserve(std::max<std::size_t>(size, 1));
    sample.size_bytes = size;
    std::byte* at = sample.memory().data();
    for (const auto& b : blocks) at = std::copy(b.begin(), b.end(), at);
  };
  if (view.kind == SampleKind::image) {
    sample.info = view.image;
    fill({view.pixels});
  } else if (view.kind == SampleKind::range_image) {
    sample.info = RangeImageInfo{view.width, view.height};
    fill({std::as_bytes(std::span(view.range_m)), std::as_bytes(std::span(view.amplitude))});
  } else {
    sample.info = PointCloudInfo{static_cast<std::uint32_t>(view.points.size())};
    fill({std::as_bytes(std::span(view.points))});
  }
  const auto encoder =
      encoders
          .try_emplace(view.channel,
                       record::SampleChannel{view.channel,
                                             fmt::format("/{}/{}", view.channel, record::topic_of(view.kind)),
                                             view.channel, view.kind})
          .first;
  const auto messages = encoder->second.encode(sample);
  if (!messages) return tl::unexpected<Error>(messages.error());
  for (const record::SampleMessage& m : *messages) {
    const record::SampleStream& stream = encoder->second.streams()[m.stream];
    if (auto s = put(stream.topic, stream.type, index, m.pieces); !s) return s;
  }
  return {};
}

Status DatasetRecording::Impl::put_truth(const DatasetView& view, std::uint64_t index,
                                         const msg::Header& header) {
  if (view.truth.node.empty()) return {};
  const std::string topic = "/" + view.channel + "/truth";
  if (view.kind == SampleKind::point_cloud) {
    std::vector<LabelledPoint> points;
    for (std::size_t i = 0; i < view.points.size(); ++i) {
      const LidarPoint& p = view.points[i];
      points.push_back({p.x_m, p.y_m, p.z_m, view.truth.range_m[i], view.labels.category[i],
                        static_cast<std::uint32_t>(view.truth.node[i]),
                        static_cast<std::uint32_t>(view.truth.node[i] >> 32)});
    }
    const auto bytes = std::as_bytes(std::span(points));
    return put(
        topic, index,
        msg::PointCloud2{header, 1, static_cast<std::uint32_t>(points.size()), label_fields(), false,
                         sizeof(LabelledPoint), static_cast<std::uint32_t>(bytes.size()), bytes, false});
  }
  const auto layer = [&](const char* name, const char* encoding, std::size_t pixel,
                         std::span<const std::byte> bytes) -> Status {
    if (std::find(options.layers.begin(), options.layers.end(), name) == options.layers.end()) return {};
    if (bytes.size() != pixel * view.width * view.height) return {};  // flow of what is no camera
    return put(topic + "/" + name, index,
               msg::Image{header, view.height, view.width, encoding, 0,
                          static_cast<std::uint32_t>(pixel * view.width), bytes});
  };
  const auto bytes = [](const auto& values) { return std::as_bytes(std::span(values)); };
  if (auto s = layer("depth", "32FC1", 4, bytes(view.depth_m)); !s) return s;
  if (auto s = layer("instance", "16UC1", 2, bytes(view.labels.instance)); !s) return s;
  if (auto s = layer("class", "8UC1", 1, bytes(view.labels.category)); !s) return s;
  if (auto s = layer("true_range", "32FC1", 4, bytes(view.truth.range_m)); !s) return s;
  if (auto s = layer("normal", "32FC3", 12, bytes(view.truth.normal)); !s) return s;
  return layer("flow", "32FC2", 8, bytes(view.truth.flow_px));
}

bool DatasetRecording::has(std::uint64_t index) const { return impl_->whole.contains(index); }

Status DatasetRecording::write(const DatasetSample& sample) {
  Impl& f = *impl_;
  if (!f.writer)
    if (auto s = f.begin(); !s) return s;
  const msg::Time stamp{static_cast<std::int32_t>(sample.index), 0};
  msg::TFMessage tf;
  json channels = json::object();
  for (const DatasetView& view : sample.views) {
    tf.transforms.push_back(transform({stamp, "world"}, view));
    channels[view.channel] = dataset::described(view, f.dataset.options().truth, f.options.min_area_px);
  }
  if (!tf.transforms.empty())
    if (auto s = f.put("/tf", sample.index, tf); !s) return s;
  for (const DatasetView& view : sample.views) {
    const msg::Header header{stamp, view.channel};
    if (view.lens) {
      msg::CameraInfo info = camera_info(*view.lens);
      info.header = header;
      if (auto s = f.put("/" + view.channel + "/camera_info", sample.index, info); !s) return s;
    }
    if (auto s = f.put_measurement(view, sample.index); !s) return s;
    if (auto s = f.put_truth(view, sample.index, header); !s) return s;
  }
  json j = dataset::described(sample);
  j["channels"] = std::move(channels);
  const std::string text = j.dump();
  const auto to = f.channel(kSamplesTopic, "rigor.DatasetSample", "jsonschema", kSampleSchema, "json");
  if (!to) return tl::unexpected<Error>(to.error());
  const std::uint64_t t_ns = sample.index * kSample_ns;
  if (auto s = f.writer->write({*to, static_cast<std::uint32_t>(sample.index), t_ns, t_ns},
                               std::as_bytes(std::span(text)));
      !s)
    return s;
  f.whole.insert(sample.index);
  f.count(j);
  return {};
}

Result<DatasetSummary> DatasetRecording::finish() {
  Impl& f = *impl_;
  if (!f.writer && f.source != f.file)
    if (auto s = f.begin(); !s) return tl::unexpected<Error>(s.error());
  if (f.writer) {
    if (auto s = f.writer->close(); !s) return tl::unexpected<Error>(s.error());
    if (auto s = f.writer->sync(); !s) return tl::unexpected<Error>(s.error());
    f.writer.reset();
    if (std::rename(f.part.c_str(), f.file.c_str()) != 0)
      return tl::unexpected<Error>(output_error(f.file, errno));
    std::error_code ec;
    fs::remove(f.old, ec);
    f.finished = true;
  }
  std::sort(f.summary.rejected.begin(), f.summary.rejected.end());
  return f.summary;
}

}  // namespace rigor
