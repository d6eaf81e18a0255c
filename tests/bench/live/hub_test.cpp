// The live view without sockets: what clients say, who may connect, who gets what.
#include "bench/live/hub.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <deque>
#include <nlohmann/json.hpp>

#include "bench/live/access.h"

namespace rigor::live {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

std::span<const std::byte> bytes_of(const std::string& s) {
  return {reinterpret_cast<const std::byte*>(s.data()), s.size()};
}
std::string u32(std::uint32_t v) {
  std::string s(4, '\0');
  for (std::size_t i = 0; i < 4; ++i) s[i] = static_cast<char>(v >> (8 * i));
  return s;
}
std::string call(std::uint32_t service, std::uint32_t id, const std::string& encoding,
                 const std::string& request) {
  return std::string("\x02", 1) + u32(service) + u32(id) + u32(static_cast<std::uint32_t>(encoding.size())) +
         encoding + request;
}

// ------------------------------------------------------------------ protocol

TEST(LiveProtocol, ReadsWhatClientsSay) {
  const auto s = parse_text(
      R"({"op":"subscribe","subscriptions":[{"id":0,"channelId":3},{"id":4294967295,"channelId":5}]})");
  ASSERT_TRUE(s) << s.error().text();
  const auto& entries = std::get<Subscribe>(*s).entries;
  ASSERT_EQ(entries.size(), 2u);
  EXPECT_EQ(entries[1].id, 4294967295u);
  EXPECT_EQ(entries[1].channel, 5u);
  const auto c = parse_binary(bytes_of(call(7, 9, "json", "{\"a\":1}")));
  ASSERT_TRUE(c) << c.error().text();
  EXPECT_EQ(std::get<ServiceCall>(*c).service, 7u);
  EXPECT_EQ(std::get<ServiceCall>(*c).call, 9u);
  EXPECT_EQ(std::get<ServiceCall>(*c).encoding, "json");
  EXPECT_EQ(std::get<ServiceCall>(*c).request, "{\"a\":1}");
  EXPECT_TRUE(std::holds_alternative<NotOffered>(*parse_text(R"({"op":"fetchAsset"})")));
}

TEST(LiveProtocol, RefusesWhatIsNoMessage) {
  for (const char* text :
       {"", "{", "7", "[]", "{}", R"({"op":7})", R"({"op":"dance"})", R"({"op":"subscribe"})",
        R"({"op":"subscribe","subscriptions":{}})", R"({"op":"subscribe","subscriptions":[7]})",
        R"({"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]})",
        R"({"op":"subscribe","subscriptions":[{"id":1.5,"channelId":1}]})",
        R"({"op":"subscribe","subscriptions":[{"id":4294967296,"channelId":1}]})",
        R"({"op":"unsubscribe","subscriptionIds":["a"]})",
        R"({"op":"getParameters","parameterNames":[],"id":7})"}) {
    const auto m = parse_text(text);
    EXPECT_FALSE(m) << text;
    if (!m) {
      EXPECT_EQ(m.error().code, ErrorCode::protocol);
    }
  }
  json many{{"op", "unsubscribe"}, {"subscriptionIds", std::vector<int>(kMaxEntries + 1)}};
  EXPECT_FALSE(parse_text(many.dump()));
  const std::string whole = call(1, 2, "json", "");
  for (std::size_t n = 0; n < whole.size(); ++n)
    EXPECT_FALSE(parse_binary(bytes_of(whole.substr(0, n)))) << n;
  EXPECT_TRUE(parse_binary(bytes_of(whole)));
  std::string beyond = whole;
  beyond.replace(9, 4, u32(0xffffffff));
  EXPECT_FALSE(parse_binary(bytes_of(beyond)));
  EXPECT_FALSE(parse_binary(bytes_of(std::string("\x09", 1))));
}

// ------------------------------------------------------------------ access

TEST(LiveAccess, ReadsEndpoints) {
  EXPECT_EQ(parse_endpoint("")->port, 8765);
  EXPECT_EQ(parse_endpoint("0")->port, 0);
  EXPECT_EQ(parse_endpoint("localhost:9")->address, "127.0.0.1");
  EXPECT_EQ(parse_endpoint("[::1]:9")->address, "::1");
  EXPECT_TRUE(parse_endpoint("127.9.9.9:9")->loopback());
  EXPECT_TRUE(parse_endpoint("[::1]:9")->loopback());
  EXPECT_FALSE(parse_endpoint("0.0.0.0:9")->loopback());
  for (const char* wrong :
       {"x", "65536", "-1", "1:2:3", "example.com:80", "127.0.0.1:", "127.0.0.1", ":1", "8765 "})
    EXPECT_FALSE(parse_endpoint(wrong)) << wrong;
}

