// Recordings: messages as arrays that point into the mapped file or an unpacked chunk.
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <cstring>

#include "python/errors.h"
#include "python/module.h"
#include "sensor-hal/record/message_access.h"

namespace rigor::python {
namespace {

using record::MessageAccess;
using record::MessagePlace;

/// Read-only bytes that keep what they lie in.
py::array held_bytes(const record::HeldMessage& message) {
  auto* keeper = new std::shared_ptr<const void>(message.keeper);
  const py::capsule base(keeper, [](void* p) { delete static_cast<std::shared_ptr<const void>*>(p); });
  py::array_t<std::uint8_t> array(static_cast<py::ssize_t>(message.data.size()),
                                  reinterpret_cast<const std::uint8_t*>(message.data.data()), base);
  array.attr("setflags")(py::arg("write") = false);
  return array;
}

class Recording {
 public:
  Recording(const std::string& path, bool verify, std::uint64_t cache_bytes, bool skip_damaged) {
    Result<std::unique_ptr<MessageAccess>> access = [&] {
      const py::gil_scoped_release without_gil;
      return MessageAccess::open(
          path, {.verify = verify, .cache_bytes = cache_bytes, .skip_damaged = skip_damaged});
    }();
    access_ = value_of(std::move(access));
  }

  py::list channels() {
    py::list all;
    record::McapReader& reader = access_->reader();
    for (const auto& [id, channel] : reader.channels()) {
      py::dict c;
      c["id"] = id;
      c["topic"] = channel.topic;
      c["encoding"] = channel.message_encoding;
      c["metadata"] = channel.metadata;
      const auto schema = reader.schemas().find(channel.schema);
      const bool known = schema != reader.schemas().end();
      c["type"] = known ? schema->second.name : "";
      c["schema_encoding"] = known ? schema->second.encoding : "";
      c["schema"] = known ? schema->second.text : "";
      const auto count = reader.message_counts().find(id);
      c["count"] = count == reader.message_counts().end() ? 0 : count->second;
      all.append(std::move(c));
    }
    return all;
  }

  py::dict about() {
    record::McapReader& reader = access_->reader();
    const record::Health& h = reader.health();
    py::dict d;
    d["profile"] = reader.profile();
    d["library"] = reader.library();
    d["bytes"] = reader.file_bytes();
    d["messages"] = reader.message_count();
    d["good"] = h.good();
    d["indexed"] = h.indexed;
    d["truncated"] = h.truncated;
    d["lost_bytes"] = h.lost_bytes;
    d["damaged_chunks"] = h.damaged_chunks;
    d["notes"] = h.notes;
    std::set<std::string> compressions;
    for (const auto& segment : reader.segments()) compressions.insert(segment.compression);
    d["compressions"] = compressions;
    return d;
  }

  py::list metadata() {
    py::list all;
    for (const auto& m : access_->reader().readable_metadata()) all.append(py::make_tuple(m.name, m.values));
    return all;
  }

  py::list attachments() {
    py::list all;
    for (std::size_t i = 0; i < access_->reader().attachment_count(); ++i) {
      const auto a = value_of(access_->reader().attachment(i));
      all.append(py::make_tuple(a.name, a.media_type,
                                py::bytes(reinterpret_cast<const char*>(a.data.data()), a.data.size())));
    }
    return all;
  }

  std::size_t count(std::uint16_t channel) { return places(channel).size(); }

  py::array_t<std::int64_t> times(std::uint16_t channel) {
    const auto list = places(channel);
    py::array_t<std::int64_t> times(static_cast<py::ssize_t>(list.size()));
    std::int64_t* out = times.mutable_data();
    for (const MessagePlace& p : list) *out++ = static_cast<std::int64_t>(p.log_time_ns);
    return times;
  }

  py::array message(std::uint16_t channel, std::size_t i) {
    const auto list = places(channel);
    if (i >= list.size())
      throw py::index_error("message " + std::to_string(i) + " of " + std::to_string(list.size()));
    Result<record::HeldMessage> message = [&] {
      const py::gil_scoped_release without_gil;
      return access_->at(list[i]);
    }();
    return held_bytes(value_of(std::move(message)));
  }

  /// Messages first, first + step, …: one row each, copied; None where they are not of one length.
  py::object gather(std::uint16_t channel, std::size_t first, std::size_t count, std::ptrdiff_t step) {
    const auto list = places(channel);
    const auto index = [&](std::size_t i) {
      return static_cast<std::size_t>(static_cast<std::ptrdiff_t>(first) +
                                      static_cast<std::ptrdiff_t>(i) * step);
    };
    if (count > 0 && (first >= list.size() || index(count - 1) >= list.size()))
      throw py::index_error("expected messages below " + std::to_string(list.size()));
    if (count == 0) return py::array_t<std::uint8_t>(std::vector<py::ssize_t>{0, 0});
    const std::size_t length = value_of(access_->at(list[first])).data.size();
    py::array_t<std::uint8_t> rows(
        std::vector<py::ssize_t>{static_cast<py::ssize_t>(count), static_cast<py::ssize_t>(length)});
    std::uint8_t* out = rows.mutable_data();
    constexpr std::size_t kBytesAtOnce = std::size_t{64} << 20;  // between two looks for Ctrl-C
    std::size_t i = 0;
    bool alike = true;
    while (i < count && alike) {
      Status status;
      {
        const py::gil_scoped_release without_gil;
        for (std::size_t bytes = 0; i < count && bytes < kBytesAtOnce; ++i, bytes += length) {
          auto message = access_->at(list[index(i)]);
          if (!message) {
            status = tl::unexpected<Error>(message.error());
            break;
          }
          alike = message->data.size() == length;
          if (!alike) break;
          if (length > 0) std::memcpy(out + i * length, message->data.data(), length);
        }
      }
      check(status);
      if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    }
    return alike ? py::object(std::move(rows)) : py::none();
  }

 private:
  std::span<const MessagePlace> places(std::uint16_t channel) {
    Result<std::span<const MessagePlace>> list = [&] {
      const py::gil_scoped_release without_gil;
      return access_->places(channel);
    }();
    return value_of(std::move(list));
  }

  std::unique_ptr<MessageAccess> access_;
};

}  // namespace

void add_recordings(py::module_& m) {
  py::class_<Recording>(m, "Recording")
      .def(py::init<const std::string&, bool, std::uint64_t, bool>())
      .def("channels", &Recording::channels)
      .def("about", &Recording::about)
      .def("metadata", &Recording::metadata)
      .def("attachments", &Recording::attachments)
      .def("count", &Recording::count)
      .def("times", &Recording::times)
      .def("message", &Recording::message)
      .def("gather", &Recording::gather);
}

}  // namespace rigor::python
