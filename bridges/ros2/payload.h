// Messages of ROS 2 as Cyclone DDS takes and gives them, without code made of IDL: a type of its own
// (`ddsi_sertype`) whose samples (`ddsi_serdata`) are encoded already. What the recorder has encoded goes on
// the wire as it is, and the bytes of a picture or a cloud are sent from the slot in which the device put
// them: DDS copies them into the kernel's buffers, nobody else does.
//
// A message in pieces is [ head | bytes of the sample | tail ]. DDS asks for ranges of it, one for each
// fragment; a range within one part is a pointer into it, and one over a boundary (at most two of a message)
// is joined in memory of its own. The lease of the sample ends with the message: at once where nobody has to
// acknowledge it, else when all have.
//
// All types are final, without key, and encoded as XCDR1 (`00 01 00 00`).
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "sensor-hal/record/byte_io.h"
#include "sensor-hal/types/sample.h"

struct ddsi_serdata;
struct ddsi_sertype;

namespace rigor::ros2 {

/// Messages that still borrow from samples; shared by a writer and its messages.
using Borrowed = std::shared_ptr<std::atomic<std::uint32_t>>;

/// A type by its name on DDS, `sensor_msgs::msg::dds_::Image_`; for dds_create_topic_sertype, which takes it
/// over.
[[nodiscard]] ddsi_sertype* make_type(const std::string& dds_name);

/// A message of this type, with one reference. Bytes of `pieces` that lie in `sample` are borrowed, and
/// counted in `borrowed` until the message goes; an empty lease: all are copied. Any thread; allocates.
[[nodiscard]] ddsi_serdata* make_message(const ddsi_sertype* type, record::Pieces pieces,
                                         const SampleLease& sample, const Borrowed& borrowed);

/// The bytes of a message that came in, valid as long as the message and `joined`, where those of a writer in
/// this process are joined.
[[nodiscard]] record::Bytes bytes_of(const ddsi_serdata* message, std::vector<std::byte>& joined);

}  // namespace rigor::ros2
