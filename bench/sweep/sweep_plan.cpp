#include "bench/sweep/sweep_plan.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>

#include "bench/bench.h"
#include "bench/files/file_digest.h"
#include "bench/files/manifest.h"
#include "bench/files/output_file.h"
#include "bench/tune/lock_file.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/models/philox.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kFormat = "rigor sweep";
constexpr int kFormatVersion = 1;
/// Values of a parameter with which the rig's file is read; of more of them the ends.
constexpr std::size_t kRead = 1000;

std::vector<std::string> some_of(const SweepParameter& p, std::size_t most) {
  std::vector<std::string> values = p.listed();
  if (values.size() > most) values = {values.front(), values.back()};
  return values;
}

/// Of a key such as channels.lefft.rate_hz: what the rig has in place of `lefft`, where it has no such map.
std::string near_key(const ConfigNode& rig, const std::string& key) {
  ConfigNode at = rig;
  for (std::size_t begin = 0, dot = 0; (dot = key.find('.', begin)) != std::string::npos; begin = dot + 1) {
    const std::string part = key.substr(begin, dot - begin);
    if (!at.is_map()) return "";
    if (!at.has(part)) {
      const std::string near = nearest(part, at.keys());
      return near.empty() ? ""
                          : fmt::format("; the rig has no {}, did you mean {}{}?", key.substr(0, dot),
                                        key.substr(0, begin), near);
    }
    const auto next = catch_config([&] { return at.map(part); });
    if (!next) return "";
    at = *next;
  }
  return "";
}

}  // namespace

Result<SweepParameter> SweepParameter::parse(const std::string& text) {
  const auto equals = text.find('=');
  if (equals == std::string::npos)
    return fail(ErrorCode::bad_input, "--vary", "expected KEY=VALUES, got \"" + text + "\"");
  SweepParameter p;
  p.key = text.substr(0, equals);
  p.written = {text.substr(equals + 1), "--vary " + p.key};
  if (const auto as_override = ConfigOverride::parse(p.key + "=0"); !as_override)
    return fail(ErrorCode::bad_input, "--vary " + text, as_override.error().message);
  if (p.key == "seed")
    return fail(ErrorCode::bad_input, p.written.where,
                "expected --seeds N, which counts from the rig's own seed (--set seed=…)");
  auto values = dataset::Values::parse(p.written);
  if (!values) return tl::unexpected<Error>(values.error());
  p.values = std::move(*values);
  std::vector<std::string> words = p.values.words();
  std::ranges::sort(words);
  if (const auto twice = std::ranges::adjacent_find(words); twice != words.end())
    return fail(ErrorCode::bad_input, p.written.where, "expected each value once, got " + *twice + " again");
  return p;
}

std::vector<std::string> SweepParameter::listed() const {
  return values.words().empty() ? std::vector<std::string>{values.at(0), values.at(1)} : values.words();
}

Status SweepPlan::count_points() {
  for (std::size_t i = 0; i < options_.vary.size(); ++i)
    for (std::size_t k = 0; k < i; ++k)
      if (options_.vary[i].key == options_.vary[k].key)
        return fail(ErrorCode::bad_input, options_.vary[i].written.where,
                    "expected each key once, got " + options_.vary[i].key + " again");
  points_ = 1;
  if (options_.samples > 0) {
    if (options_.vary.empty())
      return fail(ErrorCode::bad_input, "--sample", "expected --vary with what is to be drawn, got none");
    points_ = options_.samples;
  } else {
    for (const SweepParameter& p : options_.vary) {
      if (p.values.words().empty())
        return fail(ErrorCode::bad_input, p.written.where,
                    fmt::format("expected a list or a range with a number of steps, such as {}:10, got "
                                "\"{}\"; --sample N draws from ranges",
                                p.written.text, p.written.text));
      points_ *= p.values.words().size();
      if (points_ > SweepOptions::kMostRuns) break;
    }
  }
  // Both are below 2^40 here: their product holds.
  const std::uint64_t seeds = std::min(seeds_each(), SweepOptions::kMostRuns + 1);
  if (points_ * seeds > SweepOptions::kMostRuns)
    return fail(ErrorCode::bad_input, "--vary, --seeds",
                fmt::format("expected at most {} runs, got {} combinations of values times {} seeds",
                            SweepOptions::kMostRuns, points_, seeds_each()));
  return {};
}

