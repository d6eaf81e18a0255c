#include "rt-core/trace.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>

namespace rigor {
namespace {

std::string json_string(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    const auto u = static_cast<unsigned char>(c);
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (u < 0x20) {
      char buffer[8];
      std::snprintf(buffer, sizeof buffer, "\\u%04x", u);
      out += buffer;
    } else {
      out += c;
    }
  }
  return out + '"';
}

}  // namespace

TraceThread::TraceThread(std::string name, std::size_t capacity, std::uint32_t id)
    : name_(std::move(name)), id_(id), capacity_(capacity), events_(std::make_unique<Event[]>(capacity)) {}

TraceName Trace::name(const std::string& text) {
  const std::lock_guard lock(mutex_);
  for (std::size_t i = 0; i < names_.size(); ++i)
    if (names_[i] == text) return static_cast<TraceName>(i);
  names_.push_back(text);
  return static_cast<TraceName>(names_.size() - 1);
}

TraceThread& Trace::thread(const std::string& name, std::size_t capacity) {
  const std::lock_guard lock(mutex_);
  const auto id = static_cast<std::uint32_t>(threads_.size() + 1);
  threads_.push_back(std::unique_ptr<TraceThread>(new TraceThread(name, capacity, id)));
  return *threads_.back();
}

std::uint64_t Trace::dropped() const {
  const std::lock_guard lock(mutex_);
  std::uint64_t n = 0;
  for (const auto& t : threads_) n += t->dropped();
  return n;
}

std::optional<std::int64_t> Trace::full_since_ns() const {
  const std::lock_guard lock(mutex_);
  std::optional<std::int64_t> since;
  for (const auto& t : threads_)
    if (t->dropped() > 0) since = std::min(since.value_or(t->first_dropped_ns()), t->first_dropped_ns());
  return since;
}

Status Trace::write(const std::string& path) const {
  const std::lock_guard lock(mutex_);
  std::FILE* file = std::fopen(path.c_str(), "w");
  if (!file)
    return fail(ErrorCode::not_writable, path,
                std::string("the trace cannot be written: ") + std::strerror(errno) +
                    "; choose a folder that exists and is yours");
  errno = 0;
  std::fputs("{\"displayTimeUnit\":\"ns\",\"traceEvents\":[\n", file);
  std::fputs("{\"ph\":\"M\",\"pid\":1,\"tid\":0,\"name\":\"process_name\",\"args\":{\"name\":\"rigor\"}}",
             file);
  std::vector<std::string> names;
  for (const std::string& n : names_) names.push_back(json_string(n));
  std::uint64_t dropped = 0;
  for (const auto& t : threads_) {
    dropped += t->dropped();
    std::fprintf(file,
                 ",\n{\"ph\":\"M\",\"pid\":1,\"tid\":%u,\"name\":\"thread_name\",\"args\":{\"name\":%s}}",
                 t->id_, json_string(t->name_).c_str());
    const std::size_t n = t->recorded();
    for (std::size_t i = 0; i < n; ++i) {
      const TraceThread::Event& e = t->events_[i];
      const char* phase = "BEiC";
      // Microseconds with three decimals: exact, where a double of this size would not be.
      std::fprintf(file, ",\n{\"ph\":\"%c\",\"pid\":1,\"tid\":%u,\"ts\":%lld.%03lld,\"name\":%s",
                   phase[static_cast<int>(e.kind)], t->id_, static_cast<long long>(e.t_ns / 1000),
                   static_cast<long long>(e.t_ns % 1000), names[e.name].c_str());
      if (e.kind == TraceThread::Kind::instant) std::fputs(",\"s\":\"t\"", file);
      if (e.kind == TraceThread::Kind::counter)
        std::fprintf(file, ",\"args\":{\"value\":%.17g}", std::isfinite(e.value) ? e.value : 0.0);
      std::fputs("}", file);
    }
  }
  std::fprintf(file, "\n],\"otherData\":{\"dropped_events\":\"%llu\"}}\n",
               static_cast<unsigned long long>(dropped));
  const bool bad = std::ferror(file) != 0;
  const int error = errno;
  if (std::fclose(file) != 0 || bad) {
    const int e = bad && error ? error : errno;
    return fail(e == ENOSPC ? ErrorCode::disk_full : ErrorCode::io, path,
                std::string("the trace is incomplete: ") + std::strerror(e));
  }
  return {};
}

}  // namespace rigor
