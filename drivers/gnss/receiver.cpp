#include "drivers/gnss/receiver.h"

#include <pthread.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <map>

namespace rigor::gnss {
namespace {

constexpr Duration kProbe = milliseconds(1300);  ///< a receiver speaks once a second at least
constexpr std::array<unsigned, 8> kUsualBauds{38400, 9600, 115200, 230400, 460800, 921600, 57600, 19200};

std::mutex registry_mutex;
std::map<std::string, std::weak_ptr<Receiver>>& registry() {
  static std::map<std::string, std::weak_ptr<Receiver>> all;
  return all;
}

/// One line, whatever link leads to it.
std::string key_of(const LineSettings& line) {
  std::error_code none;
  if (!line.serial) return line.text();
  const auto real = std::filesystem::canonical(line.serial->device, none);
  return none ? line.serial->device : real.string();
}

Bytes bytes_of(std::span<const char> text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}
std::string_view text_of(Bytes bytes) { return {reinterpret_cast<const char*>(bytes.data()), bytes.size()}; }

Duration idle_after(Duration period) {
  return period.ns() > 0 ? std::clamp(period / 3, milliseconds(10), milliseconds(100)) : milliseconds(50);
}

/// Reads until `until`; `take` says whether it is enough.
template <class F>
serial::ByteLink::State read_messages(serial::ByteLink& link, MonotonicTime until, MessageStream& stream,
                                      F&& take) {
  std::array<char, 4096> buffer;
  while (monotonic_now() < until) {
    const auto r = link.receive(buffer, until);
    if (r.state != serial::ByteLink::State::data) return r.state;
    stream.add(bytes_of({buffer.data(), r.bytes}));
    while (const auto m = stream.next())
      if (take(*m)) return serial::ByteLink::State::data;
  }
  return serial::ByteLink::State::timeout;
}

}  // namespace

Receiver::Receiver(ReceiverSettings settings, std::string channel)
    : settings_(std::move(settings)), channel_(std::move(channel)) {}

Receiver::~Receiver() {
  stop_ = true;
  if (link_) link_->cut();
  if (corrections_) corrections_->cut();
  for (std::thread* t : {&thread_, &corrections_thread_, &pulses_thread_})
    if (t->joinable()) t->join();
}

Result<std::shared_ptr<Receiver>> Receiver::join(const ReceiverSettings& settings, ReceiverClient* client,
                                                 const std::string& channel) {
  const std::lock_guard lock(registry_mutex);
  const std::string key = key_of(settings.line);
  auto receiver = registry()[key].lock();
  if (receiver) {
    if (!(receiver->settings_ == settings))
      return fail(ErrorCode::bad_input, channel,
                  "expected the same keys and the same `rate_hz` as channel " + receiver->channel_ +
                      ", which reads this receiver (" + settings.line.text() + "), too; got others");
  } else {
    receiver.reset(new Receiver(settings, channel));
    if (auto s = receiver->open(); !s) return tl::unexpected<Error>(s.error());
    registry()[key] = receiver;
  }
  const std::lock_guard clients(receiver->clients_mutex_);
  receiver->clients_.push_back(client);
  client->on_connection(true);
  return receiver;
}

void Receiver::leave(ReceiverClient* client) {
  const std::lock_guard lock(clients_mutex_);
  std::erase(clients_, client);
}

template <class F>
void Receiver::for_clients(F&& f) {
  const std::lock_guard lock(clients_mutex_);
  for (ReceiverClient* c : clients_) f(*c);
}

Status Receiver::open() {
  if (!settings_.log.empty()) {
    log_.open(settings_.log, std::ios::binary | std::ios::trunc);
    if (!log_)
      return fail(ErrorCode::not_writable, settings_.log, "cannot write what the receiver sends (`log`)");
  }
  if (!settings_.pps.empty())
    if (auto s = pulses_.open(settings_.pps); !s) return s;
  link_ = settings_.line.make("a receiver",
                              "; check `address` and `port`, or start an emulated one with "
                              "`rigor emulate`");
  if (auto s = connect(); !s) {
    link_->close();
    return fail(s.error().code, channel_, s.error().text());
  }
  ReceiverStream::Options o;
  o.time = settings_.time;
  o.output_delay = settings_.output_delay;
  o.output_delay_sigma = settings_.output_delay_sigma;
  o.period = settings_.period;
  o.epoch.range_error_m = settings_.range_error_m;
  o.repair_rollover = true;
  stream_ = std::make_unique<ReceiverStream>(
      o, ReceiverStream::Handler{
             .solution =
                 [this](const Solution& s, const ReceiverStream::Place& p) {
                   for_clients([&](ReceiverClient& c) { c.on_solution(s, p); });
                 },
             .sky =
                 [this](const Sky& s, const ReceiverStream::Place& p) {
                   for_clients([&](ReceiverClient& c) { c.on_sky(s, p); });
                 },
             .pulse = [this](const TimePulse& p) { for_clients([&](ReceiverClient& c) { c.on_pulse(p); }); },
             .raw = {},
             .message = {}});
  if (settings_.corrections) {
    corrections_ = settings_.corrections->make("a server of RTCM 3", "; it is tried again");
    corrections_thread_ = std::thread([this] { run_corrections(); });
  }
  if (!settings_.pps.empty()) pulses_thread_ = std::thread([this] { run_pulses(); });
  thread_ = std::thread([this] { run(); });
  return {};
}

Status Receiver::connect() {
  {
    const std::lock_guard lock(line_mutex_);
    if (auto s = link_->open(); !s) return s;
  }
  if (auto s = find_speed(); !s) return s;
  if (settings_.configure)
    if (auto s = configure(); !s) return s;
  return await_message();
}

/// Where the speed is not known: the one at which messages come.
Status Receiver::find_speed() {
  if (!settings_.line.serial) return {};
  const bool automatic = settings_.line.serial->baud == 0;
  std::vector<unsigned> speeds;
  // A receiver that was configured once has its own speed again after a power cycle.
  if (settings_.configure && settings_.configure->baud > 0) speeds.push_back(settings_.configure->baud);
  if (automatic)
    speeds.insert(speeds.end(), kUsualBauds.begin(), kUsualBauds.end());
  else
    speeds.push_back(settings_.line.serial->baud);
  if (speeds.size() < 2) return {};
  std::uint64_t bytes = 0;
  for (const unsigned baud : speeds) {
    if (!link_->set_baud(baud)) continue;
    if (settings_.configure) {
      Buffer poll;
      append_ubx(poll, UbxId::mon_ver, {});
      (void)link_->send(text_of(poll));
    }
    MessageStream stream;
    const auto state =
        read_messages(*link_, monotonic_now() + kProbe, stream, [](const Message&) { return true; });
    bytes += stream.counters().bytes;
    if (stream.counters().ubx + stream.counters().nmea + stream.counters().rtcm > 0) return {};
    if (state == serial::ByteLink::State::cut || state == serial::ByteLink::State::gone)
      return fail(ErrorCode::unavailable, settings_.line.text(),
                  "the receiver went away while its speed was sought");
  }
  return fail(ErrorCode::timeout, settings_.line.text(),
              "expected UBX or NMEA at one of the usual speeds, got " + std::to_string(bytes) +
                  " bytes and no message; check the wiring and, with a speed beyond 921600, give `baud`");
}

Status Receiver::configure() {
  ConfigDialog dialog(*settings_.configure, settings_.period, channel_);
  MessageStream stream;
  while (!dialog.done()) {
    bool answered = false;
    Status refused;
    // A request may be lost in a buffer that overflows: it is repeated.
    for (int attempt = 0; attempt < 3 && !answered && refused; ++attempt) {
      const Bytes request = dialog.request();
      if (!link_->send(text_of(request)))
        return fail(ErrorCode::unavailable, settings_.line.text(),
                    "the receiver went away while it was configured");
      const auto state =
          read_messages(*link_, monotonic_now() + settings_.ready / 3, stream, [&](const Message& m) {
            auto taken = dialog.answer(m);
            if (!taken) refused = tl::unexpected<Error>(taken.error());
            answered = taken && *taken;
            return answered || !taken;
          });
      if (state == serial::ByteLink::State::cut || state == serial::ByteLink::State::gone)
        return fail(ErrorCode::unavailable, settings_.line.text(),
                    "the receiver went away while it was configured");
    }
    if (!refused) return refused;
    if (!answered)
      return fail(
          ErrorCode::timeout, settings_.line.text(),
          "expected an answer to " + dialog.asked() + " within `ready_s`, got none (" +
              std::to_string(stream.counters().ubx + stream.counters().nmea) +
              " other messages came); check that it is a u-blox receiver and, of a serial line, that its "
              "transmit line is connected; or leave `configure` away");
  }
  version_ = dialog.version();
  if (settings_.configure->baud > 0 && settings_.line.serial) {
    Buffer request;
    const unsigned generation = settings_.configure->generation != 0 ? settings_.configure->generation
                                : version_                           ? version_->generation()
                                                                     : 9;
    append_baud_request(request, *settings_.configure, generation);
    if (!link_->send(text_of(request)))
      return fail(ErrorCode::unavailable, settings_.line.text(),
                  "the receiver went away while it was configured");
    // Its acknowledgement comes at one of the two speeds; what comes after it at the new one.
    (void)read_messages(*link_, monotonic_now() + milliseconds(150), stream, [](const Message& m) {
      return m.kind == Message::Kind::ubx && (m.ubx == UbxId::ack_ack || m.ubx == UbxId::ack_nak);
    });
    if (!link_->set_baud(settings_.configure->baud))
      return fail(ErrorCode::unavailable, settings_.line.text(),
                  "cannot set the port to " + std::to_string(settings_.configure->baud) + " baud");
  }
  return {};
}

Status Receiver::await_message() {
  MessageStream stream;
  const auto state =
      read_messages(*link_, monotonic_now() + settings_.ready, stream, [](const Message&) { return true; });
  const auto& c = stream.counters();
  if (c.ubx + c.nmea + c.rtcm > 0) {
    heard_ = monotonic_now();
    return {};
  }
  if (state == serial::ByteLink::State::gone)
    return fail(ErrorCode::unavailable, settings_.line.text(),
                "expected a receiver that sends, it closed the line");
  if (c.bytes == 0)
    return fail(
        ErrorCode::timeout, settings_.line.text(),
        "expected UBX or NMEA messages within `ready_s`, got nothing: check that the receiver is on and "
        "sends by this interface; `configure` switches messages on");
  return fail(
      ErrorCode::timeout, settings_.line.text(),
      "expected UBX or NMEA messages, got " + std::to_string(c.bytes) + " bytes that are none" +
          (settings_.line.serial ? ": check `baud`, `parity` and `data_bits` (`baud: auto` tries the usual "
                                   "speeds)"
                                 : ": check that a receiver, or a server of one, is at this port"));
}

void Receiver::close_line() {
  const std::lock_guard lock(line_mutex_);
  link_->close();
}

void Receiver::lost() {
  close_line();
  backoff_.reset();
  for_clients([](ReceiverClient& c) { c.on_connection(false); });
}

bool Receiver::reconnect() {
  if (!link_->wait(backoff_.next())) return false;
  if (stop_) return false;
  if (!connect()) {
    close_line();
    backoff_.failed(monotonic_now());
    return true;
  }
  ++counters_.reconnects;
  backoff_.reset();
  stream_->reconnected();
  heard_messages_ = 0;
  for_clients([](ReceiverClient& c) { c.on_connection(true); });
  return true;
}

void Receiver::take_edges() {
  const std::lock_guard lock(edges_mutex_);
  for (const auto& e : edges_) stream_->take_edge(e.before, e.after);
  edges_.clear();
}

void Receiver::publish() {
  const auto& m = stream_->messages().counters();
  const auto& e = stream_->epochs().counters();
  const auto& c = stream_->counters();
  counters_.messages = m.ubx + m.nmea + m.rtcm;
  counters_.bad = m.bad_checksums + m.bad_lengths + e.malformed + e.incomplete_groups;
  counters_.garbage = m.garbage;
  counters_.rtcm_passed = rtcm_passed_;
  counters_.rtcm_failed = rtcm_failed_;
  counters_.clock_steps = c.clock_steps;
  counters_.rollovers = c.rollovers;
  counters_.edges = c.edges;
  for_clients([&](ReceiverClient& client) { client.on_counters(counters_); });
}

void Receiver::run() {
  pthread_setname_np(pthread_self(), "gnss");
  std::array<char, 4096> buffer;
  const Duration idle = idle_after(settings_.period);
  while (!stop_) {
    if (!link_->is_open()) {
      if (!reconnect()) return;
      continue;
    }
    const auto r = link_->receive(buffer, monotonic_now() + idle);
    if (r.state == serial::ByteLink::State::cut) return;
    if (r.state == serial::ByteLink::State::gone) {
      lost();
      continue;
    }
    take_edges();
    if (r.state == serial::ByteLink::State::data) {
      if (log_.is_open()) log_.write(buffer.data(), static_cast<std::streamsize>(r.bytes)).flush();
      stream_->take(bytes_of({buffer.data(), r.bytes}), BenchTime(r.arrival.ns()));
    } else {
      stream_->idle();
    }
    const auto& c = stream_->messages().counters();
    if (const std::uint64_t messages = c.ubx + c.nmea + c.rtcm; messages != heard_messages_) {
      heard_messages_ = messages;
      heard_ = monotonic_now();
    }
    publish();
    // Another speed, a cable that came out on the far side of a converter: bytes or none, but no message.
    if (monotonic_now() - heard_ > settings_.silence) {
      ++counters_.silences;
      lost();
    }
  }
}

void Receiver::run_corrections() {
  pthread_setname_np(pthread_self(), "gnss-rtcm");
  std::array<char, 2048> buffer;
  MessageStream frames;
  Backoff backoff;
  while (!stop_) {
    if (!corrections_->is_open()) {
      // The first attempt makes what waits can be cut by.
      if (!backoff.due(monotonic_now()) && !corrections_->wait(backoff.next())) return;
      if (!corrections_->open()) {
        backoff.failed(monotonic_now());
        continue;
      }
      frames.reset();
      backoff.reset();
    }
    const auto r = corrections_->receive(buffer, monotonic_now() + seconds(1));
    if (r.state == serial::ByteLink::State::cut) return;
    if (r.state == serial::ByteLink::State::gone) {
      corrections_->close();
      backoff.failed(monotonic_now());
      continue;
    }
    if (r.state != serial::ByteLink::State::data) continue;
    frames.add(bytes_of({buffer.data(), r.bytes}));
    // Whole messages alone: what else a server says (the answer of a caster, garbage) is not the receiver's.
    while (const auto m = frames.next()) {
      if (m->kind != Message::Kind::rtcm) continue;
      const std::lock_guard lock(line_mutex_);
      const bool sent = link_->is_open() && link_->send(text_of(m->frame));
      (sent ? rtcm_passed_ : rtcm_failed_).fetch_add(1, std::memory_order_relaxed);
    }
  }
}

void Receiver::run_pulses() {
  pthread_setname_np(pthread_self(), "gnss-pps");
  while (!stop_) {
    const auto edge = pulses_.next(milliseconds(200));
    if (!edge) continue;
    const std::lock_guard lock(edges_mutex_);
    if (edges_.size() < 8) edges_.push_back(*edge);
  }
}

}  // namespace rigor::gnss
