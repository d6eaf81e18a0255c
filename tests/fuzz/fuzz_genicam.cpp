// What a GigE Vision camera says of itself, on the client: its discovery, the URL of its GenICam description,
// the description's text, the registers of a stream and its first frames. Input: the camera's answers, each
// as `how:8 length:16 bytes`.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "drivers/aravis/gige_client.h"
#include "drivers/aravis/gige_discovery.h"
#include "rt-core/device_text.h"

using namespace rigor;
using namespace rigor::gige;

namespace {

void check(bool holds) {
  if (!holds) std::abort();
}

/// Answers from the input. `how`: 0 silence; bit 0 as an acknowledge of what was asked, with bit 1 of the
/// memory that was asked for; else the bytes as they are.
class Camera final : public GigeTransport {
 public:
  explicit Camera(Bytes answers) : rest_(answers) {}
  void send_control(Bytes datagram) override {
    asked_.assign(datagram.begin(), datagram.end());
    if (asked_.size() < kGvcpHeaderSize) std::abort();
  }
  std::size_t receive_control(MutableBytes out) override {
    if (given_ == kAnswers || rest_.size() < 3) return 0;
    ++given_;
    const std::uint8_t how = rest_[0];
    Bytes bytes = rest_.subspan(3, std::min<std::size_t>(load_be<std::uint16_t>(rest_, 1), rest_.size() - 3));
    rest_ = rest_.subspan(3 + bytes.size());
    if (how == 0) return 0;  // silence
    Datagram d;
    if ((how & 1) == 0) {
      d.assign(bytes.begin(), bytes.end());
    } else if ((how & 2) != 0 && asked_.size() == kGvcpHeaderSize + 8) {
      std::vector<std::uint8_t> memory(load_be<std::uint16_t>(asked_, 14), 0);
      std::copy_n(bytes.begin(), std::min(memory.size(), bytes.size()), memory.begin());
      d = encode_read_memory_ack(id(), load_be<std::uint32_t>(asked_, 8), memory);
    } else {
      const auto command = static_cast<std::uint16_t>(load_be<std::uint16_t>(asked_, 2) + 1);
      d = encode_ack(GvStatus::success, command, id(), bytes.first(std::min(bytes.size(), kGvcpMaxPayload)));
    }
    const std::size_t n = std::min(d.size(), out.size());
    std::copy_n(d.begin(), n, out.begin());
    return n;
  }
  void send_from_stream(Bytes datagram) override { check(!datagram.empty()); }
  std::size_t receive_stream(MutableBytes out) override { return receive_control(out); }
  Endpoint stream_endpoint() const override { return {0x7F000001, 5000}; }

 private:
  static constexpr int kAnswers = 64;
  [[nodiscard]] std::uint16_t id() const { return load_be<std::uint16_t>(asked_, 6); }
  Bytes rest_;
  Datagram asked_;
  int given_ = 0;
};

void meet(Bytes answers) {
  Camera camera(answers);
  GigeClientOptions options;
  options.max_payload_bytes = 1 << 16;
  GigeClient client(camera, options);
  if (const auto identity = client.discover()) {
    FoundCamera found;
    found.identity = *identity;
    for (const std::string* text : {&identity->manufacturer, &identity->model, &identity->version,
                                    &identity->manufacturer_info, &identity->serial, &identity->user_name})
      check(device_text(*text) == *text);
    check(found.mac().size() == 17 && found.answers_to(found.id()) && found.answers_to(found.mac()));
  }
  if (const auto xml = client.read_genicam_xml())
    check(xml->size() <= 64 * kGvcpMaxReadMemory);
  else
    check(device_text(xml.error().message) == xml.error().message);
  (void)client.read_double(0x1000);
  (void)client.connect();
  if (!client.start()) return;
  AssembledFrame frame;
  for (int n = 1; n < 8; ++n)
    if (client.poll(DeviceTime(n * 50'000'000), frame)) check(frame.data.size() <= options.max_payload_bytes);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  meet({data, size});
  return 0;
}
