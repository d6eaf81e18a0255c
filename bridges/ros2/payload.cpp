#include "bridges/ros2/payload.h"

#include <dds/dds.h>
#include <dds/ddsi/ddsi_keyhash.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <dds/ddsi/ddsi_sertype.h>
#include <dds/ddsi/q_radmin.h>

#include <cstdlib>
#include <cstring>
#include <new>

namespace rigor::ros2 {
namespace {

using record::Bytes;

struct Payload : ddsi_serdata {
  Payload(const ddsi_sertype* of, ddsi_serdata_kind kind_of) : ddsi_serdata{} {
    ddsi_serdata_init(this, of, kind_of);
  }

  std::unique_ptr<std::byte[]> own;  ///< head and tail, the latter padded with zeros to whole words
  std::size_t own_bytes = 0;         ///< with the padding
  std::size_t head_bytes = 0;        ///< of `own`
  Bytes middle;                      ///< of the sample
  std::size_t size = 0;              ///< of the message
  SampleLease sample;
  Borrowed borrowed;

  /// Takes memory for all of a message that is not borrowed.
  void take(std::size_t message_bytes, std::size_t head, Bytes borrowed_bytes) {
    size = message_bytes;
    head_bytes = head;
    middle = borrowed_bytes;
    own_bytes = (size + 3) / 4 * 4 - middle.size();
    own = std::make_unique_for_overwrite<std::byte[]>(own_bytes);
    for (std::size_t i = size - middle.size(); i < own_bytes; ++i) own[i] = std::byte{0};
  }
  /// Where these bytes lie one after the other, or null.
  [[nodiscard]] const std::byte* at(std::size_t offset, std::size_t n) const {
    const std::size_t middle_end = head_bytes + middle.size();
    if (offset + n <= head_bytes) return own.get() + offset;
    if (offset >= head_bytes && offset + n <= middle_end) return middle.data() + (offset - head_bytes);
    if (offset >= middle_end) return own.get() + (offset - middle.size());
    return nullptr;
  }
  void copy(std::size_t offset, std::size_t n, std::byte* to) const {
    const std::size_t middle_end = head_bytes + middle.size();
    while (n > 0) {
      const std::size_t end = offset < head_bytes   ? head_bytes
                              : offset < middle_end ? middle_end
                                                    : offset + n;
      const std::size_t part = std::min(n, end - offset);
      std::memcpy(to, at(offset, part), part);
      offset += part, to += part, n -= part;
    }
  }
  [[nodiscard]] bool holds(const std::byte* p) const {
    return (p >= own.get() && p < own.get() + own_bytes) ||
           (p >= middle.data() && p < middle.data() + middle.size());
  }
};

const Payload& payload(const ddsi_serdata* d) { return *static_cast<const Payload*>(d); }

// ------------------------------------------------------------------ samples

bool same_key(const ddsi_serdata*, const ddsi_serdata*) { return true; }

std::uint32_t size_of(const ddsi_serdata* d) { return static_cast<std::uint32_t>(payload(d).size); }

void free_message(ddsi_serdata* d) {
  auto* message = static_cast<Payload*>(d);
  const Borrowed borrowed = message->sample ? std::move(message->borrowed) : nullptr;
  delete message;
  // After the lease itself is gone, so that who finds the count low finds the slot free.
  if (borrowed) borrowed->fetch_sub(1, std::memory_order_release);
}

ddsi_serdata* from_fragments(const ddsi_sertype* type, ddsi_serdata_kind kind, const nn_rdata* fragment,
                             std::size_t size) {
  auto* message = new (std::nothrow) Payload(type, kind);
  if (!message) return nullptr;
  try {
    message->take(size, size, {});
  } catch (const std::bad_alloc&) {
    delete message;
    return nullptr;
  }
  // Fragments may overlap; together they cover the message.
  std::size_t done = 0;
  for (; fragment != nullptr; fragment = fragment->nextfrag) {
    if (fragment->maxp1 <= done) continue;
    const auto* bytes = NN_RMSG_PAYLOADOFF(fragment->rmsg, NN_RDATA_PAYLOAD_OFF(fragment));
    if (fragment->min > done || fragment->maxp1 > size) break;
    std::memcpy(message->own.get() + done, bytes + (done - fragment->min), fragment->maxp1 - done);
    done = fragment->maxp1;
  }
  if (done == size) return message;
  delete message;
  return nullptr;
}

ddsi_serdata* from_parts(const ddsi_sertype* type, ddsi_serdata_kind kind, ddsrt_msg_iovlen_t parts,
                         const ddsrt_iovec_t* part, std::size_t size) {
  auto* message = new Payload(type, kind);
  message->take(size, size, {});
  std::size_t done = 0;
  for (std::size_t i = 0; i < static_cast<std::size_t>(parts); ++i) {
    const std::size_t n = std::min<std::size_t>(part[i].iov_len, size - done);
    std::memcpy(message->own.get() + done, part[i].iov_base, n);
    done += n;
  }
  return message;
}

ddsi_serdata* from_keyhash(const ddsi_sertype* type, const ddsi_keyhash*) {
  return new Payload(type, SDK_KEY);
}

/// Nothing is written or read as a struct of C.
ddsi_serdata* from_struct(const ddsi_sertype*, ddsi_serdata_kind, const void*) { return nullptr; }
bool to_struct(const ddsi_serdata*, void*, void**, void*) { return false; }
bool untyped_to_struct(const ddsi_sertype*, const ddsi_serdata*, void*, void**, void*) { return true; }

void to_bytes(const ddsi_serdata* d, std::size_t offset, std::size_t n, void* to) {
  payload(d).copy(offset, n, static_cast<std::byte*>(to));
}

ddsi_serdata* refer(const ddsi_serdata* d, std::size_t offset, std::size_t n, ddsrt_iovec_t* to) {
  const std::byte* bytes = payload(d).at(offset, n);
  if (!bytes) {
    auto* joined = static_cast<std::byte*>(std::malloc(n));
    if (!joined) std::abort();  // Cyclone's own answer to it
    payload(d).copy(offset, n, joined);
    bytes = joined;
  }
  to->iov_base = const_cast<std::byte*>(bytes);
  to->iov_len = n;
  return ddsi_serdata_ref(d);
}

void end_reference(ddsi_serdata* d, const ddsrt_iovec_t* to) {
  if (!payload(d).holds(static_cast<const std::byte*>(to->iov_base))) std::free(to->iov_base);
  ddsi_serdata_unref(d);
}

ddsi_serdata* to_untyped(const ddsi_serdata* d) {
  auto* key = new Payload(d->type, SDK_KEY);
  key->type = nullptr;
  return key;
}

std::size_t print(const ddsi_sertype*, const ddsi_serdata* d, char* to, std::size_t room) {
  const int n = std::snprintf(to, room, "%zu bytes", payload(d).size);
  return n < 0 ? 0 : static_cast<std::size_t>(n);
}

void get_keyhash(const ddsi_serdata*, ddsi_keyhash* hash, bool) { std::memset(hash, 0, sizeof *hash); }

#ifdef DDS_HAS_SHM
std::uint32_t shared_size(const ddsi_serdata* d) { return d->type->iox_size; }
ddsi_serdata* from_shared(const ddsi_sertype*, ddsi_serdata_kind, void*, void*) { return nullptr; }
#endif

constexpr ddsi_serdata_ops kMessageOps{same_key,      size_of,     from_fragments, from_parts,
                                       from_keyhash,  from_struct, to_bytes,       refer,
                                       end_reference, to_struct,   to_untyped,     untyped_to_struct,
                                       free_message,  print,       get_keyhash,
#ifdef DDS_HAS_SHM
                                       shared_size,   from_shared
#endif
};

// ------------------------------------------------------------------ types

void free_type(ddsi_sertype* type) {
  ddsi_sertype_fini(type);
  delete type;
}
void zero_structs(const ddsi_sertype*, void*, std::size_t) {}
void realloc_structs(void** structs, const ddsi_sertype*, void*, std::size_t, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) structs[i] = nullptr;
}
void free_structs(const ddsi_sertype*, void**, std::size_t, dds_free_op_t) {}
bool same_type(const ddsi_sertype*, const ddsi_sertype*) { return true; }  // they have the same name
std::uint32_t hash_type(const ddsi_sertype*) { return 0; }
std::size_t struct_size(const ddsi_sertype*, const void*) { return 0; }
bool write_struct(const ddsi_sertype*, const void*, void*, std::size_t) { return false; }

constexpr ddsi_sertype_ops kTypeOps{ddsi_sertype_v0, nullptr,   free_type,   zero_structs, realloc_structs,
                                    free_structs,    same_type, hash_type,   nullptr,      nullptr,
                                    nullptr,         nullptr,   struct_size, write_struct};

}  // namespace

