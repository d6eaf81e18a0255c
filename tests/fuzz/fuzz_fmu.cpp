// An FMU as it comes from anybody. The first byte says which: the zip file, modelDescription.xml,
// terminalsAndIcons.xml.
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "sim/fmu/fmu_archive.h"
#include "sim/fmu/units.h"
#include "sim/fmu/unpacked_fmu.h"

using namespace rigor;
using namespace rigor::fmu;

namespace {

void check(bool holds) {
  if (!holds) std::abort();
}
void check_error(const Error& e) { check(e.code == ErrorCode::bad_input && !e.message.empty()); }

void check_description(ModelDescription& d) {
  std::size_t total = 0;
  for (std::size_t i = 0; i < d.variables.size(); ++i) {
    const Variable& v = d.variables[i];
    std::size_t elements = 1;
    for (const std::size_t n : v.dimensions) elements *= n;
    check(elements == v.elements && elements <= kMaxElements);
    total += elements;
    check(d.find(v.name).has_value());
    if (v.dimensions.size() == 1 && v.elements > 0) {
      const auto last = d.find(v.name + "[" + std::to_string(v.elements) + "]");
      check(last && last->element < d.variables[last->variable].elements);
    }
    std::string why;
    (void)conversion(d, v.unit, "m", why);
    if (i > 200) break;
  }
  check(total <= kMaxTotalElements);
  for (const Variable& v : std::vector(
           d.variables.begin(), d.variables.begin() + std::min<std::ptrdiff_t>(20, std::ssize(d.variables))))
    if (auto s = apply_start_values(d, {{v.name, "3"}}, "fuzz"); !s) check_error(s.error());
}

void read_archive(std::span<const std::byte> bytes) {
  const auto archive = FmuArchive::from_memory(bytes, "fuzz", {.entries = 1000, .total_bytes = 1 << 20});
  if (!archive) return check_error(archive.error());
  for (const std::string& name : archive->names()) {
    check(refused_name(name).empty());
    if (const auto text = archive->read(name, 1 << 20))
      check(text->size() <= 1 << 20);
    else
      check_error(text.error());
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string_view text(reinterpret_cast<const char*>(data) + 1, size - 1);
  if (data[0] % 3 == 0) {
    read_archive(std::as_bytes(std::span(data + 1, size - 1)));
  } else if (data[0] % 3 == 1) {
    if (auto d = parse_model_description(text, "fuzz"))
      check_description(*d);
    else
      check_error(d.error());
  } else {
    ModelDescription d;
    if (auto s = parse_terminals(text, "fuzz", d); !s) check_error(s.error());
    for (const Terminal& t : d.terminals)
      for (const Terminal::Member& m : t.members) (void)d.find(t.name + "." + m.name);
  }
  return 0;
}
