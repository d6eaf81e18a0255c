// Where a recording's bytes go to and come from: a file, or memory for tests and for recordings that never
// reach a disk.
//
// A sink is append-only, takes its bytes as a list of pieces (so that pixels go from the sensor's buffer to
// the kernel without a copy in between), and can be cut back to where the last whole chunk ended when the
// disk is full.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::record {

using Bytes = std::span<const std::byte>;
using Pieces = std::span<const Bytes>;

/// One thread at a time. Setup and I/O threads; never the loop.
class ByteSink {
 public:
  virtual ~ByteSink() = default;
  /// Appends all pieces in order, or returns an error; then some of the bytes may have been appended.
  [[nodiscard]] virtual Status append(Pieces pieces) = 0;
  /// Cuts the output back to its first `size` bytes.
  [[nodiscard]] virtual Status truncate(std::uint64_t size) = 0;
  /// Returns when everything appended so far is safe against loss of power, as far as the medium promises.
  [[nodiscard]] virtual Status sync() = 0;
  /// What to call this output in a message to the user.
  [[nodiscard]] virtual std::string name() const = 0;
};

struct FileSinkOptions {
  bool overwrite = true;  ///< false: an existing file is an error
  /// How often a thread of the sink's own asks the kernel to put the file on the medium (fdatasync), so that
  /// at most this much is lost with the power. Zero: never, the kernel decides (by default within half a
  /// minute). A killed process loses nothing that was appended, in either case. An error of the medium is
  /// reported by the next append.
  Duration sync_period{};
};

/// Creates `path`. Errors: not_writable with the path and the system's reason.
[[nodiscard]] Result<std::unique_ptr<ByteSink>> open_file_sink(const std::string& path,
                                                               FileSinkOptions options = {});

/// Writes to a file that is open already, from where it stands, and closes `fd` at its end. `path` names it
/// in messages.
[[nodiscard]] std::unique_ptr<ByteSink> file_sink(int fd, const std::string& path,
                                                  FileSinkOptions options = {});

/// Collects bytes in memory.
class MemorySink final : public ByteSink {
 public:
  Status append(Pieces pieces) override;
  Status truncate(std::uint64_t size) override;
  Status sync() override { return {}; }
  std::string name() const override { return "memory"; }
  [[nodiscard]] const std::vector<std::byte>& bytes() const { return bytes_; }

 private:
  std::vector<std::byte> bytes_;
};

/// Random access to bytes of known size. One thread at a time.
class ByteSource {
 public:
  virtual ~ByteSource() = default;
  [[nodiscard]] virtual std::uint64_t size() const = 0;
  /// Fills `into` from `offset`; a read beyond the end is an error (protocol).
  [[nodiscard]] virtual Status read(std::uint64_t offset, std::span<std::byte> into) = 0;
  [[nodiscard]] virtual std::string name() const = 0;
};

/// Opens a regular file for reading. Errors: not_found, bad_input for what is not a file, io.
[[nodiscard]] Result<std::unique_ptr<ByteSource>> open_file_source(const std::string& path);
/// Reads from memory that must outlive the source.
[[nodiscard]] std::unique_ptr<ByteSource> memory_source(Bytes bytes, std::string name = "memory");

}  // namespace rigor::record
