#include "bridges/ros2/participant.h"

#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <dds/ddsi/ddsi_sertype.h>
#include <fmt/format.h>
#include <semaphore.h>
#include <time.h>

#include <array>
#include <cstdlib>
#include <map>
#include <mutex>
#include <set>

#include "bridges/ros2/names.h"
#include "bridges/ros2/payload.h"
#include "bridges/ros2/type_hash.h"

namespace rigor::ros2 {
namespace {

constexpr std::array<std::pair<const char*, Qos::Profile>, 3> kProfiles{
    {{"sensor_data", Qos::Profile::sensor_data},
     {"reliable", Qos::Profile::reliable},
     {"transient_local", Qos::Profile::transient_local}}};

/// What peers call the policies, by Cyclone's numbers of them.
const char* policy_name(std::uint32_t id) {
  switch (id) {
    case DDS_RELIABILITY_QOS_POLICY_ID:
      return "RELIABILITY";
    case DDS_DURABILITY_QOS_POLICY_ID:
      return "DURABILITY";
    case DDS_DEADLINE_QOS_POLICY_ID:
      return "DEADLINE";
    case DDS_LATENCYBUDGET_QOS_POLICY_ID:
      return "LATENCY_BUDGET";
    case DDS_LIVELINESS_QOS_POLICY_ID:
      return "LIVELINESS";
    case DDS_OWNERSHIP_QOS_POLICY_ID:
      return "OWNERSHIP";
    case DDS_DESTINATIONORDER_QOS_POLICY_ID:
      return "DESTINATION_ORDER";
    case DDS_PRESENTATION_QOS_POLICY_ID:
      return "PRESENTATION";
    case DDS_PARTITION_QOS_POLICY_ID:
      return "PARTITION";
    case DDS_DATA_REPRESENTATION_QOS_POLICY_ID:
      return "DATA_REPRESENTATION";
    case DDS_TYPE_CONSISTENCY_ENFORCEMENT_QOS_POLICY_ID:
      return "TYPE_CONSISTENCY_ENFORCEMENT";
    default:
      return "";
  }
}

struct FreeQos {
  void operator()(dds_qos_t* qos) const { dds_delete_qos(qos); }
};
using QosPtr = std::unique_ptr<dds_qos_t, FreeQos>;

QosPtr make_qos(const Qos& wanted, const std::string& user_data, bool writes) {
  QosPtr qos(dds_create_qos());
  const bool reliable = wanted.profile != Qos::Profile::sensor_data;
  // A peer that is behind costs this message, not the time of whoever sends: nobody waits for it.
  dds_qset_reliability(qos.get(), reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT, 0);
  dds_qset_durability(qos.get(), wanted.profile == Qos::Profile::transient_local
                                     ? DDS_DURABILITY_TRANSIENT_LOCAL
                                     : DDS_DURABILITY_VOLATILE);
  const int usual = wanted.profile == Qos::Profile::sensor_data ? 5
                    : wanted.profile == Qos::Profile::reliable  ? 10
                                                                : 1;
  const int depth = wanted.depth > 0 ? wanted.depth : usual;
  // A writer that kept the last few would replace what a peer has not acknowledged, and nobody would count
  // it. So it keeps all, up to kMostUnacknowledged bytes, and then takes no more.
  const bool all = writes && reliable;
  dds_qset_history(qos.get(), all ? DDS_HISTORY_KEEP_ALL : DDS_HISTORY_KEEP_LAST, depth);
  if (wanted.profile == Qos::Profile::transient_local)
    dds_qset_durability_service(qos.get(), 0, DDS_HISTORY_KEEP_LAST, depth, DDS_LENGTH_UNLIMITED,
                                DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
  const dds_data_representation_id_t xcdr1 = DDS_DATA_REPRESENTATION_XCDR1;
  dds_qset_data_representation(qos.get(), 1, &xcdr1);
  if (!user_data.empty()) dds_qset_userdata(qos.get(), user_data.data(), user_data.size());
  return qos;
}

/// What Cyclone wrote to its log while something was opened: its reason for a failure.
std::mutex log_mutex;
std::string log_text;
void keep_log(void*, const dds_log_data_t* data) {
  const std::lock_guard lock(log_mutex);
  if ((data->priority & (DDS_LC_ERROR | DDS_LC_FATAL | DDS_LC_WARNING)) != 0 && log_text.size() < 2000)
    log_text.append(data->message, data->size);
}
std::string taken_log() {
  const std::lock_guard lock(log_mutex);
  std::string text = std::move(log_text);
  log_text.clear();
  for (char& c : text)
    if (c == '\n') c = ' ';
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return text;
}
std::string reason(dds_return_t code) {
  const std::string log = taken_log();
  return std::string(dds_strretcode(-code)) + (log.empty() ? "" : " (" + log + ")");
}

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) switch (c) {
      case '<':
        out += "&lt;";
        break;
      case '&':
        out += "&amp;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += c;
    }
  return out;
}

/// Participants by domain.
std::mutex open_mutex;
std::map<std::uint32_t, std::pair<DomainSettings, std::weak_ptr<Participant>>> open_participants;

template <class Status>
Mismatch to_mismatch(const Status& status) {
  return {status.total_count, status.total_count > 0 ? policy_name(status.last_policy_id) : ""};
}

}  // namespace

