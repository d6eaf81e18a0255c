// Channels, services and who listens to them: the protocol's state for all clients, without sockets.
//
// A message is encoded once and shared by all who subscribe. What a client has not yet read counts as its
// backlog; a message that would make it longer than kBacklog is dropped for that client, and counted. So is
// one of more than kNumbers while the client is behind, as what it asks for would be answered behind all
// that. Answers to its own requests are never dropped: a client that lets more than kMaxBacklog of those lie
// is let go.
//
// A client that asks for less (a rate of its connection, or of a subscription) gets of the samples of a topic
// the newest, at most so often in the run's time: what came since its last one waits, and is replaced by the
// next. The last one of a topic that falls silent therefore comes, too. Replaced ones are counted. Events,
// commands and what is not Delivery::newest come all; of what is latched a new subscriber gets the last
// message at once.
//
// All calls: the server's thread, but for counters().
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "bench/live/message_history.h"
#include "bench/live/protocol.h"
#include "rt-core/time.h"

namespace rigor::live {

/// The way to one client.
class Link {
 public:
  static constexpr Duration kBehind = milliseconds(250);
  virtual ~Link() = default;
  virtual void send_text(std::string text) = 0;
  virtual void send_binary(std::string head, Bytes body) = 0;  ///< body may be null
  /// What was given to it and has not been handed to the kernel.
  [[nodiscard]] virtual std::size_t backlog_bytes() const = 0;
  /// The client has not taken in what was handed to the kernel kBehind ago.
  [[nodiscard]] virtual bool behind() const = 0;
  /// The client is told why and let go; no call follows but Hub::closed.
  virtual void close(const std::string& why) = 0;
};

struct HubCounters {
  std::atomic<std::uint64_t> frames_sent{0}, frames_dropped{0}, frames_thinned{0}, bytes_sent{0};
  std::atomic<std::uint32_t> clients{0};
};

class Hub {
 public:
  /// How a topic's messages reach those who asked for fewer, or came later.
  enum class Delivery : std::uint8_t {
    every,   ///< all of them
    newest,  ///< as often as the client wants them
    latched  ///< all of them, and the last one to each new subscriber
  };
  static constexpr std::size_t kBacklog = 2u << 20, kMaxBacklog = 64u << 20;
  /// A message up to this size goes out beside a picture that fills the backlog.
  static constexpr std::size_t kSmall = 64u << 10;
  /// Events, and numbers of plots, which shall have no gaps, go out to a client that is behind.
  static constexpr std::size_t kNumbers = 4u << 10;
  static constexpr std::size_t kCalls = 16;     ///< of one client at a time
  static constexpr std::size_t kAllCalls = 48;  ///< of all, those included whose client has gone

  /// A service's answer; called on whatever thread `run_service` brings it to. It throws nothing.
  using Service = std::function<std::string(const std::string& request)>;
  /// Runs `work` somewhere else, then `done` on the server's thread.
  using RunInBackground = std::function<void(std::function<void()> work, std::function<void()> done)>;

  Hub(std::string name, std::string session_id, RunInBackground run_in_background);

  /// The channel's id. Clients that are there already are told of it by `advertise_new`.
  std::uint32_t add_channel(ChannelInfo channel, Delivery delivery = Delivery::every);
  void add_service(ServiceInfo service, Service answer);
  void advertise_new();
  /// Values as JSON, and how one is set (it throws nothing; false: there is no such parameter, or not with
  /// that value).
  void serve_parameters(std::function<nlohmann::json()> values,
                        std::function<bool(const std::string& name, const nlohmann::json& value)> set);

