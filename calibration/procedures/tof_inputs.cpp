#include "calibration/procedures/tof_inputs.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <map>
#include <sstream>

#include "calibration/procedures/recording_input.h"
#include "rt-core/numbers.h"

namespace rigor {
namespace {

std::vector<std::string> split(const std::string& line, char separator) {
  std::vector<std::string> parts;
  std::stringstream in(line);
  for (std::string p; std::getline(in, p, separator);) {
    while (!p.empty() && (p.back() == '\r' || p.back() == ' ')) p.pop_back();
    while (!p.empty() && p.front() == ' ') p.erase(p.begin());
    parts.push_back(p);
  }
  return parts;
}

bool number(const std::string& text, double& value) {
  const auto [end, ec] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (ec == std::errc{} && end == text.data() + text.size() && !text.empty()) return true;
  std::string lower = text;
  std::transform(lower.begin(), lower.end(), lower.begin(), [](unsigned char c) { return std::tolower(c); });
  value = kNaN;
  return lower == "nan" || lower.empty();
}

Result<std::vector<double>> distances_of(const std::vector<std::filesystem::path>& files,
                                         const std::string& text) {
  std::vector<double> out(files.size(), kNaN);
  if (text.empty()) return out;
  std::error_code ec;
  if (std::filesystem::is_regular_file(text, ec)) {
    std::map<std::string, double> of;
    std::ifstream in(text);
    int line_number = 0;
    for (std::string line; std::getline(in, line);) {
      ++line_number;
      const auto parts = split(line, ',');
      double d = 0;
      if (parts.size() < 2 || parts[0].starts_with("#")) continue;
      if (!number(parts[1], d) || !(d > 0)) {
        if (line_number == 1) continue;  // names of the columns
        return fail(ErrorCode::bad_input, text + ":" + std::to_string(line_number),
                    "expected a recording and its distance in metres above 0, got " + line);
      }
      of[parts[0]] = d;
    }
    for (std::size_t i = 0; i < files.size(); ++i) {
      auto at = of.find(files[i].string());
      if (at == of.end()) at = of.find(files[i].filename().string());
      if (at == of.end())
        return fail(ErrorCode::bad_input, text,
                    "expected a line for each recording, got none for " + files[i].filename().string());
      out[i] = at->second;
    }
    return out;
  }
  const auto parts = split(text, ',');
  if (parts.size() != files.size())
    return fail(
        ErrorCode::bad_input, "--distances",
        fmt::format("expected one distance in metres for each recording, or a CSV file, got {} for {} "
                    "recordings",
                    parts.size(), files.size()));
  for (std::size_t i = 0; i < parts.size(); ++i)
    if (!number(parts[i], out[i]) || !(out[i] > 0))
      return fail(ErrorCode::bad_input, "--distances", "expected metres above 0, got " + parts[i]);
  return out;
}

Result<std::vector<std::uint16_t>> read_raw(const std::filesystem::path& file, std::size_t count) {
  std::error_code ec;
  const auto size = std::filesystem::file_size(file, ec);
  if (ec) return fail(ErrorCode::not_found, file.string(), "expected a file, got none: " + ec.message());
  if (size != count * 2)
    return fail(
        ErrorCode::bad_input, file.string(),
        fmt::format("expected {} bytes for the size that was given (2 per pixel), got {}", count * 2, size));
  std::vector<unsigned char> bytes(count * 2);
  std::ifstream in(file, std::ios::binary);
  if (!in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size())))
    return fail(ErrorCode::bad_input, file.string(), "cannot be read to its end");
  std::vector<std::uint16_t> out(count);
  for (std::size_t i = 0; i < count; ++i)
    out[i] = static_cast<std::uint16_t>(bytes[2 * i] | bytes[2 * i + 1] << 8);
  return out;
}

}  // namespace

Status add_recordings(const std::vector<std::filesystem::path>& files, const std::string& channel,
                      const std::string& distances, TofInputs& out) {
  const auto known = distances_of(files, distances);
  if (!known) return tl::unexpected<Error>(known.error());
  for (std::size_t k = 0; k < files.size(); ++k) {
    std::int64_t first_ns = 0;
    std::size_t index = 0;
    const auto read = read_samples(files[k], channel, SampleKind::range_image, [&](const Sample& sample) {
      const auto* info = sample.as<RangeImageInfo>();
      if (!info) return true;
      const std::size_t n = std::size_t{info->width_px} * info->height_px;
      const auto bytes = sample.bytes();
      if (bytes.size() < n * 4) return true;
      calibration::TofFrame f;
      f.name = fmt::format("{} frame {}", files[k].filename().string(), index);
      f.width_px = static_cast<int>(info->width_px), f.height_px = static_cast<int>(info->height_px);
      f.range_m.resize(n);
      std::memcpy(f.range_m.data(), bytes.data(), n * 4);
      if (bytes.size() >= n * 8) {
        f.amplitude.resize(n);
        std::memcpy(f.amplitude.data(), bytes.data() + n * 4, n * 4);
      }
      if (index == 0) first_ns = sample.stamp.t_capture.ns();
      f.t_s = 1e-9 * static_cast<double>(sample.stamp.t_capture.ns() - first_ns);
      f.distance_m = (*known)[k];
      ++index;
      out.frames.push_back(std::move(f));
      out.scene_of.push_back(k);
      return true;
    });
    if (!read) return tl::unexpected<Error>(read.error());
    for (const std::string& w : read->warnings)
      out.warnings.push_back(files[k].filename().string() + ": " + w);
    out.files.push_back(files[k]);
  }
  return {};
}

