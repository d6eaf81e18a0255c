// For functions whose loops over pixels the compiler turns into vector instructions: one clone for AVX2 and
// one for the base architecture, chosen when the program starts. Both round alike, because the build turns
// contraction of a multiplication and an addition off and such loops use +, -, *, / and sqrt alone.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define RIGOR_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define RIGOR_WIDE
#endif

// A step of such a loop: becomes part of it, in both clones.
#if defined(__GNUC__)
#define RIGOR_WIDE_STEP inline __attribute__((always_inline))
#else
#define RIGOR_WIDE_STEP inline
#endif