std::string name_of(const Qos& qos) {
  for (const auto& [name, profile] : kProfiles)
    if (profile == qos.profile) return qos.depth > 0 ? fmt::format("{}({})", name, qos.depth) : name;
  return "";
}

const std::vector<std::string>& qos_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> all;
    for (const auto& [name, profile] : kProfiles) all.emplace_back(name);
    return all;
  }();
  return names;
}

Qos::Profile qos_profile(const std::string& name) {
  for (const auto& [known, profile] : kProfiles)
    if (name == known) return profile;
  return Qos::Profile::reliable;
}

std::string cyclone_configuration(const DomainSettings& settings) {
  std::string general, discovery;
  if (settings.interface != "auto") {
    const bool address = settings.interface.find_first_of(".:") != std::string::npos;
    // On loopback Linux sets no flag MULTICAST, and passes multicast on all the same.
    const bool loopback = settings.interface == "lo" || settings.interface.starts_with("127.");
    general =
        fmt::format(R"(<Interfaces><NetworkInterface {}="{}"{}/></Interfaces>)", address ? "address" : "name",
                    escaped(settings.interface), loopback ? R"( multicast="true")" : "");
    if (loopback) {
      // Datagrams that fill loopback's MTU. Of 20 pictures of 1.3 MB at 30 Hz a reader of Fast DDS with
      // Linux's usual receive buffer (208 KB) acknowledged 9 to 15 in time at Cyclone's own size, and 19 or
      // 20 at this.
      general += "<MaxMessageSize>65500 B</MaxMessageSize><FragmentSize>60000 B</FragmentSize>";
      // Peers that use no multicast on loopback (rmw_cyclonedds with the range LOCALHOST) are found at the
      // ports of the first participants of a machine.
      discovery +=
          "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>";
    }
  }
  std::vector<std::string> peers = settings.peers;
  if (!discovery.empty()) peers.insert(peers.begin(), "localhost");
  if (!peers.empty()) {
    discovery += "<Peers>";
    for (const std::string& peer : peers) discovery += fmt::format(R"(<Peer address="{}"/>)", escaped(peer));
    discovery += "</Peers>";
  }
  return fmt::format(
      R"(<CycloneDDS><Domain Id="any"><General>{0}</General><Discovery>{1}</Discovery><Internal><Watermarks>)"
      R"(<WhcHigh>{2} B</WhcHigh><WhcHighInit>{2} B</WhcHighInit><WhcAdaptive>false</WhcAdaptive>)"
      R"(</Watermarks></Internal></Domain></CycloneDDS>)",
      general, discovery, kMostUnacknowledged);
}

// ------------------------------------------------------------------ participant

struct Participant::Impl {
  DomainSettings settings;
  dds_entity_t domain = 0, participant = 0;
  dds_entity_t publications = 0, subscriptions = 0;  ///< readers of what peers tell of themselves
  std::mutex mutex;
  std::map<std::string, std::string> types;  ///< by topic, both as DDS names them
  std::set<std::string> told;

  ~Impl() {
    if (participant > 0) dds_delete(participant);
    if (domain > 0) dds_delete(domain);
  }
  Result<dds_entity_t> topic(const std::string& name, const MessageType& type, ddsi_sertype** sertype) {
    const std::string type_name = dds_type(type.name);
    if (type_name.empty())
      return fail(ErrorCode::bad_input, name,
                  "expected a message type such as sensor_msgs/Image, got \"" + type.name + "\"");
    *sertype = make_type(type_name);
    const dds_entity_t made =
        dds_create_topic_sertype(participant, dds_topic(name).c_str(), sertype, nullptr, nullptr, nullptr);
    if (made < 0) {
      ddsi_sertype_unref(*sertype);
      return fail(ErrorCode::unavailable, name, "DDS makes no topic of this name: " + reason(made));
    }
    const std::lock_guard lock(mutex);
    types[dds_topic(name)] = type_name;
    return made;
  }
};