/// Latin hypercube: of each parameter every one of N equal parts of its range has one sample, drawn evenly
/// within the part; the parts are shuffled for each parameter on its own.
void SweepPlan::draw_samples() {
  samples_.clear();
  if (options_.samples == 0) return;
  for (const SweepParameter& p : options_.vary) {
    const std::uint32_t element = models::channel_id_from_name(p.key);
    std::vector<std::array<double, 4>> draws(points_);
    for (std::uint64_t k = 0; k < points_; ++k)
      draws[k] = dataset::draw(options_.draw_seed, dataset::Draw::value, k, element);
    std::vector<std::uint64_t> order(points_);
    std::iota(order.begin(), order.end(), std::uint64_t{0});
    std::ranges::stable_sort(order,
                             [&](std::uint64_t a, std::uint64_t b) { return draws[a][1] < draws[b][1]; });
    std::vector<std::string> values(points_);
    for (std::uint64_t part = 0; part < points_; ++part)
      values[order[part]] =
          p.values.at((static_cast<double>(part) + draws[order[part]][0]) / static_cast<double>(points_));
    samples_.push_back(std::move(values));
  }
}

std::vector<std::string> SweepPlan::first_values() const {
  std::vector<std::string> values;
  for (const SweepParameter& p : options_.vary) values.push_back(p.listed().front());
  return values;
}

std::vector<ConfigOverride> SweepPlan::overrides_of(const std::vector<std::string>& values) const {
  std::vector<ConfigOverride> out = options_.overrides;
  for (std::size_t i = 0; i < values.size(); ++i) out.push_back({options_.vary[i].key, values[i]});
  return out;
}

Error SweepPlan::refused(const std::vector<std::string>& values, const Error& error,
                         const Attempt& attempt) const {
  // Not the user's: nothing to blame.
  if (error.exit_status() != 2) return error;
  if (const auto alone = attempt(options_.overrides); !alone) return alone.error();
  for (std::size_t i = 0; i < values.size(); ++i) {
    std::vector<ConfigOverride> overrides = options_.overrides;
    overrides.push_back({options_.vary[i].key, values[i]});
    const auto one = attempt(overrides);
    if (one) continue;
    std::string message = one.error().text();
    if (message.find("did you mean") == std::string::npos)
      if (const auto rig = ConfigDocument::load(options_.rig, options_.overrides))
        message += near_key(*rig, options_.vary[i].key);
    return {ErrorCode::bad_input, fmt::format("--vary {}={}", options_.vary[i].key, values[i]), message};
  }
  std::vector<std::string> words;
  for (std::size_t i = 0; i < values.size(); ++i) words.push_back(options_.vary[i].key + "=" + values[i]);
  return {ErrorCode::bad_input, fmt::format("--vary {}", fmt::join(words, ", ")),
          "together: " + error.text()};
}