TEST(LiveAccess, AsksForATokenBeyondLoopback) {
  EXPECT_TRUE(check_token({"127.0.0.1", 1}, ""));
  EXPECT_FALSE(check_token({"0.0.0.0", 1}, ""));
  EXPECT_FALSE(check_token({"0.0.0.0", 1}, "short"));
  EXPECT_TRUE(check_token({"0.0.0.0", 1}, "long-enough"));
  const auto one = make_token(), other = make_token();
  ASSERT_TRUE(one && other);
  EXPECT_EQ(one->size(), 32u);
  EXPECT_NE(*one, *other);
}

TEST(LiveAccess, KnowsTheToken) {
  const std::string token = "open sesame+";
  EXPECT_TRUE(token_fits({}, ""));
  EXPECT_FALSE(token_fits({.target = "/"}, token));
  EXPECT_TRUE(token_fits({.target = "/?a=b&token=open%20sesame%2b"}, token));
  EXPECT_FALSE(token_fits({.target = "/?token=open%20sesame%2c"}, token));
  EXPECT_FALSE(token_fits({.target = "/?xtoken=open%20sesame%2b"}, token));
  EXPECT_TRUE(token_fits({.target = "/", .authorization = "Bearer open sesame+"}, token));
  EXPECT_FALSE(token_fits({.target = "/", .authorization = "Bearer open sesame"}, token));
}

TEST(LiveAccess, RefusesOtherSites) {
  const std::string_view host = "localhost:8765";
  EXPECT_EQ(refuse_socket({.host = host}, true, false), "");
  EXPECT_EQ(refuse_socket({.host = host, .origin = "http://localhost:8765"}, true, false), "");
  EXPECT_EQ(refuse_socket({.host = "[::1]:8765", .origin = "http://[::1]:8765"}, true, false), "");
  EXPECT_EQ(refuse_socket({.host = host, .origin = "https://app.foxglove.dev"}, true, false), "");
  for (const char* origin : {"http://evil.example", "null", "http://localhost:8766", "file://",
                             "https://app.foxglove.dev.evil.example"}) {
    EXPECT_NE(refuse_socket({.host = host, .origin = origin}, true, false), "") << origin;
    EXPECT_EQ(refuse_socket({.host = host, .origin = origin}, true, true), "") << origin;
  }
  // DNS rebinding: the attacker's own name leads here, and his page is of the same origin.
  EXPECT_NE(refuse_socket({.host = "evil.example:8765", .origin = "http://evil.example:8765"}, true, false),
            "");
  EXPECT_NE(refuse_page({.host = "evil.example:8765"}, true), "");
  EXPECT_NE(refuse_page({.host = "localhost.evil.example"}, true), "");
  EXPECT_NE(refuse_page({.host = ""}, true), "");
  EXPECT_EQ(refuse_page({.host = "127.0.0.1"}, true), "");
  EXPECT_EQ(refuse_page({.host = "bench.example:8765"}, false), "");
}

// ------------------------------------------------------------------ hub

class FakeLink final : public Link {
 public:
  void send_text(std::string text) override { texts.push_back(json::parse(text)); }
  void send_binary(std::string head, Bytes body) override {
    binaries.push_back(head + (body ? *body : std::string()));
  }
  [[nodiscard]] std::size_t backlog_bytes() const override { return backlog; }
  [[nodiscard]] bool behind() const override { return is_behind; }
  void close(const std::string&) override { closed = true; }
  json last(const std::string& op) const {
    for (auto it = texts.rbegin(); it != texts.rend(); ++it)
      if ((*it)["op"] == op) return *it;
    return nullptr;
  }
  std::vector<json> texts;
  std::vector<std::string> binaries;
  std::size_t backlog = 0;
  bool closed = false, is_behind = false;
};

