#include "sensor-hal/record/cdr.h"

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastcdr/exceptions/Exception.h>

namespace rigor::record {
namespace {
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
constexpr std::size_t kEncapsulationBytes = 4;
}  // namespace

struct CdrWriter::Impl {
  FastBuffer buffer;
  Cdr cdr{buffer, Cdr::LITTLE_ENDIANNESS, Cdr::DDS_CDR};
  struct Borrowed {
    std::size_t at;  ///< bytes of `buffer` in front of it
    ByteView bytes;
  };
  std::vector<Borrowed> borrowed;
  std::vector<Bytes> pieces;
  bool misaligned = false;
};

CdrWriter::CdrWriter() : impl_(std::make_unique<Impl>()) {}
CdrWriter::~CdrWriter() = default;
CdrWriter::CdrWriter(CdrWriter&&) noexcept = default;
CdrWriter& CdrWriter::operator=(CdrWriter&&) noexcept = default;

void CdrWriter::begin() {
  impl_->borrowed.clear();
  impl_->misaligned = false;
  impl_->cdr.reset();
  impl_->cdr.serialize_encapsulation();
}

Result<Pieces> CdrWriter::finish() {
  if (impl_->misaligned)
    return fail(ErrorCode::internal, "CDR", "a field that needs alignment follows a borrowed one");
  const auto* start = reinterpret_cast<const std::byte*>(impl_->buffer.getBuffer());
  const std::size_t size = impl_->cdr.getSerializedDataLength();
  impl_->pieces.clear();
  std::size_t done = 0;
  for (const auto& [at, bytes] : impl_->borrowed) {
    impl_->pieces.push_back({start + done, at - done});
    impl_->pieces.push_back(bytes);
    done = at;
  }
  if (size > done) impl_->pieces.push_back({start + done, size - done});
  return Pieces(impl_->pieces);
}

template <CdrPrimitive T>
void CdrWriter::put_array(const T* values, std::size_t n) {
  if (n == 0) return;
  // Fast CDR counts alignment in its own buffer, where borrowed bytes are not; single bytes do not care.
  if (sizeof(T) > 1 && !impl_->borrowed.empty()) impl_->misaligned = true;
  // Fast CDR jumps over padding and leaves what lay in its memory, which would then be in the file: two equal
  // messages must be equal bytes.
  const std::size_t past = (impl_->cdr.getSerializedDataLength() - kEncapsulationBytes) % sizeof(T);
  for (std::size_t i = past; past != 0 && i < sizeof(T); ++i) impl_->cdr.serialize(std::uint8_t{0});
  if (n == 1) {
    impl_->cdr.serialize(*values);
  } else {
    impl_->cdr.serializeArray(values, n);
  }
}

void CdrWriter::put_text(const std::string& text) {
  if (!impl_->borrowed.empty()) impl_->misaligned = true;
  // Fast CDR would stop at a NUL within the text.
  put_count(text.size() + 1);
  impl_->cdr.serializeArray(text.c_str(), text.size() + 1);
}

void CdrWriter::put_borrowed(ByteView bytes) {
  put_count(bytes.size());
  if (bytes.size() >= kBorrowBytes) {
    impl_->borrowed.push_back({impl_->cdr.getSerializedDataLength(), bytes});
  } else if (!bytes.empty()) {
    impl_->cdr.serializeArray(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
  }
}

struct CdrReader::Impl {
  explicit Impl(Bytes bytes)
      : data(bytes), buffer(const_cast<char*>(reinterpret_cast<const char*>(bytes.data())), bytes.size()) {}
  Bytes data;
  FastBuffer buffer;
  Cdr cdr{buffer, Cdr::LITTLE_ENDIANNESS, Cdr::DDS_CDR};
  std::string error;

  [[nodiscard]] std::size_t position() { return cdr.getSerializedDataLength(); }
  [[nodiscard]] std::size_t left() { return data.size() - position(); }
  /// Fast CDR takes what was read last as a sign of alignment; a jump alone would leave that sign wrong.
  void skip(std::size_t n) {
    if (n > 1) cdr.jump(n - 1);
    std::uint8_t last = 0;
    if (n > 0) cdr.deserialize(last);
  }
  void bad(const char* what) {
    if (error.empty()) error = "byte " + std::to_string(position()) + " of the message: " + what;
  }
};

CdrReader::CdrReader(Bytes data) : impl_(std::make_unique<Impl>(data)) {
  if (data.size() < kEncapsulationBytes || data[0] != std::byte{0} || data[1] > std::byte{1}) {
    impl_->bad("expected the header of a plain CDR message (00 00 or 00 01)");
    return;
  }
  try {
    impl_->cdr.read_encapsulation();
  } catch (const eprosima::fastcdr::exception::Exception& e) {
    impl_->bad(e.what());
  }
}
CdrReader::~CdrReader() = default;

bool CdrReader::ok() const { return impl_->error.empty(); }

Status CdrReader::finish() const {
  if (ok() && impl_->left() > 7)
    impl_->bad("the message goes on after its last field: it is of another type");
  if (!ok()) return fail(ErrorCode::protocol, "CDR", impl_->error);
  return {};
}

template <CdrPrimitive T>
void CdrReader::get_array(T* values, std::size_t n) {
  if (!ok() || n == 0) return;
  if (n > impl_->left() / sizeof(T)) return impl_->bad("the message ends within a field");
  try {
    if constexpr (std::same_as<T, bool>) {
      for (std::size_t i = 0; i < n; ++i) {
        std::uint8_t value = 0;  // Fast CDR throws for a bool that is neither 0 nor 1
        impl_->cdr.deserialize(value);
        values[i] = value != 0;
      }
    } else if (n == 1) {
      impl_->cdr.deserialize(*values);
    } else {
      impl_->cdr.deserializeArray(values, n);
    }
  } catch (const eprosima::fastcdr::exception::Exception&) {
    impl_->bad("the message ends within a field");
  }
}

std::uint32_t CdrReader::get_count(std::size_t element_bytes) {
  std::uint32_t n = 0;
  get_array(&n, 1);
  if (ok() && n > impl_->left() / element_bytes)
    impl_->bad("a count is larger than what is left of the message");
  return ok() ? n : 0;
}

void CdrReader::get_text(std::string& text) {
  text.clear();
  const std::uint32_t n = get_count(1);
  if (!ok() || n == 0) return;  // some writers send no terminator for an empty text
  text.assign(reinterpret_cast<const char*>(impl_->data.data()) + impl_->position(), n);
  impl_->skip(n);
  if (text.back() == '\0') {
    text.pop_back();
  } else {
    impl_->bad("a text is not terminated");
  }
}

void CdrReader::get_borrowed(ByteView& bytes) {
  const std::uint32_t n = get_count(1);
  bytes = ok() ? impl_->data.subspan(impl_->position(), n) : ByteView{};
  if (ok()) impl_->skip(n);
}

#define RIGOR_CDR(T)                                                     \
  template void CdrWriter::put_array<T>(const T* values, std::size_t n); \
  template void CdrReader::get_array<T>(T * values, std::size_t n);
RIGOR_CDR(bool)
RIGOR_CDR(std::int8_t)
RIGOR_CDR(std::uint8_t)
RIGOR_CDR(std::int16_t)
RIGOR_CDR(std::uint16_t)
RIGOR_CDR(std::int32_t)
RIGOR_CDR(std::uint32_t)
RIGOR_CDR(std::int64_t)
RIGOR_CDR(std::uint64_t)
RIGOR_CDR(float)
RIGOR_CDR(double)
#undef RIGOR_CDR

}  // namespace rigor::record