Status add_raw(const std::string& text, TofInputs& out, bool& is_depth) {
  const auto wrong = [&] {
    return fail(
        ErrorCode::bad_input, "--raw",
        "expected depth:FILE:WIDTHxHEIGHT[,amplitude:FILE] (or range:…), unsigned 16 bit little-endian in "
        "millimetres, got " +
            text);
  };
  std::string ranges, amplitudes;
  int width = 0, height = 0;
  for (const std::string& part : split(text, ',')) {
    const auto colon = part.find(':');
    if (colon == std::string::npos) return wrong();
    const std::string what = part.substr(0, colon);
    std::string file = part.substr(colon + 1);
    if (what == "depth" || what == "range") {
      is_depth = what == "depth";
      const auto last = file.rfind(':');
      if (last == std::string::npos || std::sscanf(file.c_str() + last + 1, "%dx%d", &width, &height) != 2)
        return wrong();
      ranges = file.substr(0, last);
    } else if (what == "amplitude") {
      if (const auto last = file.rfind(':'); last != std::string::npos) file.resize(last);
      amplitudes = file;
    } else {
      return wrong();
    }
  }
  if (ranges.empty() || width < 1 || height < 1 || width > 16384 || height > 16384) return wrong();
  const auto n = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  const auto mm = read_raw(ranges, n);
  if (!mm) return tl::unexpected<Error>(mm.error());
  calibration::TofFrame f;
  f.name = std::filesystem::path(ranges).filename().string();
  f.width_px = width, f.height_px = height;
  for (const std::uint16_t v : *mm)
    f.range_m.push_back(v == 0 ? std::numeric_limits<float>::quiet_NaN() : 1e-3F * static_cast<float>(v));
  out.files.emplace_back(ranges);
  if (!amplitudes.empty()) {
    const auto a = read_raw(amplitudes, n);
    if (!a) return tl::unexpected<Error>(a.error());
    f.amplitude.assign(a->begin(), a->end());
    out.files.emplace_back(amplitudes);
  }
  out.frames.push_back(std::move(f));
  out.scene_of.push_back(1000000 + out.files.size());
  return {};
}

Result<TofSeries> read_series(const std::filesystem::path& file, const std::string& unit, double period_s) {
  std::ifstream in(file);
  if (!in)
    return fail(ErrorCode::not_found, file.string(), "expected a CSV file, got nothing that can be read");
  TofSeries out;
  double scale = unit == "m" ? 1 : 1e-3;
  std::vector<double> times;
  double rate = 0;
  std::size_t columns = 0;
  int line_number = 0;
  for (std::string line; std::getline(in, line);) {
    ++line_number;
    const auto parts = split(line, ',');
    if (parts.empty() || (parts.size() == 1 && parts[0].empty())) continue;
    double a = kNaN, b = kNaN;
    const bool first = number(parts[0], a) && !parts[0].empty();
    if (!first && out.range_m.empty()) {
      double v = 0;
      if (parts.size() == 2 && (parts[0] == "Fs" || parts[0] == "fs") && number(parts[1], v) && v > 0)
        rate = v;
      const std::string& name = parts.back();
      if (name.ends_with("_mm")) scale = 1e-3;
      if (name.ends_with("_m")) scale = 1;
      continue;
    }
    if (columns == 0) columns = std::min<std::size_t>(parts.size(), 2);
    if (!first && !number(parts[0], a))
      return fail(ErrorCode::bad_input, fmt::format("{}:{}", file.string(), line_number),
                  "expected a number, got " + line);
    if (columns == 2) {
      if (parts.size() < 2 || !number(parts[1], b))
        return fail(ErrorCode::bad_input, fmt::format("{}:{}", file.string(), line_number),
                    "expected a time in seconds and a reading, got " + line);
      times.push_back(a);
      out.range_m.push_back(scale * b);
    } else {
      out.range_m.push_back(scale * a);
    }
  }
  if (out.range_m.empty())
    return fail(ErrorCode::bad_input, file.string(),
                "expected a column of readings, got no line with a number");
  if (period_s > 0) {
    out.period_s = period_s;
  } else if (!times.empty()) {
    std::vector<double> steps;
    for (std::size_t i = 1; i < times.size(); ++i) steps.push_back(times[i] - times[i - 1]);
    std::nth_element(steps.begin(), steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2),
                     steps.end());
    out.period_s = steps.empty() ? 0 : steps[steps.size() / 2];
    if (out.period_s > 0) {
      // On an even grid; what is missing is missing, and what came twice counts once.
      std::vector<double> grid;
      std::size_t twice = 0;
      for (std::size_t i = 0; i < times.size(); ++i) {
        const double at = std::round((times[i] - times.front()) / out.period_s);
        if (!(at >= 0 && at < 1e8)) continue;
        const auto k = static_cast<std::size_t>(at);
        if (k >= grid.size()) grid.resize(k + 1, kNaN);
        twice += std::isfinite(grid[k]);
        if (!std::isfinite(grid[k])) grid[k] = out.range_m[i];
      }
      if (twice > 0)
        out.warnings.push_back(fmt::format("{} readings have the time of another: the first counts", twice));
      out.range_m = std::move(grid);
    }
  } else if (rate > 0) {
    out.period_s = 1 / rate;
    out.warnings.push_back(
        fmt::format("times are counted with the nominal rate of the file, {:g} Hz; --period says "
                    "another",
                    rate));
  }
  if (!(out.period_s > 0))
    return fail(
        ErrorCode::bad_input, file.string(),
        "expected times, a line `Fs,RATE`, or --period SECONDS: without them there is no drift per second");
  return out;
}

}  // namespace rigor
