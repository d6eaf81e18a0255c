#include "calibration/core/fit_output.h"

#include <yaml-cpp/yaml.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <sstream>

namespace rigor::calibration {
namespace {

using nlohmann::json;

json number_or_null(double v) { return std::isfinite(v) ? json(v) : json(nullptr); }

std::vector<std::string> split(const std::string& path) {
  std::vector<std::string> parts;
  std::stringstream in(path);
  for (std::string p; std::getline(in, p, '.');) parts.push_back(p);
  return parts;
}

/// `node` is a handle: assignment writes into the tree.
Status set(YAML::Node node, const std::string& path, const YAML::Node& value) {
  const auto parts = split(path);
  for (std::size_t i = 0; i < parts.size(); ++i) {
    if (node.IsDefined() && !node.IsNull() && !node.IsMap())
      return fail(ErrorCode::bad_input, path,
                  "expected a map on the way in the base sensor model, got a value");
    if (i + 1 == parts.size()) {
      node[parts[i]] = value;
      return {};
    }
    YAML::Node child = node[parts[i]];
    if (!child.IsDefined() || child.IsNull()) {
      node[parts[i]] = YAML::Node(YAML::NodeType::Map);
      child.reset(node[parts[i]]);
    }
    node.reset(child);
  }
  return {};
}

void remove(YAML::Node node, const std::string& path) {
  const auto parts = split(path);
  for (std::size_t i = 0; i < parts.size(); ++i) {
    if (!node.IsMap()) return;
    if (i + 1 == parts.size()) {
      node.remove(parts[i]);
      return;
    }
    const YAML::Node child = node[parts[i]];
    if (!child.IsDefined()) return;
    node.reset(child);
  }
}

YAML::Node number(double v) { return YAML::Node(exact_text(v)); }

YAML::Node section_of(const SensorModelRecipe& recipe, const FitResult& fit,
                      const std::vector<RecordingHash>& recordings) {
  YAML::Node s;
  s["version"] = 1;
  s["kind"] = recipe.kind;
  s["model"] = fit.model;
  std::vector<Eigen::Index> known;
  YAML::Node parameters(YAML::NodeType::Sequence), unknown(YAML::NodeType::Map);
  for (std::size_t i = 0; i < fit.parameters.size(); ++i) {
    const Parameter& p = fit.parameters[i];
    if (!std::isfinite(p.sigma) || !std::isfinite(p.value)) {
      unknown[p.name] = "the data leave it free";
      continue;
    }
    known.push_back(static_cast<Eigen::Index>(i));
    YAML::Node n;
    n.SetStyle(YAML::EmitterStyle::Flow);
    n["name"] = p.name;
    n["value"] = number(p.value);
    n["sigma"] = number(p.sigma);
    for (const auto& place : recipe.places)
      if (place.parameter == p.name) {
        n["path"] = place.path;
        n["scale"] = number(place.scale);
      }
    parameters.push_back(n);
  }
  s["parameters"] = parameters;
  YAML::Node covariance(YAML::NodeType::Sequence);
  covariance.SetStyle(YAML::EmitterStyle::Flow);
  for (std::size_t i = 0; i < known.size(); ++i)
    for (std::size_t j = 0; j <= i; ++j) covariance.push_back(number(fit.covariance(known[i], known[j])));
  s["covariance"] = covariance;
  YAML::Node r;
  r.SetStyle(YAML::EmitterStyle::Flow);
  r["unit"] = fit.residuals.unit;
  r["count"] = fit.residuals.count;
  r["rejected"] = fit.residuals.rejected;
  r["rms"] = number(fit.residuals.rms);
  r["median_absolute"] = number(fit.residuals.median_absolute);
  r["p95_absolute"] = number(fit.residuals.p95_absolute);
  r["largest"] = number(fit.residuals.largest);
  s["residuals"] = r;
  if (!fit.validity.empty()) {
    YAML::Node v;
    for (const auto& span : fit.validity) {
      YAML::Node range(YAML::NodeType::Sequence);
      range.SetStyle(YAML::EmitterStyle::Flow);
      range.push_back(number(span.from));
      range.push_back(number(span.to));
      v[span.name] = range;
    }
    s["validity"] = v;
  }
  if (!recordings.empty()) {
    YAML::Node list(YAML::NodeType::Sequence);
    for (const RecordingHash& h : recordings) {
      YAML::Node n;
      n.SetStyle(YAML::EmitterStyle::Flow);
      n["file"] = h.file;
      n["sha256"] = h.sha256;
      list.push_back(n);
    }
    s["recordings"] = list;
  }
  for (const auto& [name, why] : fit.not_identifiable) unknown[name] = why;
  if (unknown.size() > 0) s["not_identifiable"] = unknown;
  if (!fit.warnings.empty()) s["warnings"] = fit.warnings;
  s["interrupted"] = fit.interrupted;
  return s;
}

}  // namespace

std::string exact_text(double value) {
  char text[40];
  for (const int digits : {15, 16, 17}) {
    std::snprintf(text, sizeof text, "%.*g", digits, value);
    if (std::strtod(text, nullptr) == value) break;
  }
  return text;
}

json to_json(const FitResult& fit) {
  json parameters = json::object();
  for (const Parameter& p : fit.parameters) {
    json& j = parameters[p.name];
    j = {{"value", number_or_null(p.value)}, {"sigma", number_or_null(p.sigma)}};
    if (p.held) j["held"] = true;
    if (p.at_bound) j["at_bound"] = true;
    if (std::isfinite(p.halves_apart)) j["halves_apart"] = p.halves_apart;
  }
  json covariance = json::array();
  for (Eigen::Index i = 0; i < fit.covariance.rows(); ++i) {
    json row = json::array();
    for (Eigen::Index k = 0; k < fit.covariance.cols(); ++k)
      row.push_back(number_or_null(fit.covariance(i, k)));
    covariance.push_back(row);
  }
  json rejected = json::array(), models = json::array(), weak = json::array();
  for (const Rejected& r : fit.rejected)
    rejected.push_back(
        {{"what", r.what}, {"residual", number_or_null(r.residual)}, {"sigmas", number_or_null(r.sigmas)}});
  for (const Candidate& c : fit.candidates)
    models.push_back({{"name", c.name},
                      {"parameters", c.parameters},
                      {"rms", number_or_null(c.rms)},
                      {"bic", number_or_null(c.bic)},
                      {"cross_validation", number_or_null(c.cross_validation)},
                      {"cross_validation_sigma", number_or_null(c.cross_validation_sigma)},
                      {"chosen", c.chosen},
                      {"note", c.note}});
  for (const WeakDirection& w : fit.weak) {
    json parts = json::array();
    for (const auto& p : w.parts) parts.push_back({{"name", p.name}, {"weight", p.weight}});
    weak.push_back(
        {{"parameters", parts}, {"sigma", number_or_null(w.sigma)}, {"words", w.words}, {"cure", w.cure}});
  }
  json out = {{"model", fit.model},
              {"parameters", parameters},
              {"covariance", covariance},
              {"residuals",
               {{"unit", fit.residuals.unit},
                {"count", fit.residuals.count},
                {"rejected", fit.residuals.rejected},
                {"rms", fit.residuals.rms},
                {"median_absolute", fit.residuals.median_absolute},
                {"p95_absolute", fit.residuals.p95_absolute},
                {"largest", fit.residuals.largest}}},
              {"rejected", rejected},
              {"models", models},
              {"weak_directions", weak},
              {"warnings", fit.warnings},
              {"interrupted", fit.interrupted}};
  out["not_identifiable"] = json::object();
  for (const auto& [name, why] : fit.not_identifiable) out["not_identifiable"][name] = why;
  out["validity"] = json::object();
  for (const auto& span : fit.validity) out["validity"][span.name] = {span.from, span.to};
  return out;
}

Result<std::string> sensor_model_yaml(const SensorModelRecipe& recipe, const FitResult& fit,
                                      const std::vector<RecordingHash>& recordings) {
  try {
    YAML::Node root = recipe.base.empty() ? YAML::Node(YAML::NodeType::Map) : YAML::Load(recipe.base);
    if (!root.IsMap())
      return fail(ErrorCode::bad_input, "--base", "expected a sensor model of keys and values");
    for (const std::string& path : recipe.remove) remove(root, path);
    for (const auto& [path, value] : recipe.set)
      if (auto s = set(root, path, YAML::Load(value)); !s) return tl::unexpected<Error>(s.error());
    root["calibration"] = section_of(recipe, fit, recordings);
    YAML::Emitter out;
    out << root;
    return std::string(out.c_str()) + "\n";
  } catch (const YAML::Exception& e) {
    return fail(ErrorCode::bad_input, "--base",
                std::string("expected a sensor model in YAML, got: ") + e.what());
  }
}

}  // namespace rigor::calibration