ddsi_sertype* make_type(const std::string& dds_name) {
  auto* type = new ddsi_sertype{};
  ddsi_sertype_init_flags(type, dds_name.c_str(), &kTypeOps, &kMessageOps,
                          DDSI_SERTYPE_FLAG_TOPICKIND_NO_KEY);
  type->allowed_data_representation = DDS_DATA_REPRESENTATION_FLAG_XCDR1;
  return type;
}

ddsi_serdata* make_message(const ddsi_sertype* type, record::Pieces pieces, const SampleLease& sample,
                           const Borrowed& borrowed) {
  auto message = std::make_unique<Payload>(type, SDK_DATA);
  std::size_t size = 0, head = 0;
  Bytes middle;
  for (const Bytes& piece : pieces) {
    if (sample && piece.size() > middle.size()) {
      const Bytes of = sample->bytes();
      if (piece.data() >= of.data() && piece.data() + piece.size() <= of.data() + of.size())
        middle = piece, head = size;
    }
    size += piece.size();
  }
  if (middle.empty()) head = size;
  message->take(size, head, middle);
  std::byte* to = message->own.get();
  for (const Bytes& piece : pieces) {
    if (!middle.empty() && piece.data() == middle.data()) continue;
    if (!piece.empty()) std::memcpy(to, piece.data(), piece.size());
    to += piece.size();
  }
  if (!middle.empty()) {
    message->sample = sample;
    message->borrowed = borrowed;
    if (borrowed) borrowed->fetch_add(1, std::memory_order_relaxed);
  }
  return message.release();
}

record::Bytes bytes_of(const ddsi_serdata* message, std::vector<std::byte>& joined) {
  const Payload& p = payload(message);
  if (p.middle.empty()) return {p.own.get(), p.size};
  joined.resize(p.size);
  p.copy(0, p.size, joined.data());
  return joined;
}

}  // namespace rigor::ros2
