#include "python/samples.h"

#include "bench/application/process_protocol.h"

namespace rigor::python {

pybind11::bytes sample_record(const Sample& sample) {
  // Of no port: the head of the turn is followed by the sample at once.
  application::TurnMessage message(0, 4096);
  if (!message.add(0, sample, 0)) throw std::runtime_error("a sample's record is larger than expected");
  const auto bytes = message.finish(0, BenchTime{}).subspan(sizeof(application::MessageHeader) + 24);
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace rigor::python