Status SweepPlan::read_rig() {
  InputFiles inputs;
  auto rig = load_rig(options_.rig, options_.overrides);
  if (!rig) return tl::unexpected<Error>(rig.error());
  first_seed_ = rig->seed;
  rig_records_ = !rig->record.file.empty();
  analyses_ = !rig->analyses.empty();
  if (rig->duration.ns() == 0 && options_.duration_s == 0)
    return fail(ErrorCode::bad_input, options_.rig.string(),
                "expected `duration_s` for runs in virtual time, which would otherwise never end; or give "
                "--duration");
  inputs.add_rig(*rig);
  for (std::size_t i = 0; i < options_.vary.size(); ++i)
    for (const std::string& value : some_of(options_.vary[i], kRead)) {
      std::vector<std::string> values = first_values();
      values[i] = value;
      const auto varied = load_rig(options_.rig, overrides_of(values));
      if (!varied)
        return tl::unexpected<Error>(refused(values, varied.error(), [&](const auto& overrides) -> Status {
          const auto loaded = load_rig(options_.rig, overrides);
          return loaded ? Status{} : tl::unexpected<Error>(loaded.error());
        }));
      inputs.add_rig(*varied);
    }
  inputs.add("what `rigor tune` chose", lock_path(options_.rig));
  for (const fs::path& plugin : options_.plugins) inputs.add("a plugin of the world", plugin);
  inputs_.clear();
  const json digests = input_digests(inputs, options_.rig);
  for (const auto& [name, digest] : digests.items()) inputs_.emplace_back(name, digest.get<std::string>());
  return {};
}

Result<SweepPlan> SweepPlan::create(const SweepOptions& options) {
  SweepPlan plan;
  plan.options_ = options;
  std::error_code ec;
  if (const fs::path whole = fs::canonical(options.rig, ec); !ec) plan.options_.rig = whole;
  for (fs::path& plugin : plan.options_.plugins)
    if (const fs::path whole = fs::canonical(plugin, ec); !ec) plugin = whole;
  if (auto s = plan.count_points(); !s) return tl::unexpected<Error>(s.error());
  if (auto s = plan.read_rig(); !s) return tl::unexpected<Error>(s.error());
  plan.draw_samples();
  return plan;
}

Status SweepPlan::check(const Registry& registry) const {
  const Attempt assemble = [&](const std::vector<ConfigOverride>& overrides) -> Status {
    auto rig = load_rig(options_.rig, overrides);
    if (!rig) return tl::unexpected<Error>(rig.error());
    rig->clock = ClockKind::virtual_time;
    rig->record.file.clear();
    rig->report.clear();
    const auto bench = Bench::create(std::move(*rig), registry);
    return bench ? Status{} : tl::unexpected<Error>(bench.error());
  };
  const auto check_values = [&](const std::vector<std::string>& values) -> Status {
    const auto s = assemble(overrides_of(values));
    return s ? s : tl::unexpected<Error>(refused(values, s.error(), assemble));
  };
  if (auto s = check_values(first_values()); !s) return s;
  for (std::size_t i = 0; i < options_.vary.size(); ++i) {
    const std::vector<std::string> tried = some_of(options_.vary[i], kChecked);
    for (std::size_t k = 1; k < tried.size(); ++k) {
      std::vector<std::string> values = first_values();
      values[i] = tried[k];
      if (auto s = check_values(values); !s) return s;
    }
  }
  return {};
}

SweepRun SweepPlan::run(std::uint64_t index) const {
  SweepRun run;
  run.index = index;
  run.seed = first_seed_ + index % seeds_each();
  std::uint64_t point = index / seeds_each();
  run.values.resize(options_.vary.size());
  for (std::size_t i = options_.vary.size(); i-- > 0;) {
    if (options_.samples > 0) {
      run.values[i] = samples_[i][point];
      continue;
    }
    const auto& words = options_.vary[i].values.words();
    run.values[i] = words[point % words.size()];
    point /= words.size();
  }
  return run;
}

std::vector<std::string> SweepPlan::command(const SweepRun& run) const {
  std::vector<std::string> words{"rigor", "run", options_.rig.string(), "--clock", "virtual"};
  const auto add = [&](const char* option, std::string value) {
    words.emplace_back(option);
    words.push_back(std::move(value));
  };
  if (options_.duration_s > 0) add("--duration", fmt::format("{}", options_.duration_s));
  for (const ConfigOverride& o : overrides_of(run.values)) add("--set", o.path + "=" + o.value);
  add("--set", fmt::format("seed={}", run.seed));
  for (const fs::path& plugin : options_.plugins) add("--plugin", plugin.string());
  return words;
}

