#include "drivers/sick/telegram.h"

#include <array>

#include "drivers/sick/wire.h"
#include "rt-core/byte_order.h"

namespace rigor::sick {

std::string_view sopas_error_name(std::uint16_t error) {
  static constexpr std::array<std::string_view, 21> kNames = {"OK",
                                                              "METHODIN_ACCESSDENIED",
                                                              "METHODIN_UNKNOWNINDEX",
                                                              "VARIABLE_UNKNOWNINDEX",
                                                              "LOCALCONDITIONFAILED",
                                                              "INVALID_DATA",
                                                              "UNKNOWN_ERROR",
                                                              "BUFFER_OVERFLOW",
                                                              "BUFFER_UNDERFLOW",
                                                              "ERROR_UNKNOWN_TYPE",
                                                              "VARIABLE_WRITE_ACCESSDENIED",
                                                              "UNKNOWN_CMD_FOR_NAMESERVER",
                                                              "UNKNOWN_COLA_COMMAND",
                                                              "METHODIN_SERVER_BUSY",
                                                              "FLEX_OUT_OF_BOUNDS",
                                                              "EVENTREG_UNKNOWNINDEX",
                                                              "COLA_A_VALUE_OVERFLOW",
                                                              "COLA_A_INVALID_CHARACTER",
                                                              "OSAI_NO_MESSAGE",
                                                              "OSAI_NO_ANSWER_MESSAGE",
                                                              "INTERNAL"};
  return error < kNames.size() ? kNames[error] : std::string_view{};
}

std::uint16_t Telegram::error_code() const {
  WireReader r(values);
  const auto code = r.u16();
  return r.good() ? code : 6;
}

std::optional<Telegram> parse_telegram(Bytes body) {
  if (body.size() < 3) return std::nullopt;
  const std::string_view text(reinterpret_cast<const char*>(body.data()), body.size());
  Telegram t;
  t.type = text.substr(0, 3);
  if (t.type[0] != 's') return std::nullopt;
  if (t.type == "sFA") {
    t.values = body.subspan(3);
    if (!t.values.empty() && t.values[0] == ' ' && t.values.size() > 2) t.values = t.values.subspan(1);
    return t;
  }
  if (body.size() < 5 || text[3] != ' ') return std::nullopt;
  // Names are of letters, digits and underscores.
  std::size_t end = 4;
  while (end < text.size() && text[end] != ' ') {
    const char c = text[end];
    if (!((c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_'))
      return std::nullopt;
    ++end;
  }
  if (end == 4) return std::nullopt;
  t.name = text.substr(4, end - 4);
  if (end < body.size()) t.values = body.subspan(end + 1);
  return t;
}

void append_telegram(Buffer& out, std::string_view type, std::string_view name, Bytes values) {
  const auto begin = begin_frame(out);
  append_text(out, type);
  append_text(out, " ");
  append_text(out, name);
  // Answers end with a space where they have no values, requests do not: so the recordings have it.
  const bool request = type == "sRN" || type == "sMN" || type == "sWN" || type == "sEN";
  if (!values.empty() || !request) append_text(out, " ");
  out.insert(out.end(), values.begin(), values.end());
  end_frame(out, begin);
}

void append_error(Buffer& out, SopasError error) {
  const auto begin = begin_frame(out);
  append_text(out, "sFA");
  append_be(out, static_cast<std::uint16_t>(error));
  end_frame(out, begin);
}

void append_string(Buffer& out, std::string_view text) {
  append_be(out, static_cast<std::uint16_t>(text.size()));
  append_text(out, text);
}

}  // namespace rigor::sick
