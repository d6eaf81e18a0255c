#include "sensor-hal/record/crc32.h"

#include <array>
#include <cstring>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace rigor::record {
namespace {

constexpr std::uint32_t kPolynomial = 0xEDB88320u;

constexpr auto kSlices = [] {
  std::array<std::array<std::uint32_t, 256>, 8> t{};
  for (std::uint32_t i = 0; i < 256; ++i) {
    std::uint32_t c = i;
    for (int bit = 0; bit < 8; ++bit) c = (c & 1u) != 0 ? (c >> 1) ^ kPolynomial : c >> 1;
    t[0][i] = c;
  }
  for (std::uint32_t i = 0; i < 256; ++i)
    for (std::size_t s = 1; s < 8; ++s) t[s][i] = (t[s - 1][i] >> 8) ^ t[0][t[s - 1][i] & 0xFFu];
  return t;
}();

/// a·b modulo the polynomial, bits reflected (after zlib's crc32_combine, Mark Adler).
constexpr std::uint32_t multiply(std::uint32_t a, std::uint32_t b) {
  std::uint32_t product = 0;
  for (std::uint32_t mask = 1u << 31; mask != 0; mask >>= 1) {
    if ((a & mask) != 0) product ^= b;
    b = (b & 1u) != 0 ? (b >> 1) ^ kPolynomial : b >> 1;
  }
  return product;
}

/// kPowers[k] = x^(2^k) modulo the polynomial.
constexpr auto kPowers = [] {
  std::array<std::uint32_t, 32> t{};
  t[0] = 1u << 30;
  for (std::size_t k = 1; k < 32; ++k) t[k] = multiply(t[k - 1], t[k - 1]);
  return t;
}();

std::uint32_t slice(const std::byte* p, std::size_t n, std::uint32_t c) noexcept {
  for (; n >= 8; n -= 8, p += 8) {
    std::uint32_t low = 0;
    std::uint32_t high = 0;
    std::memcpy(&low, p, 4);
    std::memcpy(&high, p + 4, 4);
    low ^= c;
    c = kSlices[7][low & 0xFFu] ^ kSlices[6][(low >> 8) & 0xFFu] ^ kSlices[5][(low >> 16) & 0xFFu] ^
        kSlices[4][low >> 24] ^ kSlices[3][high & 0xFFu] ^ kSlices[2][(high >> 8) & 0xFFu] ^
        kSlices[1][(high >> 16) & 0xFFu] ^ kSlices[0][high >> 24];
  }
  for (; n > 0; --n, ++p) c = (c >> 8) ^ kSlices[0][(c ^ static_cast<std::uint32_t>(*p)) & 0xFFu];
  return c;
}

#if defined(__x86_64__)
/// x^n modulo the polynomial as the folding below wants it: reflected, in 33 bits.
constexpr long long fold_constant(std::uint32_t n) {
  std::uint32_t power = 1u << 31;
  for (std::size_t k = 0; n != 0; n >>= 1, ++k)
    if ((n & 1u) != 0) power = multiply(kPowers[k], power);
  return static_cast<long long>(std::uint64_t{power} << 1);
}
static_assert(fold_constant(512 + 32) == 0x0154442bd4 &&
              fold_constant(512 - 32) == 0x01c6e41596);  // as published

#define RIGOR_CLMUL __attribute__((target("pclmul,sse4.1")))
#define RIGOR_WIDE_CLMUL __attribute__((target("avx2,vpclmulqdq,pclmul,sse4.1")))

RIGOR_CLMUL inline __m128i load(const std::byte* p) noexcept {
  return _mm_loadu_si128(reinterpret_cast<const __m128i*>(p));
}
RIGOR_WIDE_CLMUL inline __m256i load_wide(const std::byte* p) noexcept {
  return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p));
}

/// x moved on by the distance that the constants stand for, onto `next`.
RIGOR_CLMUL inline __m128i fold(__m128i x, __m128i k, __m128i next) noexcept {
  return _mm_xor_si128(_mm_xor_si128(_mm_clmulepi64_si128(x, k, 0x00), _mm_clmulepi64_si128(x, k, 0x11)),
                       next);
}
RIGOR_WIDE_CLMUL inline __m256i fold(__m256i x, __m256i k, __m256i next) noexcept {
  return _mm256_xor_si256(
      _mm256_xor_si256(_mm256_clmulepi64_epi128(x, k, 0x00), _mm256_clmulepi64_epi128(x, k, 0x11)), next);
}

// V. Gopal et al., "Fast CRC Computation for Generic Polynomials Using PCLMULQDQ Instruction", Intel 2009.