class LiveHub : public ::testing::Test {
 protected:
  LiveHub()
      : hub("bench", "1", [this](auto work, auto done) {
          later.push_back([work, done] {
            work();
            done();
          });
        }) {
    images = hub.add_channel({0, "/left/image", "cdr", "sensor_msgs/msg/Image", "ros2msg", "uint8 x"});
    live = hub.add_channel({0, "/rigor/live", "json", "rigor.Live", "jsonschema", "{}"});
    hub.add_service({0, "echo", "{}", "{}"}, [this](const std::string& request) {
      ++served;
      return "<" + request + ">";
    });
    hub.advertise_new();
  }
  void subscribe(Link& link, std::uint32_t id, std::uint32_t channel) {
    hub.text(link,
             json{{"op", "subscribe"}, {"subscriptions", {{{"id", id}, {"channelId", channel}}}}}.dump());
  }
  static Bytes message(std::size_t n) { return std::make_shared<const std::string>(n, 'x'); }
  std::vector<std::function<void()>> later;
  int served = 0;
  Hub hub;
  std::uint32_t images = 0, live = 0;
};

TEST_F(LiveHub, GreetsAndSendsWhatIsSubscribed) {
  FakeLink a, b;
  hub.opened(a);
  hub.opened(b);
  EXPECT_EQ(a.last("serverInfo")["name"], "bench");
  EXPECT_EQ(a.last("advertise")["channels"].size(), 2u);
  EXPECT_EQ(a.last("advertiseServices")["services"][0]["name"], "echo");
  EXPECT_FALSE(hub.wanted(images));
  subscribe(a, 70, images);
  EXPECT_TRUE(hub.wanted(images));
  hub.publish(images, 0x0102030405060708u, message(3));
  ASSERT_EQ(a.binaries.size(), 1u);
  EXPECT_EQ(a.binaries[0], std::string("\x01\x46\0\0\0\x08\x07\x06\x05\x04\x03\x02\x01xxx", 16));
  EXPECT_TRUE(b.binaries.empty());
  hub.text(a, R"({"op":"unsubscribe","subscriptionIds":[70]})");
  EXPECT_FALSE(hub.wanted(images));
  hub.publish(images, 1, message(3));
  EXPECT_EQ(a.binaries.size(), 1u);
  subscribe(a, 70, images);
  hub.closed(a);
  EXPECT_FALSE(hub.wanted(images));
  EXPECT_EQ(hub.counters().clients.load(), 1u);
}

/// What a client was sent on a subscription, by the times of the messages.
std::vector<std::uint64_t> times_of(const FakeLink& link, std::uint32_t subscription) {
  std::vector<std::uint64_t> times;
  for (const std::string& m : link.binaries) {
    std::uint32_t id = 0;
    std::uint64_t time = 0;
    if (m.size() < 13 || m[0] != 1) continue;
    std::memcpy(&id, m.data() + 1, sizeof id);
    std::memcpy(&time, m.data() + 5, sizeof time);
    if (id == subscription) times.push_back(time);
  }
  return times;
}
constexpr std::uint64_t kMs = 1'000'000;

TEST_F(LiveHub, ThinsSamplesForWhoAsksForLessAndKeepsTheNewest) {
  const auto samples =
      hub.add_channel({0, "/imu/imu", "cdr", "sensor_msgs/msg/Imu", "ros2msg", ""}, Hub::Delivery::newest);
  const auto events = hub.add_channel({0, "/rigor/events", "cdr", "rigor_msgs/msg/Event", "ros2msg", ""});
  hub.advertise_new();
  FakeLink all, slow, one;
  hub.opened(all);
  hub.opened(slow, 10);
  hub.opened(one);
  subscribe(all, 1, samples);
  subscribe(slow, 2, samples);
  subscribe(slow, 3, events);
  hub.text(one, json{{"op", "subscribe"},
                     {"subscriptions", {{{"id", 4}, {"channelId", samples}, {"rate_hz", 20}}}}}
                    .dump());
  // 1 kHz for half a second, from 1 s on, and then silence.
  for (std::uint64_t ms = 1000; ms <= 1500; ++ms) {
    hub.publish(samples, ms * kMs, message(20));
    hub.publish(events, ms * kMs, message(20));
    hub.advance(ms * kMs);
  }
  EXPECT_EQ(all.binaries.size(), 501U);
  EXPECT_EQ(times_of(slow, 2), (std::vector<std::uint64_t>{1000 * kMs, 1100 * kMs, 1200 * kMs, 1300 * kMs,
                                                           1400 * kMs, 1500 * kMs}));
  EXPECT_EQ(times_of(slow, 3).size(), 501U) << "events come all";
  EXPECT_EQ(times_of(one, 4).size(), 11U);
  EXPECT_EQ(hub.counters().frames_thinned.load(), (501U - 6) + (501 - 11)) << "each that was replaced";
  EXPECT_EQ(hub.counters().frames_dropped.load(), 0U);
  // What came since waits, the newest of it, and is sent when its turn comes, though nothing comes behind it.
  hub.publish(samples, 1510 * kMs, message(21));
  hub.publish(samples, 1520 * kMs, message(22));
  hub.advance(1590 * kMs);
  EXPECT_EQ(times_of(slow, 2).size(), 6U);
  hub.advance(1600 * kMs);
  EXPECT_EQ(times_of(slow, 2).back(), 1520 * kMs);
  EXPECT_EQ(times_of(slow, 2).size(), 7U);
  hub.publish(samples, 1610 * kMs, message(23));
  hub.advance(~std::uint64_t{0});
  EXPECT_EQ(times_of(slow, 2).back(), 1610 * kMs) << "the run's last";
}