Participant::Participant(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

Participant::~Participant() {
  const std::lock_guard lock(open_mutex);
  const auto at = open_participants.find(impl_->settings.domain);
  if (at != open_participants.end() && at->second.second.expired()) open_participants.erase(at);
  impl_.reset();
}

Result<std::shared_ptr<Participant>> Participant::open(const DomainSettings& settings) {
  const std::lock_guard lock(open_mutex);
  const std::string where = fmt::format("DDS domain {}", settings.domain);
  if (const auto at = open_participants.find(settings.domain); at != open_participants.end())
    if (auto there = at->second.second.lock()) {
      if (at->second.first == settings) return there;
      return fail(ErrorCode::bad_input, where,
                  fmt::format("expected the same interface and peers wherever a process names this domain, "
                              "got the interfaces {} and {}",
                              at->second.first.interface, settings.interface));
    }
  dds_set_log_sink(keep_log, nullptr);
  (void)taken_log();
  auto impl = std::make_unique<Impl>();
  impl->settings = settings;
  std::string configuration = cyclone_configuration(settings);
  if (const char* more = std::getenv("CYCLONEDDS_URI"); more && *more)
    configuration += std::string(",") + more;
  impl->domain = dds_create_domain(settings.domain, configuration.c_str());
  if (impl->domain < 0)
    return fail(ErrorCode::unavailable, where,
                fmt::format("expected to join it on the interface {}, got {}", settings.interface,
                            reason(impl->domain)));
  const QosPtr qos(dds_create_qos());
  // As ROS 2 marks its own participants.
  static constexpr std::string_view kEnclave = "enclave=/;";
  dds_qset_userdata(qos.get(), kEnclave.data(), kEnclave.size());
  dds_qset_entity_name(qos.get(), "rigor");
  impl->participant = dds_create_participant(settings.domain, qos.get(), nullptr);
  if (impl->participant < 0)
    return fail(ErrorCode::unavailable, where,
                fmt::format("expected to join it on the interface {}, got {}", settings.interface,
                            reason(impl->participant)));
  impl->publications =
      dds_create_reader(impl->participant, DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr, nullptr);
  impl->subscriptions =
      dds_create_reader(impl->participant, DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION, nullptr, nullptr);
  std::shared_ptr<Participant> made(new Participant(std::move(impl)));
  open_participants[settings.domain] = {settings, made};
  return made;
}

namespace {
std::string user_data(const MessageType& type) {
  if (type.definition.empty()) return {};
  const auto definition = read_definition(type.name, type.definition);
  if (!definition) return {};
  const auto hash = type_hash(*definition);
  return hash ? "typehash=" + *hash + ";" : "";
}
}  // namespace

Result<std::unique_ptr<Writer>> Participant::write(const std::string& topic, const MessageType& type,
                                                   const Qos& qos) {
  std::unique_ptr<Writer> writer(new Writer);
  const auto made = impl_->topic(topic, type, &writer->type_);
  if (!made) return tl::unexpected<Error>(made.error());
  writer->topic_ = *made;
  writer->writer_ =
      dds_create_writer(impl_->participant, *made, make_qos(qos, user_data(type), true).get(), nullptr);
  if (writer->writer_ < 0)
    return fail(ErrorCode::unavailable, topic, "DDS makes no writer of it: " + reason(writer->writer_));
  writer->participant_ = shared_from_this();
  return writer;
}

Result<std::unique_ptr<Reader>> Participant::read(const std::string& topic, const MessageType& type,
                                                  const Qos& qos) {
  std::unique_ptr<Reader> reader(new Reader);
  ddsi_sertype* sertype = nullptr;
  const auto made = impl_->topic(topic, type, &sertype);
  if (!made) return tl::unexpected<Error>(made.error());
  reader->topic_ = *made;
  reader->reader_ =
      dds_create_reader(impl_->participant, *made, make_qos(qos, user_data(type), false).get(), nullptr);
  if (reader->reader_ < 0)
    return fail(ErrorCode::unavailable, topic, "DDS makes no reader of it: " + reason(reader->reader_));
  reader->participant_ = shared_from_this();
  return reader;
}

std::vector<OtherType> Participant::other_types() {
  std::vector<OtherType> found;
  const std::lock_guard lock(impl_->mutex);
  for (const bool they_write : {true, false}) {
    constexpr std::uint32_t kMost = 32;
    std::array<void*, kMost> samples{};
    std::array<dds_sample_info_t, kMost> infos;
    const dds_entity_t reader = they_write ? impl_->publications : impl_->subscriptions;
    for (dds_return_t n; (n = dds_take(reader, samples.data(), infos.data(), kMost, kMost)) > 0;) {
      for (dds_return_t i = 0; i < n; ++i) {
        if (!infos[static_cast<std::size_t>(i)].valid_data) continue;
        const auto& endpoint =
            *static_cast<const dds_builtintopic_endpoint_t*>(samples[static_cast<std::size_t>(i)]);
        const auto ours = impl_->types.find(endpoint.topic_name);
        if (ours == impl_->types.end() || ours->second == endpoint.type_name) continue;
        const std::string key = std::string(endpoint.topic_name) + '\n' + endpoint.type_name;
        if (!impl_->told.insert(key).second) continue;
        found.push_back({ours->first.substr(2), ours->second, endpoint.type_name, they_write});
      }
      dds_return_loan(reader, samples.data(), n);
      samples.fill(nullptr);
    }
  }
  return found;
}

// ------------------------------------------------------------------ writer, reader

Writer::~Writer() {
  if (writer_ > 0) dds_delete(writer_);
  if (topic_ > 0) dds_delete(topic_);
}

bool Writer::send(ddsi_serdata* message) { return dds_writecdr(writer_, message) == DDS_RETCODE_OK; }

void Writer::drain(Duration most) { (void)dds_wait_for_acks(writer_, most.ns()); }

std::uint32_t Writer::peers() const {
  dds_publication_matched_status_t status{};
  return dds_get_publication_matched_status(writer_, &status) == DDS_RETCODE_OK ? status.current_count : 0;
}

Mismatch Writer::mismatch() const {
  dds_offered_incompatible_qos_status_t status{};
  if (dds_get_offered_incompatible_qos_status(writer_, &status) != DDS_RETCODE_OK) return {};
  return to_mismatch(status);
}

Reader::~Reader() {
  if (reader_ > 0) dds_delete(reader_);
  if (topic_ > 0) dds_delete(topic_);
}

ddsi_serdata* Reader::take() {
  while (true) {
    ddsi_serdata* message = nullptr;
    dds_sample_info_t info;
    if (dds_takecdr(reader_, &message, 1, &info, DDS_ANY_STATE) <= 0) return nullptr;
    if (info.valid_data) return message;
    ddsi_serdata_unref(message);  // a writer has gone
  }
}

void Reader::release(ddsi_serdata* message) { ddsi_serdata_unref(message); }

std::uint64_t Reader::lost() const {
  dds_sample_lost_status_t lost{};
  return dds_get_sample_lost_status(reader_, &lost) == DDS_RETCODE_OK ? lost.total_count : 0;
}

std::uint32_t Reader::peers() const {
  dds_subscription_matched_status_t status{};
  return dds_get_subscription_matched_status(reader_, &status) == DDS_RETCODE_OK ? status.current_count : 0;
}

Mismatch Reader::mismatch() const {
  dds_requested_incompatible_qos_status_t status{};
  if (dds_get_requested_incompatible_qos_status(reader_, &status) != DDS_RETCODE_OK) return {};
  return to_mismatch(status);
}

// Posted by the threads of Cyclone DDS whenever a reader has data.
struct Wake {
  sem_t semaphore{};
  Wake() { sem_init(&semaphore, 0, 0); }
  ~Wake() { sem_destroy(&semaphore); }
};

Waiter::Waiter() : wake_(std::make_shared<Wake>()) {}

void Waiter::add(Reader& reader) {
  reader.wake_ = wake_;
  dds_listener_t* listener = dds_create_listener(wake_.get());
  dds_lset_data_available(listener,
                          [](dds_entity_t, void* wake) { sem_post(&static_cast<Wake*>(wake)->semaphore); });
  dds_set_listener(reader.reader_, listener);
  dds_delete_listener(listener);
  sem_post(&wake_->semaphore);  // for what came before
}

void Waiter::wait(Duration most) {
  if (stopped_) return;
  timespec until{};
  clock_gettime(CLOCK_MONOTONIC, &until);
  const std::int64_t ns = until.tv_nsec + most.ns();
  until.tv_sec += ns / 1'000'000'000;
  until.tv_nsec = ns % 1'000'000'000;
  (void)sem_clockwait(&wake_->semaphore, CLOCK_MONOTONIC, &until);
}

void Waiter::stop() {
  stopped_ = true;
  sem_post(&wake_->semaphore);
}

}  // namespace rigor::ros2
