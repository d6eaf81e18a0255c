#include "sim/gis/vector.h"

#include <fmt/format.h>
#include <ogrsf_frmts.h>

#include <algorithm>
#include <cmath>

#include "sim/gis/csv.h"
#include "sim/gis/osm.h"

namespace rigor::gis {
namespace {

class VertexCollector : public OGRDefaultConstGeometryVisitor {
 public:
  using OGRDefaultConstGeometryVisitor::visit;
  void visit(const OGRPoint* p) override { places.push_back({p->getY(), p->getX(), 0}); }
  std::vector<GeoPoint> places;
};

std::string layer_names(GDALDataset& dataset) {
  std::string names;
  for (int i = 0; i < dataset.GetLayerCount(); ++i)
    names += (i ? ", " : "") + std::string(dataset.GetLayer(i)->GetName());
  return names;
}

Result<TransformationPtr> to_wgs84(OGRLayer& layer, const ImportSource& source, const std::string& where) {
  OGRSpatialReference crs;
  if (!source.crs.empty()) {
    auto given = parse_crs(source.crs, where + ": crs");
    if (!given) return tl::unexpected(given.error());
    crs = *given;
  } else if (const OGRSpatialReference* own = layer.GetSpatialRef(); own && !own->IsLocal()) {
    crs = *own;
  } else {
    return fail(ErrorCode::bad_input, where,
                "expected a reference system, the layer has none: give it as crs (such as EPSG:25832)");
  }
  return transformation(crs, wgs84(), where);
}

// Takes over geometry and fields; false where the feature is left out.
Result<bool> take(const OGRFeature& source, OGRCoordinateTransformation* to_geo,
                  const std::optional<Where>& where, bool osm, Feature& feature) {
  const OGRFeatureDefn& definition = *source.GetDefnRef();
  for (int i = 0; i < definition.GetFieldCount(); ++i) {
    if (!source.IsFieldSetAndNotNull(i)) continue;
    const std::string name = definition.GetFieldDefn(i)->GetNameRef();
    if (osm && name == "other_tags") {
      for (auto& tag : parse_hstore(source.GetFieldAsString(i))) feature.fields.push_back(std::move(tag));
    } else {
      const auto type = definition.GetFieldDefn(i)->GetType();
      feature.fields.emplace_back(name, type == OFTReal ? fmt::format("{}", source.GetFieldAsDouble(i))
                                                        : std::string(source.GetFieldAsString(i)));
    }
  }
  if (where) {
    const std::string* value = feature.field(where->column);
    if (!value || *value != where->value) return false;
  }
  const OGRGeometry* shape = source.GetGeometryRef();
  if (!shape || shape->IsEmpty()) return true;
  feature.geometry.reset(shape->hasCurveGeometry(TRUE) ? shape->getLinearGeometry() : shape->clone());
  feature.geometry->flattenTo2D();
  feature.geometry->assignSpatialReference(nullptr);
  GdalMessages messages;
  if (to_geo && feature.geometry->transform(to_geo) != OGRERR_NONE)
    return fail(ErrorCode::bad_input, feature.place,
                "expected coordinates that lie on the earth, got others: is the reference system right? " +
                    messages.text());
  VertexCollector vertices;
  feature.geometry->accept(&vertices);
  for (const GeoPoint& p : vertices.places)
    if (!std::isfinite(p.latitude_deg) || !std::isfinite(p.longitude_deg) ||
        (to_geo && std::abs(p.latitude_deg) > 90 + 1e-9))
      return fail(
          ErrorCode::bad_input, feature.place,
          fmt::format("expected coordinates that lie on the earth, got latitude {}, longitude {}: is the "
                      "reference system right?",
                      p.latitude_deg, p.longitude_deg));
  return true;
}

std::string feature_place(const std::string& where, const OGRFeature& f, bool osm) {
  if (osm)
    for (const char* id : {"osm_id", "osm_way_id"})
      if (const int i = f.GetFieldIndex(id); i >= 0 && f.IsFieldSetAndNotNull(i))
        return fmt::format("{}: {} {}", where, id, f.GetFieldAsString(i));
  return fmt::format("{}: feature {}", where, static_cast<long long>(f.GetFID()));
}

}  // namespace

const std::string* Feature::field(std::string_view name) const {
  for (const auto& [key, value] : fields)
    if (key == name) return &value;
  return nullptr;
}

std::optional<OGREnvelope> rectangle_of(const Domain& domain, const OGRSpatialReference& crs) {
  auto t = transformation(wgs84(), crs, "domain");
  if (!t) return std::nullopt;
  const GdalMessages messages;
  OGREnvelope box;
  constexpr int kSteps = 16;
  const double reach = domain.half_extent_m * 1.01 + 10;
  for (const double height : {-500.0, 9000.0})
    for (int i = -kSteps; i <= kSteps; ++i)
      for (int j = -kSteps; j <= kSteps; ++j) {
        const double x_m = reach * i / kSteps, y_m = reach * j / kSteps;
        const GeoPoint p = domain.frame->to_geo({x_m, y_m, domain.frame->z_at_height(x_m, y_m, height)});
        double x = p.longitude_deg, y = p.latitude_deg;
        if (!(*t)->Transform(1, &x, &y) || !std::isfinite(x) || !std::isfinite(y)) return std::nullopt;
        box.Merge(x, y);
      }
  if (crs.IsGeographic() && (box.MaxX - box.MinX) * crs.GetAngularUnits() > M_PI) return std::nullopt;
  const LocalFrame& f = *domain.frame;
  const double pole_m =
      std::min(f.to_world({90, 0, 0}).head<2>().norm(), f.to_world({-90, 0, 0}).head<2>().norm());
  if (crs.IsGeographic() && pole_m < 2 * reach) return std::nullopt;
  const double dx = (box.MaxX - box.MinX) / kSteps, dy = (box.MaxY - box.MinY) / kSteps;
  box.MinX -= dx, box.MaxX += dx, box.MinY -= dy, box.MaxY += dy;
  return box;
}

Result<VectorData> read_vector(const std::string& file, const ImportSource& source,
                               const std::optional<Domain>& domain) {
  auto dataset = open_dataset(file, GDAL_OF_VECTOR);
  if (!dataset) return tl::unexpected(dataset.error());
  return read_vector(**dataset, file, source, domain);
}

Result<VectorData> read_vector(GDALDataset& dataset, const std::string& name, const ImportSource& source,
                               const std::optional<Domain>& domain) {
  VectorData data;
  data.where = name;
  data.osm = dataset.GetDriver() && std::string_view(dataset.GetDriver()->GetDescription()) == "OSM";
  data.local = source.crs == "local";
  const auto where = parse_where(source.where);
  if (!where) return tl::unexpected(Error{where.error().code, name + ": where", where.error().message});
  GdalMessages messages;
  const auto broken = [&](const std::string& place) {
    return fail(ErrorCode::bad_input, place,
                "expected features, the file is cut short or broken: " + messages.text());
  };

  if (data.osm) {
    // All layers at once: OSM files interleave them.
    const OGRSpatialReference crs = wgs84();
    dataset.ResetReading();
    OGRLayer* layer = nullptr;
    while (OGRFeature* raw = dataset.GetNextFeature(&layer, nullptr, nullptr, nullptr)) {
      const OGRFeatureUniquePtr f(raw);
      const std::string_view layer_name = layer->GetName();
      if (!source.layer.empty() && source.layer != layer_name) continue;
      if (layer_name != "points" && layer_name != "lines" && layer_name != "multipolygons") continue;
      Feature feature;
      feature.place = feature_place(name, *f, true);
      const auto kept = take(*f, nullptr, *where, true, feature);
      if (!kept) return tl::unexpected(kept.error());
      if (*kept && feature.geometry) data.features.push_back(std::move(feature));
    }
    if (messages.failed()) return broken(name);
    return data;
  }

  OGRLayer* layer = nullptr;
  if (!source.layer.empty()) {
    layer = dataset.GetLayerByName(source.layer.c_str());
    if (!layer)
      return fail(ErrorCode::bad_input, name,
                  fmt::format("expected one of the layers {}, got '{}'", layer_names(dataset), source.layer));
  } else if (dataset.GetLayerCount() == 1) {
    layer = dataset.GetLayer(0);
  } else {
    return fail(
        ErrorCode::bad_input, name,
        dataset.GetLayerCount() == 0
            ? std::string("expected a vector layer, got a file without any")
            : fmt::format("expected the name of a layer, the file has several: {}", layer_names(dataset)));
  }
  data.where = fmt::format("{}: layer {}", name, layer->GetName());
  TransformationPtr to_geo;
  if (!data.local) {
    auto t = to_wgs84(*layer, source, data.where);
    if (!t) return tl::unexpected(t.error());
    to_geo = std::move(*t);
    if (domain && domain->half_extent_m > 0) {
      OGRSpatialReference crs;
      if (source.crs.empty())
        crs = *layer->GetSpatialRef();
      else if (auto given = parse_crs(source.crs, data.where))
        crs = *given;
      if (const auto box = rectangle_of(*domain, crs))
        layer->SetSpatialFilterRect(box->MinX, box->MinY, box->MaxX, box->MaxY);
    }
  }
  const OGRFeatureDefn& definition = *layer->GetLayerDefn();
  for (int i = 0; i < definition.GetFieldCount(); ++i)
    data.columns.emplace_back(definition.GetFieldDefn(i)->GetNameRef());
  if (*where && std::find(data.columns.begin(), data.columns.end(), (*where)->column) == data.columns.end())
    return fail(ErrorCode::bad_input, data.where,
                fmt::format("where: there is no column '{}'", (*where)->column));
  layer->ResetReading();
  std::size_t without = 0;
  std::vector<std::pair<GIntBig, std::size_t>> order;  // feature id, place in the list
  while (OGRFeature* raw = layer->GetNextFeature()) {
    const OGRFeatureUniquePtr f(raw);
    Feature feature;
    feature.place = feature_place(data.where, *f, false);
    const auto kept = take(*f, to_geo.get(), *where, false, feature);
    if (!kept) return tl::unexpected(kept.error());
    if (!*kept) continue;
    if (!feature.geometry) {
      ++without;
      continue;
    }
    data.features.push_back(std::move(feature));
    order.emplace_back(f->GetFID(), order.size());
  }
  // A file's spatial index hands features out in an order of its own.
  std::sort(order.begin(), order.end());
  std::vector<Feature> in_order;
  in_order.reserve(order.size());
  for (const auto& entry : order) in_order.push_back(std::move(data.features[entry.second]));
  data.features = std::move(in_order);
  if (messages.failed()) return broken(data.where);
  if (without > 0)
    data.warnings.push_back(fmt::format("{}: {} features without a geometry left out", data.where, without));
  if (data.features.empty() && without == 0)
    data.warnings.push_back(fmt::format("{}: no features{}", data.where,
                                        source.where.empty() && !domain ? "" : " that are wanted"));
  return data;
}

std::vector<GeoPoint> places_of(const VectorData& data) {
  VertexCollector vertices;
  for (const Feature& f : data.features) f.geometry->accept(&vertices);
  return std::move(vertices.places);
}

}  // namespace rigor::gis
