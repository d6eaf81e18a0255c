#include "drivers/aravis/gige_genicam_xml.h"

#include <algorithm>
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <locale>
#include <sstream>
#include <vector>

#include "rt-core/device_text.h"

namespace rigor::gige {
namespace {

std::string hex(std::uint32_t v) {
  char text[16];
  std::snprintf(text, sizeof text, "0x%" PRIX32, v);
  return text;
}

std::string number(double v) {
  std::ostringstream s;
  s.imbue(std::locale::classic());
  s.precision(17);
  s << v;
  return s.str();
}

std::string escaped(const std::string& s) {
  std::string out;
  for (const char c : device_text(s)) {
    if (c == '&')
      out += "&amp;";
    else if (c == '<')
      out += "&lt;";
    else if (c == '>')
      out += "&gt;";
    else if (c == '"')
      out += "&quot;";
    else
      out += c;
  }
  return out;
}

/// The name that XML attributes may have: letters, digits and underscores.
std::string identifier(const std::string& s) {
  std::string out;
  for (const char c : s) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
    out += plain ? c : '_';
  }
  return out.empty() ? "Camera" : out;
}

/// `name` of a feature: that of the register (or of its bits) behind it.
std::string node_of(const Feature& f) { return std::string(f.name) + "Reg"; }

class Writer {
 public:
  std::string text;

  void open(const char* element, const std::string& name, bool standard = true) {
    text += std::string("  <") + element + " Name=\"" + name +
            (standard ? "\" NameSpace=\"Standard\">\n" : "\">\n");
  }
  void close(const char* element) { text += std::string("  </") + element + ">\n"; }
  void leaf(const char* element, const std::string& value) {
    text += std::string("    <") + element + ">" + value + "</" + element + ">\n";
  }
  void entry(const std::string& name, std::uint32_t value) {
    text += "    <EnumEntry Name=\"" + name + "\" NameSpace=\"Standard\">\n      <Value>" +
            std::to_string(value) + "</Value>\n    </EnumEntry>\n";
  }
  void category(const std::string& name, const std::vector<const char*>& features) {
    open("Category", name);
    for (const char* f : features) leaf("pFeature", f);
    close("Category");
  }
  void about(const char* tooltip, const char* display, const char* visibility) {
    leaf("ToolTip", tooltip);
    leaf("DisplayName", display);
    leaf("Visibility", visibility);
  }
  void bounds(const Bounds& b) {
    leaf("Min", number(b.min));
    leaf("Max", number(b.max));
    if (b.step > 1) leaf("Inc", std::to_string(b.step));
  }
  void feature(const Register& r, const Feature& f);
  void register_of(const Register& r, const Feature& f);
  void room(const Register& r, const RegisterTable& registers);
  void chunk(const Chunk& c, const std::vector<Choice>& choices);

