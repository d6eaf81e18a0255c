// Plain CDR (XCDR1) as ROS 2 writes it: a 4-byte encapsulation header `00 01 00 00`, little-endian, each
// primitive aligned to its own size, counted from after the header. Fast CDR does the work; it stays behind
// this header.
//
// A message is a struct that lists its fields once, for both directions and in the order of its .msg file:
//
//   struct Point { double x, y, z; static constexpr auto fields() { return std::tuple(&Point::x, &Point::y,
//   &Point::z); } };
//
// Fields are bool, integers, floats, strings, other such structs, std::vector and std::array of all these,
// and ByteView: a `uint8[]` that is borrowed. What a writer borrows goes into the output as it lies, without
// a copy; what a reader hands out points into the message that it reads.
#pragma once

#include <array>
#include <concepts>
#include <cstdint>
#include <exception>
#include <memory>
#include <string>
#include <tuple>
#include <type_traits>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/record/byte_io.h"

namespace rigor::record {

/// A `uint8[]` that belongs to somebody else.
using ByteView = Bytes;

template <class T>
concept CdrPrimitive = std::same_as<T, bool> || std::same_as<T, std::int8_t> ||
    std::same_as<T, std::uint8_t> || std::same_as<T, std::int16_t> || std::same_as<T, std::uint16_t> ||
    std::same_as<T, std::int32_t> || std::same_as<T, std::uint32_t> || std::same_as<T, std::int64_t> ||
    std::same_as<T, std::uint64_t> || std::same_as<T, float> || std::same_as<T, double>;

template <class T>
concept CdrStruct = requires {
  T::fields();
};

/// Writes one message after the other; keeps its memory. One thread at a time; allocates until it has grown.
class CdrWriter {
 public:
  CdrWriter();
  ~CdrWriter();
  CdrWriter(CdrWriter&&) noexcept;
  CdrWriter& operator=(CdrWriter&&) noexcept;

  /// The encoded message in pieces, valid until the next call and as long as what it borrows.
  /// Errors: internal, when a borrowed field is followed by one that would have to be aligned.
  template <CdrStruct M>
  [[nodiscard]] Result<Pieces> write(const M& message) {
    try {
      begin();
      put(message);
      return finish();
    } catch (const std::exception& e) {
      return fail(ErrorCode::unavailable, "CDR", std::string("no memory to encode a message: ") + e.what());
    }
  }

 private:
  struct Impl;
  static constexpr std::size_t kBorrowBytes = 1024;  ///< smaller fields are cheaper to copy

  void begin();
  Result<Pieces> finish();
  void put_text(const std::string& text);
  void put_borrowed(ByteView bytes);
  template <CdrPrimitive T>
  void put_array(const T* values, std::size_t n);
  void put_count(std::size_t n) {
    const auto count = static_cast<std::uint32_t>(n);
    put_array(&count, 1);
  }

  template <CdrPrimitive T>
  void put(const T& value) {
    put_array(&value, 1);
  }
  void put(const std::string& text) { put_text(text); }
  void put(const ByteView& bytes) { put_borrowed(bytes); }
  template <class T>
  void put(const std::vector<T>& values) {
    put_count(values.size());
    put_all(values.data(), values.size());
  }
  template <class T, std::size_t N>
  void put(const std::array<T, N>& values) {
    put_all(values.data(), N);
  }
  template <CdrStruct M>
  void put(const M& message) {
    std::apply([&](auto... member) { (put(message.*member), ...); }, M::fields());
  }
  template <class T>
  void put_all(const T* values, std::size_t n) {
    if constexpr (CdrPrimitive<T>) {
      put_array(values, n);
    } else {
      for (std::size_t i = 0; i < n; ++i) put(values[i]);
    }
  }

  std::unique_ptr<Impl> impl_;
};

/// Reads one message. Nothing in it is trusted: counts and lengths are checked against the bytes that are
/// there.
class CdrReader {
 public:
  /// Errors: protocol, saying at which byte of the message. Bytes after the last field are allowed up to the
  /// padding that some writers add (7).
  template <CdrStruct M>
  [[nodiscard]] static Status read(Bytes data, M& message) {
    CdrReader reader(data);
    reader.get(message);
    return reader.finish();
  }

 private:
  struct Impl;
  explicit CdrReader(Bytes data);
  ~CdrReader();
  CdrReader(const CdrReader&) = delete;
  CdrReader& operator=(const CdrReader&) = delete;

  Status finish() const;
  [[nodiscard]] bool ok() const;
  /// An element count, no more than fits into what is left at `element_bytes` each.
  std::uint32_t get_count(std::size_t element_bytes);
  void get_text(std::string& text);
  void get_borrowed(ByteView& bytes);
  template <CdrPrimitive T>
  void get_array(T* values, std::size_t n);

  template <CdrPrimitive T>
  void get(T& value) {
    get_array(&value, 1);
  }
  void get(std::string& text) { get_text(text); }
  void get(ByteView& bytes) { get_borrowed(bytes); }
  template <class T>
  void get(std::vector<T>& values) {
    const std::uint32_t n = get_count(smallest<T>());
    values.clear();
    values.resize(n);
    get_all(values.data(), n);
    if (!ok()) values.clear();
  }
  template <class T, std::size_t N>
  void get(std::array<T, N>& values) {
    get_all(values.data(), N);
  }
  template <CdrStruct M>
  void get(M& message) {
    std::apply([&](auto... member) { (get(message.*member), ...); }, M::fields());
  }
  template <class T>
  void get_all(T* values, std::size_t n) {
    if constexpr (CdrPrimitive<T>) {
      get_array(values, n);
    } else {
      for (std::size_t i = 0; i < n && ok(); ++i) get(values[i]);
    }
  }
  /// Fewest bytes that a T takes: what a count is checked with, so that a lie cannot claim memory.
  template <class T>
  struct IsArray : std::false_type {};
  template <class T, std::size_t N>
  struct IsArray<std::array<T, N>> : std::true_type {};
  template <class T>
  static constexpr std::size_t smallest() {
    if constexpr (CdrPrimitive<T>) {
      return sizeof(T);
    } else if constexpr (IsArray<T>::value) {
      return std::tuple_size_v<T> * smallest<typename T::value_type>();
    } else if constexpr (CdrStruct<T>) {
      return std::apply(
          [](auto... member) {
            return (std::size_t{0} + ... +
                    smallest<std::remove_reference_t<decltype(std::declval<T&>().*member)>>());
          },
          T::fields());
    } else {
      return 4;  // the count of a sequence, the length of a string
    }
  }

  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::record
