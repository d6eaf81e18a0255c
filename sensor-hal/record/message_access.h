// Random access to the messages of a recording, without copies where the file allows it.
//
//   auto access = MessageAccess::open("run.mcap");
//   const auto places = (*access)->places(channel_id);       // Result<std::span<const MessagePlace>>
//   const auto message = (*access)->at((*places)[17]);       // Result<HeldMessage>
//   message->data;                                           // valid as long as message->keeper is held
//
// The file is mapped. Messages of chunks that are not compressed lie in the mapping; a compressed chunk is
// unpacked once and kept until `cache_bytes` of newer ones have been read. The place of each message comes
// from the chunks' own indexes; a chunk without one is read. Nothing in the file is trusted: offsets,
// lengths and, once for each chunk, checksums are checked. A file must not be cut while it is mapped.
//
// Any thread; calls wait for each other. Allocates, blocks.
#pragma once

#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "sensor-hal/record/mcap_reader.h"

namespace rigor::record {

struct MessagePlace {
  std::uint64_t log_time_ns = 0;
  std::uint64_t offset = 0;   ///< of the message's record, within the records of its segment
  std::uint32_t segment = 0;  ///< index in McapReader::segments()
  std::uint16_t channel = 0;
};

struct HeldMessage {
  std::shared_ptr<const void> keeper;  ///< of the bytes
  Bytes data;
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0, publish_time_ns = 0;
};

struct MessageAccessOptions {
  bool verify = true;  ///< the checksum of each chunk, when it is first read
  std::uint64_t cache_bytes = std::uint64_t{256} << 20;  ///< of unpacked chunks that nobody holds
  bool skip_damaged = false;  ///< damaged chunks are passed over; false: they are an error of places()
};

class MessageAccess {
 public:
  /// Errors: those of McapReader::open.
  [[nodiscard]] static Result<std::unique_ptr<MessageAccess>> open(const std::string& path,
                                                                   MessageAccessOptions options = {});
  ~MessageAccess();

  /// Channels, schemas, metadata and health. Not while another thread calls this object.
  [[nodiscard]] McapReader& reader() { return *reader_; }
  /// Messages of a channel by log time, and as they lie in the file where that is equal; none of a channel
  /// that the file does not have. Valid as long as this object. Errors: protocol.
  [[nodiscard]] Result<std::span<const MessagePlace>> places(std::uint16_t channel);
  /// Errors: protocol, where the chunk is damaged or no such message lies there.
  [[nodiscard]] Result<HeldMessage> at(const MessagePlace& place);

 private:
  struct Records {
    std::shared_ptr<const void> keeper;
    Bytes bytes;
  };
  struct Cached {
    std::uint32_t segment;
    Records records;
  };
  MessageAccess() = default;
  [[nodiscard]] Result<Records> records(std::uint32_t segment);
  [[nodiscard]] Status find_places();
  [[nodiscard]] bool read_index(std::uint32_t segment);
  [[nodiscard]] Status list(std::uint32_t segment);

  MessageAccessOptions options_;
  std::shared_ptr<const void> mapping_;
  Bytes file_;
  std::unique_ptr<McapReader> reader_;
  std::mutex mutex_;
  bool found_ = false;
  std::map<std::uint16_t, std::vector<MessagePlace>> places_;
  std::vector<bool> verified_;
  std::list<Cached> cache_;  ///< the newest first
  std::uint64_t cached_bytes_ = 0;
};

}  // namespace rigor::record