std::vector<std::string> SweepPlan::child_command(const SweepRun& run) const {
  std::vector<std::string> words = command(run);
  words.insert(words.end(), {"--no-control", "--json", "--progress", "none", "--set", "report="});
  // A recording is written where an analysis of the rig reads it.
  if (rig_records_ && analyses_) words.insert(words.end(), {"--record", "recording.mcap"});
  if (rig_records_ && !analyses_) words.insert(words.end(), {"--set", "record.file="});
  return words;
}

json SweepPlan::manifest() const {
  json set = json::array(), vary = json::array(), plugins = json::array(), inputs = json::object();
  for (const ConfigOverride& o : options_.overrides) set.push_back(o.path + "=" + o.value);
  for (const SweepParameter& p : options_.vary) vary.push_back(p.key + "=" + p.written.text);
  for (const fs::path& plugin : options_.plugins) plugins.push_back(plugin.string());
  for (const auto& [name, digest] : inputs_) inputs[name] = digest;
  return {{"format", kFormat},
          {"format_version", kFormatVersion},
          {"rigor_version", RIGOR_VERSION},
          {"rig", options_.rig.string()},
          {"set", set},
          {"vary", vary},
          {"seeds", options_.seeds},
          {"first_seed", first_seed_},
          {"sample", options_.samples},
          {"sample_seed", options_.draw_seed},
          {"duration_s", options_.duration_s},
          {"plugins", plugins},
          {"rig_records", rig_records_},
          {"analyses", analyses_},
          {"runs", size()},
          {"inputs", inputs}};
}

Result<SweepPlan> SweepPlan::from_manifest(const json& m, const std::string& where) {
  const auto wrong = [&](const std::string& what) { return fail(ErrorCode::bad_input, where, what); };
  SweepPlan plan;
  try {
    if (m.at("format") != kFormat || m.at("format_version") != kFormatVersion)
      return wrong("expected the manifest of a sweep, got something else");
    if (m.at("rigor_version") != RIGOR_VERSION)
      return wrong(
          fmt::format("expected a sweep of Rigor {}, which runs now, got one of {}; go on with that "
                      "version, or begin another folder",
                      RIGOR_VERSION, m.at("rigor_version").dump()));
    SweepOptions& o = plan.options_;
    o.rig = m.at("rig").get<std::string>();
    for (const json& text : m.at("set")) {
      auto one = ConfigOverride::parse(text.get<std::string>());
      if (!one) return wrong(one.error().text());
      o.overrides.push_back(std::move(*one));
    }
    for (const json& text : m.at("vary")) {
      auto one = SweepParameter::parse(text.get<std::string>());
      if (!one) return wrong(one.error().text());
      o.vary.push_back(std::move(*one));
    }
    o.seeds = m.at("seeds");
    o.samples = m.at("sample");
    o.draw_seed = m.at("sample_seed");
    o.duration_s = m.at("duration_s");
    for (const json& plugin : m.at("plugins")) o.plugins.emplace_back(plugin.get<std::string>());
    plan.first_seed_ = m.at("first_seed");
    plan.rig_records_ = m.at("rig_records");
    plan.analyses_ = m.at("analyses");
    for (const auto& [name, digest] : m.at("inputs").items()) {
      const fs::path file = (o.rig.parent_path() / name).lexically_normal();
      if (sha256_of(file) != digest.get<std::string>())
        return wrong(
            fmt::format("expected {} as it was when the sweep began, got another one or none; put "
                        "it back, or begin another folder",
                        file.string()));
      plan.inputs_.emplace_back(name, digest.get<std::string>());
    }
    if (auto s = plan.count_points(); !s) return wrong(s.error().text());
    if (plan.size() != m.at("runs")) return wrong("expected as many runs as its values make");
  } catch (const json::exception& e) {
    return wrong(fmt::format("expected the manifest of a sweep: {}", e.what()));
  }
  plan.draw_samples();
  return plan;
}

}  // namespace rigor