TEST_F(LiveHub, KeepsTheRateThatIsAskedForWhereSamplesComeALittleLate) {
  const auto samples = hub.add_channel({0, "/a", "cdr", "", "", ""}, Hub::Delivery::newest);
  hub.advertise_new();
  FakeLink client;
  hub.opened(client, 10);
  subscribe(client, 1, samples);
  // Every 40 ms, as the live view takes them: 100 ms are no multiple of that.
  for (std::uint64_t ms = 0; ms < 4000; ms += 40) {
    hub.publish(samples, ms * kMs, message(5));
    hub.advance(ms * kMs);
  }
  EXPECT_NEAR(static_cast<double>(times_of(client, 1).size()), 40, 1);
}

TEST_F(LiveHub, GivesWhatIsLatchedToWhoComesLater) {
  const auto frames = hub.add_channel({0, "/tf_static", "cdr", "tf2_msgs/msg/TFMessage", "ros2msg", ""},
                                      Hub::Delivery::latched);
  hub.advertise_new();
  FakeLink early, late;
  hub.opened(early, 0.01);
  subscribe(early, 1, frames);
  EXPECT_TRUE(early.binaries.empty()) << "nothing was told yet";
  hub.publish(frames, 5 * kMs, message(9));
  hub.publish(frames, 6 * kMs, message(9));
  EXPECT_EQ(times_of(early, 1), (std::vector<std::uint64_t>{5 * kMs, 6 * kMs})) << "never thinned";
  hub.opened(late, 0.01);
  late.backlog = Hub::kBacklog;
  late.is_behind = true;
  subscribe(late, 7, frames);
  EXPECT_EQ(times_of(late, 7), (std::vector<std::uint64_t>{6 * kMs})) << "at once, though it is behind";
}

TEST(LiveProtocol, ReadsARateAndRefusesOneThatIsNone) {
  const auto entry = [](const char* rate) {
    return parse_text(std::string(R"({"op":"subscribe","subscriptions":[{"id":1,"channelId":2,"rate_hz":)") +
                      rate + "}]}");
  };
  EXPECT_EQ(std::get<Subscribe>(*entry("2.5")).entries[0].rate_hz, 2.5);
  EXPECT_EQ(std::get<Subscribe>(*entry("null")).entries[0].rate_hz, 0);
  for (const char* wrong : {"0", "-1", "1e9", "\"fast\"", "true", "[]"}) EXPECT_FALSE(entry(wrong)) << wrong;
  EXPECT_EQ(*max_rate_of({.target = "/?token=x"}), 0);
  EXPECT_EQ(*max_rate_of({.target = "/?token=x&max_rate_hz=12.5"}), 12.5);
  for (const char* wrong : {"", "x", "0", "-3", "5x", "nan", "inf", "1e9"})
    EXPECT_FALSE(max_rate_of({.target = std::string("/?max_rate_hz=") + wrong})) << wrong;
}