  /// What is published on the channel is remembered from now on, for `history`.
  void keep(std::uint32_t channel, MessageHistory::Keep how) { history_.keep(channel, how); }
  /// What is kept of a topic. bad_input: there is no such topic, or its messages are not kept. Any thread,
  /// once all channels are added.
  [[nodiscard]] Result<std::vector<MessageHistory::Kept>> history(std::string_view topic) const;
  [[nodiscard]] bool subscribed_now(std::uint32_t channel) const { return subscribers_[channel - 1] > 0; }
  /// Somebody listens, or it is kept.
  [[nodiscard]] bool wanted(std::uint32_t channel) const {
    return subscribed_now(channel) || history_.keeps(channel);
  }
  /// Counts subscriptions that were made to a channel so far: who sends only changes sees a new one.
  [[nodiscard]] std::uint64_t subscribed(std::uint32_t channel) const { return subscribed_[channel - 1]; }
  void publish(std::uint32_t channel, std::uint64_t time_ns, const Bytes& message);
  void publish_time(std::uint64_t time_ns);
  /// The run has come to this instant: what waits for clients that asked for less is sent where its turn has
  /// come. At its end: the largest number.
  void advance(std::uint64_t now_ns);

  // By whoever has the sockets.
  /// `max_rate_hz`: of each topic that is Delivery::newest; 0: as it comes.
  void opened(Link& link, double max_rate_hz = 0);
  void text(Link& link, std::string_view message);
  void binary(Link& link, std::span<const std::byte> message);
  void closed(Link& link);

  [[nodiscard]] const HubCounters& counters() const { return counters_; }

 private:
  struct Subscription {
    std::uint32_t id = 0;
    std::uint64_t period_ns = 0;  ///< 0: as it comes
    std::uint64_t next_ns = 0;    ///< from when on the next message may go
    Bytes waiting;                ///< null: none
    std::uint64_t waiting_time_ns = 0;
  };
  struct Client {
    Link* link = nullptr;
    std::uint64_t serial = 0;                           ///< answers that come when it has gone find nobody
    std::map<std::uint32_t, std::uint32_t> channel_of;  // by subscription
    std::map<std::uint32_t, Subscription> subscription_of;  // by channel
    double max_rate_hz = 0;
    std::size_t calls = 0;
    /// Until it goes: what it asked for and was not begun is not done any more.
    std::shared_ptr<std::atomic<bool>> here = std::make_shared<std::atomic<bool>>(true);
    bool reported_drops = false, leaving = false;
  };
  struct Offered {
    ServiceInfo info;
    Service answer;
  };
  [[nodiscard]] Client* client_of(const Link* link);
  void deliver(Client& client, std::uint32_t channel, Subscription& to, std::uint64_t time_ns,
               const Bytes& message);
  /// Takes the turn of a message at `time_ns`.
  static void take_turn(Subscription& to, std::uint64_t time_ns);
  void handle(Client& client, Result<ClientMessage> message);
  void on(Client& client, const Subscribe& message);
  void on(Client& client, const Unsubscribe& message);
  void on(Client& client, const GetParameters& message);
  void on(Client& client, const SetParameters& message);
  void on(Client& client, const ServiceCall& message);
  void on(Client& client, const NotOffered& message);
  void say(Client& client, std::string text);
  void say(Client& client, std::string head, Bytes body);
  void complain(Client& client, const std::string& text);
  [[nodiscard]] bool overfull(Client& client);

  std::string name_, session_id_;
  RunInBackground run_in_background_;
  std::vector<ChannelInfo> channels_;  // id − 1 is the place
  std::vector<Delivery> delivery_;
  struct Latched {
    std::uint64_t time_ns = 0;
    Bytes message;  ///< null: none came
  };
  std::vector<Latched> latched_;
  std::vector<std::uint32_t> subscribers_;
  std::vector<std::uint64_t> subscribed_;
  std::vector<Offered> services_;  // id − 1 is the place
  std::size_t advertised_channels_ = 0, advertised_services_ = 0;
  std::function<nlohmann::json()> parameters_;
  std::function<bool(const std::string&, const nlohmann::json&)> set_parameter_;
  MessageHistory history_;
  std::map<const Link*, Client> clients_;
  std::uint64_t next_serial_ = 1;
  std::size_t calls_ = 0;
  HubCounters counters_;
};

}  // namespace rigor::live
