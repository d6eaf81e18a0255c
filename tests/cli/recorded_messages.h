// The messages of a recording: those on one topic, decoded, or all of them as bytes.
#pragma once

#include <string>
#include <vector>

#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/mcap_reader.h"

namespace rigor::test {

template <class M>
std::vector<M> messages_on(const std::string& recording, const std::string& topic) {
  std::vector<M> all;
  auto reader = record::McapReader::open(recording);
  if (!reader) return all;
  auto cursor = (*reader)->messages({.topics = {topic}, .order = record::MessageOrder::file});
  record::MessageView view;
  for (auto more = cursor.next(view); more && *more; more = cursor.next(view)) {
    M m;
    if (!record::CdrReader::read(view.data, m)) break;
    all.push_back(std::move(m));
  }
  return all;
}

/// Every message, in the order of the file: topic, time and bytes. Two runs that did the same are equal.
inline std::vector<std::string> all_messages(const std::string& recording) {
  std::vector<std::string> all;
  auto reader = record::McapReader::open(recording);
  if (!reader) return all;
  auto cursor = (*reader)->messages({.order = record::MessageOrder::file});
  record::MessageView m;
  for (auto more = cursor.next(m); more && *more; more = cursor.next(m))
    all.push_back(m.channel->topic + ' ' + std::to_string(m.log_time_ns) + ' ' +
                  std::string(reinterpret_cast<const char*>(m.data.data()), m.data.size()));
  return all;
}

}  // namespace rigor::test