 private:
  void fixed_value(const Feature& f);
};

const char* element_of(Feature::Kind kind) {
  switch (kind) {
    case Feature::Kind::integer:
      return "Integer";
    case Feature::Kind::real:
      return "Float";
    case Feature::Kind::flag:
      return "Boolean";
    case Feature::Kind::choice:
      return "Enumeration";
    case Feature::Kind::command:
      return "Command";
    case Feature::Kind::text:
      return "StringReg";
  }
  return "Integer";
}

const char* text_of(Access a) {
  return a == Access::read_only ? "RO" : a == Access::write_only ? "WO" : "RW";
}

void Writer::fixed_value(const Feature& f) {
  const bool choice = f.kind == Feature::Kind::choice;
  if (choice) entry(f.fixed, 0);
  leaf("Value", choice ? "0" : f.fixed);
  if (f.kind == Feature::Kind::integer) leaf("Min", f.fixed), leaf("Max", f.fixed), leaf("Inc", "1");
}

void Writer::feature(const Register& r, const Feature& f) {
  using K = Feature::Kind;
  open(element_of(f.kind), f.name);
  about(f.tooltip, f.name, f.visibility);
  if (f.kind == K::text) {  // the register itself
    leaf("Address", hex(r.address));
    leaf("Length", std::to_string(r.size));
    leaf("AccessMode", text_of(f.access));
    leaf("pPort", "Device");
    return close("StringReg");
  }
  if (r.locked && f.access != Access::read_only) leaf("pIsLocked", "TLParamsLocked");
  for (const Choice& c : f.choices) entry(c.name, c.value);
  if (r.size == 0)
    fixed_value(f);
  else
    leaf("pValue", node_of(f));
  if (f.kind == K::command) leaf("CommandValue", std::to_string(f.command_value));
  if (f.kind == K::flag) leaf("OnValue", "1"), leaf("OffValue", "0");
  const bool limited = f.kind == K::integer || f.kind == K::real;
  if (limited && r.whole != 0) {
    leaf("Min", number(r.bounds->min));
    leaf("pMax", std::string(f.name) + "Room");
    leaf("Inc", std::to_string(r.bounds->step));
  } else if (limited && f.bounds) {
    bounds(*f.bounds);
  } else if (limited && r.bounds && f.lsb < 0) {
    bounds(*r.bounds);
  } else if (f.kind == K::integer && r.size == 8 && !r.is_signed) {
    leaf("Min", "0");  // a client's integers are signed
    leaf("Max", "9223372036854775807");
  }
  if (*f.unit != '\0') leaf("Unit", f.unit);
  for (const char* name : f.selects) leaf("pSelected", name);
  close(element_of(f.kind));
  if (r.size != 0) register_of(r, f);
}

void Writer::register_of(const Register& r, const Feature& f) {
  const char* element = r.is_real() ? "FloatReg" : f.lsb >= 0 ? "MaskedIntReg" : "IntReg";
  open(element, node_of(f), false);
  leaf("Address", hex(r.address));
  leaf("Length", std::to_string(r.size));
  leaf("AccessMode", text_of(f.access));
  leaf("pPort", "Device");
  leaf("Cachable", "NoCache");
  if (f.lsb >= 0 && f.lsb == f.msb) leaf("Bit", std::to_string(f.lsb));
  if (f.lsb >= 0 && f.lsb != f.msb) leaf("LSB", std::to_string(f.lsb)), leaf("MSB", std::to_string(f.msb));
  if (!r.is_real()) leaf("Sign", r.is_signed ? "Signed" : "Unsigned");
  leaf("Endianess", "BigEndian");
  close(element);
}

/// MAX = whole − used, rounded down to the step: the room that the other edge of the region leaves.
void Writer::room(const Register& r, const RegisterTable& registers) {
  open("IntSwissKnife", std::string(r.features[0].name) + "Room", false);
  const auto variable = [&](const char* name, reg::Address address) {
    text += std::string("    <pVariable Name=\"") + name + "\">" +
            node_of(registers.find(address)->features[0]) + "</pVariable>\n";
  };
  variable("WHOLE", r.whole);
  variable("USED", r.used);
  const auto step = std::to_string(r.bounds->step);
  leaf("Formula", "((WHOLE - USED) / " + step + ") * " + step);
  close("IntSwissKnife");
}

/// What clients read from the end of a frame.
void Writer::chunk(const Chunk& c, const std::vector<Choice>& choices) {
  const std::string name = std::string("Chunk") + c.name;
  const bool real = c.kind == Feature::Kind::real;
  open(element_of(c.kind), name);
  about(c.tooltip, name.c_str(), "Expert");
  if (c.kind == Feature::Kind::choice)
    for (const Choice& choice : choices) entry(choice.name, choice.value);
  leaf("pValue", name + "Value");
  close(element_of(c.kind));
  open(real ? "FloatReg" : "IntReg", name + "Value", false);
  leaf("Address", "0x0");
  leaf("Length", std::to_string(reg::kChunkValue));
  leaf("AccessMode", "RO");
  leaf("pPort", name + "Port");
  leaf("Cachable", "NoCache");
  if (!real) leaf("Sign", "Unsigned");
  leaf("Endianess", "BigEndian");
  close(real ? "FloatReg" : "IntReg");
  open("Port", name + "Port");
  char hexadecimal[16];
  std::snprintf(hexadecimal, sizeof hexadecimal, "%08X", c.id);
  leaf("ChunkID", hexadecimal);
  close("Port");
}

}  // namespace

std::string make_genicam_xml(const GigeCameraConfig& config, const RegisterTable& registers) {
  Writer w;
  w.text =
      "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n"
      "<RegisterDescription ModelName=\"" +
      identifier(config.model) + "\" VendorName=\"" + identifier(config.vendor) + "\" ToolTip=\"" +
      escaped(config.model) +
      "\" StandardNameSpace=\"GEV\" SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" "
      "SchemaSubMinorVersion=\"0\" "
      "MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" "
      "ProductGuid=\"5D7A5C1E-8A7B-4B0F-9C1D-6E3F2A8B4C71\" "
      "VersionGuid=\"E2C94B36-17D5-4F7A-8E90-3B5D1C6A7F28\" "
      "xmlns=\"http://www.genicam.org/GenApi/Version_1_1\" "
      "xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" "
      "xsi:schemaLocation=\"http://www.genicam.org/GenApi/Version_1_1 "
      "http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd\">\n";
  std::vector<const char*> root;
  std::vector<std::vector<const char*>> features;
  const auto place = [&](const char* category, const char* name) {
    if (*category == '\0') return;
    auto at = static_cast<std::size_t>(
        std::find_if(root.begin(), root.end(), [&](const char* c) { return std::strcmp(c, category) == 0; }) -
        root.begin());
    if (at == root.size()) root.push_back(category), features.emplace_back();
    features[at].push_back(name);
  };
  std::vector<std::string> chunk_names;
  for (const Chunk& c : chunk_table()) chunk_names.push_back(std::string("Chunk") + c.name);
  for (const Register& r : registers.rows())
    for (const Feature& f : r.features) place(f.category, f.name);
  for (const Chunk& c : chunk_table())
    if (c.value != nullptr) place("ChunkDataControl", chunk_names[c.id - 1].c_str());
  w.category("Root", root);
  for (std::size_t i = 0; i < root.size(); ++i) w.category(root[i], features[i]);
  for (const Register& r : registers.rows()) {
    for (const Feature& f : r.features) w.feature(r, f);
    if (r.whole != 0) w.room(r, registers);
  }
  for (const Chunk& c : chunk_table())
    if (c.value != nullptr) w.chunk(c, registers.find(reg::kPixelFormat)->features[0].choices);
  w.text += "  <Port Name=\"Device\" NameSpace=\"Standard\">\n  </Port>\n</RegisterDescription>\n";
  while (w.text.size() % 4 != 0) w.text += '\n';
  return w.text;
}

}  // namespace rigor::gige
