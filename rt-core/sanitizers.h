// Which sanitizer this is compiled with, alike for GCC and clang: RIGOR_ADDRESS_SANITIZER,
// RIGOR_THREAD_SANITIZER.
#pragma once

#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define RIGOR_ADDRESS_SANITIZER 1
#endif
#if __has_feature(thread_sanitizer)
#define RIGOR_THREAD_SANITIZER 1
#endif
#endif
#if defined(__SANITIZE_ADDRESS__)
#define RIGOR_ADDRESS_SANITIZER 1
#endif
#if defined(__SANITIZE_THREAD__)
#define RIGOR_THREAD_SANITIZER 1
#endif