TEST_F(LiveHub, ComplainsOfIdsThatAreNotThere) {
  FakeLink a;
  hub.opened(a);
  const auto complaint = [&] { return a.last("status")["message"].get<std::string>(); };
  subscribe(a, 1, 99);
  EXPECT_THAT(complaint(), HasSubstr("there is no such channel"));
  subscribe(a, 1, 0);
  EXPECT_THAT(complaint(), HasSubstr("channel 0"));
  subscribe(a, 1, images);
  subscribe(a, 1, live);
  EXPECT_THAT(complaint(), HasSubstr("with this id"));
  subscribe(a, 2, images);
  EXPECT_THAT(complaint(), HasSubstr("has subscribed"));
  hub.text(a, R"({"op":"unsubscribe","subscriptionIds":[9]})");
  EXPECT_THAT(complaint(), HasSubstr("no subscription 9"));
  hub.text(a, "no json");
  EXPECT_THAT(complaint(), HasSubstr("expected JSON, got \"no json\""));
  hub.text(a, "[]");
  EXPECT_THAT(complaint(), HasSubstr("expected an object of JSON"));
  EXPECT_FALSE(a.closed);
  EXPECT_FALSE(hub.wanted(live));
}

/// 125 000 levels in a message of 250 KB, which is allowed, overflowed the stack of whoever wrote the value
/// out again.
TEST_F(LiveHub, RefusesDeepNestingInEveryKindOfMessage) {
  FakeLink a;
  hub.opened(a);
  const std::size_t levels = 125'000;
  const std::string deep = std::string(levels, '[') + std::string(levels, ']');
  hub.text(a, R"({"op":"setParameters","parameters":[{"name":"/left/active","value":)" + deep + "}]}");
  EXPECT_THAT(a.last("status")["message"].get<std::string>(), HasSubstr("nested at most 64 levels"));
  hub.binary(a, bytes_of(call(1, 6, "json", deep)));
  EXPECT_THAT(a.last("serviceCallFailure")["message"].get<std::string>(),
              HasSubstr("nested at most 64 levels"));
  EXPECT_TRUE(later.empty());  // nothing was asked of the service
  EXPECT_FALSE(a.closed);
}