/// The rest of the way from four neighbouring blocks of 16 bytes and the n bytes that follow. n is a multiple
/// of 16.
RIGOR_CLMUL inline std::uint32_t finish(__m128i x0, __m128i x1, __m128i x2, __m128i x3, const std::byte* p,
                                        std::size_t n) noexcept {
  const __m128i by_64 = _mm_set_epi64x(fold_constant(512 - 32), fold_constant(512 + 32));
  const __m128i by_16 = _mm_set_epi64x(fold_constant(128 - 32), fold_constant(128 + 32));
  const __m128i to_64_bits = _mm_set_epi64x(0, fold_constant(64));
  const __m128i barrett = _mm_set_epi64x(0x01f7011641, 0x01db710641);
  const __m128i low_words = _mm_setr_epi32(~0, 0, ~0, 0);
  for (; n >= 64; p += 64, n -= 64) {
    x0 = fold(x0, by_64, load(p));
    x1 = fold(x1, by_64, load(p + 16));
    x2 = fold(x2, by_64, load(p + 32));
    x3 = fold(x3, by_64, load(p + 48));
  }
  x3 = fold(fold(fold(x0, by_16, x1), by_16, x2), by_16, x3);
  for (; n >= 16; p += 16, n -= 16) x3 = fold(x3, by_16, load(p));

  __m128i x = _mm_xor_si128(_mm_srli_si128(x3, 8), _mm_clmulepi64_si128(x3, by_16, 0x10));
  x = _mm_xor_si128(_mm_srli_si128(x, 4),
                    _mm_clmulepi64_si128(_mm_and_si128(x, low_words), to_64_bits, 0x00));
  __m128i q = _mm_clmulepi64_si128(_mm_and_si128(x, low_words), barrett, 0x10);
  q = _mm_clmulepi64_si128(_mm_and_si128(q, low_words), barrett, 0x00);
  return static_cast<std::uint32_t>(_mm_extract_epi32(_mm_xor_si128(x, q), 1));
}

/// Precondition: n >= 64 and a multiple of 16.
RIGOR_CLMUL std::uint32_t fold_all(const std::byte* p, std::size_t n, std::uint32_t c) noexcept {
  const __m128i first = _mm_xor_si128(load(p), _mm_cvtsi32_si128(static_cast<int>(c)));
  return finish(first, load(p + 16), load(p + 32), load(p + 48), p + 64, n - 64);
}

/// The same, two blocks in each register. Precondition: n >= 128 and a multiple of 16.
RIGOR_WIDE_CLMUL std::uint32_t fold_all_wide(const std::byte* p, std::size_t n, std::uint32_t c) noexcept {
  const __m256i by_128 =
      _mm256_broadcastsi128_si256(_mm_set_epi64x(fold_constant(1024 - 32), fold_constant(1024 + 32)));
  const __m256i by_64 =
      _mm256_broadcastsi128_si256(_mm_set_epi64x(fold_constant(512 - 32), fold_constant(512 + 32)));
  __m256i x0 = _mm256_xor_si256(load_wide(p), _mm256_zextsi128_si256(_mm_cvtsi32_si128(static_cast<int>(c))));
  __m256i x1 = load_wide(p + 32);
  __m256i x2 = load_wide(p + 64);
  __m256i x3 = load_wide(p + 96);
  for (p += 128, n -= 128; n >= 128; p += 128, n -= 128) {
    x0 = fold(x0, by_128, load_wide(p));
    x1 = fold(x1, by_128, load_wide(p + 32));
    x2 = fold(x2, by_128, load_wide(p + 64));
    x3 = fold(x3, by_128, load_wide(p + 96));
  }
  x2 = fold(x0, by_64, x2);
  x3 = fold(x1, by_64, x3);
  return finish(_mm256_castsi256_si128(x2), _mm256_extracti128_si256(x2, 1), _mm256_castsi256_si128(x3),
                _mm256_extracti128_si256(x3, 1), p, n);
}

const bool kHasClmul = __builtin_cpu_supports("pclmul") != 0 && __builtin_cpu_supports("sse4.1") != 0;
const bool kHasWideClmul =
    kHasClmul && __builtin_cpu_supports("vpclmulqdq") != 0 && __builtin_cpu_supports("avx2") != 0;
#endif

}  // namespace

std::uint32_t crc32_portable(std::span<const std::byte> bytes, std::uint32_t crc) noexcept {
  return ~slice(bytes.data(), bytes.size(), ~crc);
}

std::uint32_t crc32(std::span<const std::byte> bytes, std::uint32_t crc) noexcept {
#if defined(__x86_64__)
  if (bytes.size() >= 64 && kHasClmul) {
    const std::size_t whole = bytes.size() & ~std::size_t{15};
    const bool wide = kHasWideClmul && whole >= 128;
    const std::uint32_t c =
        wide ? fold_all_wide(bytes.data(), whole, ~crc) : fold_all(bytes.data(), whole, ~crc);
    return ~slice(bytes.data() + whole, bytes.size() - whole, c);
  }
#endif
  return crc32_portable(bytes, crc);
}

std::uint32_t crc32_combine(std::uint32_t crc_a, std::uint32_t crc_b, std::uint64_t length_b) noexcept {
  std::uint32_t shift = 1u << 31;  // x^(8 length_b)
  for (std::size_t k = 3; length_b != 0; length_b >>= 1, ++k)
    if ((length_b & 1u) != 0) shift = multiply(kPowers[k & 31u], shift);
  return multiply(shift, crc_a) ^ crc_b;
}

}  // namespace rigor::record
