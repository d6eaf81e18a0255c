#include "bridges/ros2/type_hash.h"

#include <fmt/format.h>
#include <openssl/evp.h>

#include <array>

namespace rigor::ros2 {
namespace {

/// type_description_interfaces/msg/FieldType.msg: 1 is another message; arrays and sequences of a type have
/// its number and an offset.
int type_id(const Field& field) {
  const int one = field.nested.empty() ? static_cast<int>(field.primitive) : 1;
  switch (field.many) {
    case Field::Many::one:
      return one;
    case Field::Many::array:
      return one + 48;
    case Field::Many::bounded_sequence:
      return one + 96;
    case Field::Many::sequence:
      return one + 144;
  }
  return one;
}

std::string description(const std::string& type, const std::vector<Field>& fields) {
  std::string json = fmt::format(R"({{"type_name": "{}", "fields": [)", type);
  const char* separator = "";
  for (const Field& f : fields) {
    json += fmt::format(
        R"({}{{"name": "{}", "type": {{"type_id": {}, "capacity": {}, "string_capacity": 0, "nested_type_name": "{}"}}}})",
        separator, f.name, type_id(f), f.capacity, f.nested);
    separator = ", ";
  }
  return json + "]}";
}

}  // namespace

Result<std::string> type_hash(const Definition& definition) {
  std::string json = R"({"type_description": )" + description(definition.type, definition.fields()) +
                     R"(, "referenced_type_descriptions": [)";
  const char* separator = "";
  for (const auto& [name, fields] : definition.types) {  // by name, as the hash wants them
    if (name == definition.type) continue;
    json += separator + description(name, fields);
    separator = ", ";
  }
  json += "]}";
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned size = 0;
  if (EVP_Digest(json.data(), json.size(), digest.data(), &size, EVP_sha256(), nullptr) != 1)
    return fail(ErrorCode::unavailable, definition.type, "OpenSSL computes no SHA-256");
  std::string hash = "RIHS01_";
  for (unsigned i = 0; i < size; ++i) hash += fmt::format("{:02x}", digest[i]);
  return hash;
}

}  // namespace rigor::ros2