TEST_F(LiveHub, DropsForWhoIsSlowAlone) {
  FakeLink slow, quick;
  hub.opened(slow);
  hub.opened(quick);
  subscribe(slow, 1, images);
  subscribe(quick, 1, images);
  slow.backlog = Hub::kBacklog;
  for (int i = 0; i < 5; ++i) hub.publish(images, 1, message(100'000));
  EXPECT_EQ(quick.binaries.size(), 5u);
  EXPECT_TRUE(slow.binaries.empty());
  EXPECT_EQ(hub.counters().frames_dropped.load(), 5u);
  EXPECT_EQ(hub.counters().frames_sent.load(), 5u);
  EXPECT_THAT(slow.last("status")["message"].get<std::string>(), HasSubstr("does not read as fast"));
  hub.publish(images, 1, message(100));  // a little one finds room beside
  EXPECT_EQ(slow.binaries.size(), 1u);
  slow.backlog = 0;  // it has caught up: even what is larger than the backlog goes out
  hub.publish(images, 1, message(Hub::kBacklog + 1));
  EXPECT_EQ(slow.binaries.size(), 2u);
}

TEST_F(LiveHub, SendsNumbersAndAnswersAloneToWhoIsBehind) {
  FakeLink slow;
  hub.opened(slow);
  subscribe(slow, 1, images);
  slow.is_behind = true;
  hub.publish(images, 1, message(Hub::kNumbers + 1));
  EXPECT_TRUE(slow.binaries.empty());
  EXPECT_EQ(hub.counters().frames_dropped.load(), 1u);
  EXPECT_THAT(slow.last("status")["message"].get<std::string>(), HasSubstr("does not read as fast"));
  hub.publish(images, 1, message(Hub::kNumbers));
  EXPECT_EQ(slow.binaries.size(), 1u);
  hub.binary(slow, bytes_of(call(1, 5, "json", "[1]")));
  later.at(0)();
  EXPECT_EQ(slow.binaries.size(), 2u);
  slow.is_behind = false;
  hub.publish(images, 1, message(Hub::kNumbers + 1));
  EXPECT_EQ(slow.binaries.size(), 3u);
}

TEST_F(LiveHub, AnswersCalls) {
  FakeLink a;
  hub.opened(a);
  hub.binary(a, bytes_of(call(1, 5, "json", "[1]")));
  EXPECT_TRUE(a.binaries.empty());
  ASSERT_EQ(later.size(), 1u);
  later[0]();
  ASSERT_EQ(a.binaries.size(), 1u);
  EXPECT_EQ(a.binaries[0], std::string("\x03", 1) + u32(1) + u32(5) + u32(4) + "json<[1]>");
  for (const std::string& wrong : {call(9, 6, "json", "{}"), call(0, 6, "json", "{}"),
                                   call(1, 6, "cdr", "{}"), call(1, 6, "json", "{")}) {
    a.texts.clear();
    hub.binary(a, bytes_of(wrong));
    EXPECT_EQ(a.last("serviceCallFailure")["callId"], 6) << wrong;
  }
}

TEST_F(LiveHub, LimitsCallsAndForgetsThoseOfClientsThatLeft) {
  FakeLink a;
  hub.opened(a);
  for (std::uint32_t i = 0; i < Hub::kCalls; ++i) hub.binary(a, bytes_of(call(1, i, "json", "{}")));
  EXPECT_TRUE(a.last("serviceCallFailure").is_null());
  hub.binary(a, bytes_of(call(1, 99, "json", "{}")));
  EXPECT_EQ(a.last("serviceCallFailure")["callId"], 99);
  later[0]();
  hub.binary(a, bytes_of(call(1, 100, "json", "{}")));
  EXPECT_EQ(later.size(), Hub::kCalls + 1);
  hub.closed(a);
  const std::size_t before = a.binaries.size();
  hub.opened(a);  // another client at the same address
  for (std::size_t i = 1; i < later.size(); ++i) later[i]();
  EXPECT_EQ(a.binaries.size(), before);
}

/// Whoever connects, asks for all that one client may and goes again would fill the queue without end.
TEST_F(LiveHub, LimitsCallsOfAllAndDoesNotDoThoseOfClientsThatLeft) {
  FakeLink a;
  for (std::uint32_t i = 0; i < 2 * Hub::kAllCalls; ++i) {
    hub.opened(a);
    hub.binary(a, bytes_of(call(1, i, "json", "{}")));
    hub.closed(a);
  }
  EXPECT_EQ(later.size(), Hub::kAllCalls);
  FakeLink b;
  hub.opened(b);
  hub.binary(b, bytes_of(call(1, 7, "json", "{}")));
  EXPECT_THAT(b.last("serviceCallFailure")["message"].get<std::string>(), HasSubstr("busy"));
  for (const auto& task : later) task();
  EXPECT_EQ(served, 0);
  later.clear();
  hub.binary(b, bytes_of(call(1, 8, "json", "{}")));
  ASSERT_EQ(later.size(), 1u);
  later[0]();
  EXPECT_EQ(served, 1);
  EXPECT_EQ(b.binaries.size(), 1u);
}

TEST_F(LiveHub, LetsGoOfWhoReadsNoAnswers) {
  FakeLink a;
  hub.opened(a);
  a.backlog = Hub::kMaxBacklog + 1;
  hub.text(a, R"({"op":"getParameters","parameterNames":[]})");
  EXPECT_TRUE(a.closed);
  const std::size_t said = a.texts.size();
  hub.text(a, R"({"op":"getParameters","parameterNames":[]})");
  EXPECT_EQ(a.texts.size(), said);
}

TEST_F(LiveHub, ServesParameters) {
  std::string side = "real";
  hub.serve_parameters(
      [&] {
        return json::array({{{"name", "/left/active"}, {"value", side}}});
      },
      [&](const std::string& name, const json& value) {
        if (name != "/left/active" || !value.is_string()) return false;
        side = value;
        return true;
      });
  FakeLink a;
  hub.opened(a);
  hub.text(a,
           R"({"op":"setParameters","id":"7","parameters":[{"name":"/left/active","value":"simulated"}]})");
  EXPECT_EQ(side, "simulated");
  EXPECT_EQ(a.last("parameterValues")["id"], "7");
  EXPECT_EQ(a.last("parameterValues")["parameters"][0]["value"], "simulated");
  EXPECT_TRUE(a.last("status").is_null());
  hub.text(a, R"({"op":"setParameters","parameters":[{"name":"/right/active","value":"real"}]})");
  EXPECT_THAT(a.last("status")["message"].get<std::string>(), HasSubstr("/right/active"));
}

}  // namespace
}  // namespace rigor::live
