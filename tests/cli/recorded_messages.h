// The messages of a recording on one topic.
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

}  // namespace rigor::test
