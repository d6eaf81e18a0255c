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
__attribute__((target("pclmul,sse4.1"))) inline __m128i fold(__m128i x, __m128i k) noexcept {
  return _mm_xor_si128(_mm_clmulepi64_si128(x, k, 0x00), _mm_clmulepi64_si128(x, k, 0x11));
}

__attribute__((target("pclmul,sse4.1"))) inline __m128i load(const std::byte* p) noexcept {
  return _mm_loadu_si128(reinterpret_cast<const __m128i*>(p));
}

/// V. Gopal et al., "Fast CRC Computation for Generic Polynomials Using PCLMULQDQ Instruction", Intel 2009;
/// constants are for the reflected polynomial. Precondition: n >= 64 and a multiple of 16.
__attribute__((target("pclmul,sse4.1"))) std::uint32_t fold_all(const std::byte* p, std::size_t n,
                                                                std::uint32_t c) noexcept {
  const __m128i by_64_bytes = _mm_set_epi64x(0x01c6e41596, 0x0154442bd4);
  const __m128i by_16_bytes = _mm_set_epi64x(0x00ccaa009e, 0x01751997d0);
  const __m128i to_64_bits = _mm_set_epi64x(0, 0x0163cd6124);
  const __m128i barrett = _mm_set_epi64x(0x01f7011641, 0x01db710641);
  const __m128i low_words = _mm_setr_epi32(~0, 0, ~0, 0);

  __m128i x0 = _mm_xor_si128(load(p), _mm_cvtsi32_si128(static_cast<int>(c)));
  __m128i x1 = load(p + 16);
  __m128i x2 = load(p + 32);
  __m128i x3 = load(p + 48);
  for (p += 64, n -= 64; n >= 64; p += 64, n -= 64) {
    x0 = _mm_xor_si128(fold(x0, by_64_bytes), load(p));
    x1 = _mm_xor_si128(fold(x1, by_64_bytes), load(p + 16));
    x2 = _mm_xor_si128(fold(x2, by_64_bytes), load(p + 32));
    x3 = _mm_xor_si128(fold(x3, by_64_bytes), load(p + 48));
  }
  x1 = _mm_xor_si128(fold(x0, by_16_bytes), x1);
  x2 = _mm_xor_si128(fold(x1, by_16_bytes), x2);
  x3 = _mm_xor_si128(fold(x2, by_16_bytes), x3);
  for (; n >= 16; p += 16, n -= 16) x3 = _mm_xor_si128(fold(x3, by_16_bytes), load(p));

  __m128i x = _mm_xor_si128(_mm_srli_si128(x3, 8), _mm_clmulepi64_si128(x3, by_16_bytes, 0x10));
  x = _mm_xor_si128(_mm_srli_si128(x, 4),
                    _mm_clmulepi64_si128(_mm_and_si128(x, low_words), to_64_bits, 0x00));
  __m128i q = _mm_clmulepi64_si128(_mm_and_si128(x, low_words), barrett, 0x10);
  q = _mm_clmulepi64_si128(_mm_and_si128(q, low_words), barrett, 0x00);
  return static_cast<std::uint32_t>(_mm_extract_epi32(_mm_xor_si128(x, q), 1));
}

bool has_clmul() noexcept {
  static const bool yes = __builtin_cpu_supports("pclmul") != 0 && __builtin_cpu_supports("sse4.1") != 0;
  return yes;
}
#endif

}  // namespace

std::uint32_t crc32_portable(std::span<const std::byte> bytes, std::uint32_t crc) noexcept {
  return ~slice(bytes.data(), bytes.size(), ~crc);
}

std::uint32_t crc32(std::span<const std::byte> bytes, std::uint32_t crc) noexcept {
#if defined(__x86_64__)
  if (bytes.size() >= 64 && has_clmul()) {
    const std::size_t whole = bytes.size() & ~std::size_t{15};
    const std::uint32_t c = fold_all(bytes.data(), whole, ~crc);
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
