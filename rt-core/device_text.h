// Names that come from devices or go into their descriptions: what stands in a fixed field of a datagram may
// be any bytes, and goes on to terminals, JSON and XML.
#pragma once

#include <string>
#include <string_view>

namespace rigor {

/// The text with a `?` for each byte that is no UTF-8 and for each control character (C0, DEL, C1) or
/// noncharacter that XML 1.0 refuses. Any thread; allocates.
[[nodiscard]] std::string device_text(std::string_view bytes);

}  // namespace rigor
