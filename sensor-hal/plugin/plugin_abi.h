// What a plugin and the program that loads it must have in common: the layout of all that they hand each
// other. A shared object says what it was built against in a constant, which is read from its file before any
// code of it runs (plugin_file.h).
#pragma once

#include "rt-core/result.h"
#include "rt-core/sanitizers.h"

#define RIGOR_PLUGIN_TEXT_(x) #x
#define RIGOR_PLUGIN_TEXT(x) RIGOR_PLUGIN_TEXT_(x)
#if defined(RIGOR_ADDRESS_SANITIZER)
#define RIGOR_PLUGIN_SANITIZER "address"
#elif defined(RIGOR_THREAD_SANITIZER)
#define RIGOR_PLUGIN_SANITIZER "thread"
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define RIGOR_PLUGIN_SANITIZER "address"
#elif __has_feature(thread_sanitizer)
#define RIGOR_PLUGIN_SANITIZER "thread"
#endif
#endif
#ifndef RIGOR_PLUGIN_SANITIZER
#define RIGOR_PLUGIN_SANITIZER "none"
#endif
#ifdef _GLIBCXX_DEBUG
#define RIGOR_PLUGIN_CONTAINERS "debug"
#else
#define RIGOR_PLUGIN_CONTAINERS "plain"
#endif
#ifdef __cpp_rtti
#define RIGOR_PLUGIN_RTTI "on"
#else
#define RIGOR_PLUGIN_RTTI "off"
#endif
#ifdef __cpp_exceptions
#define RIGOR_PLUGIN_EXCEPTIONS "on"
#else
#define RIGOR_PLUGIN_EXCEPTIONS "off"
#endif

/// Item by item. `headers_digest`: of the public headers that the plugin sees.
// clang-format off
#define RIGOR_PLUGIN_ABI(headers_digest)                                                                      \
  "headers " headers_digest "; compiler " __VERSION__ "; C++ " RIGOR_PLUGIN_TEXT(__cplusplus)                \
  "; C++ ABI " RIGOR_PLUGIN_TEXT(__GXX_ABI_VERSION) "; libstdc++ " RIGOR_PLUGIN_TEXT(_GLIBCXX_RELEASE)       \
  ", strings " RIGOR_PLUGIN_TEXT(_GLIBCXX_USE_CXX11_ABI) ", containers " RIGOR_PLUGIN_CONTAINERS             \
  "; expected " RIGOR_PLUGIN_TEXT(TL_EXPECTED_VERSION_MAJOR) "." RIGOR_PLUGIN_TEXT(TL_EXPECTED_VERSION_MINOR) \
  "; RTTI " RIGOR_PLUGIN_RTTI "; exceptions " RIGOR_PLUGIN_EXCEPTIONS "; sanitizer " RIGOR_PLUGIN_SANITIZER
// clang-format on

namespace rigor {

/// The constant by which a shared object says what it is. The two texts are of fixed length and come first,
/// for ever, so that they can be read from a file of any version.
template <class Host>
struct PluginEntry {
  char magic[32];
  char abi[480];
  const char* name;
  const char* version;
  const char* meaning;
  Status (*define)(Host&);
};

}  // namespace rigor
