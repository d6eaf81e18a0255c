// A node over Fast DDS, for tests of the bridge: another implementation of DDS, which decodes the messages by
// Fast CDR, field by field, and knows nothing of Rigor.
//
//   fastdds_peer read DOMAIN QOS COUNT TOPIC TYPE [TOPIC TYPE …]     sensor_msgs/Image, PointCloud2, Imu,
//                                                                    std_msgs/Float64
//   fastdds_peer write DOMAIN QOS COUNT TOPIC TYPE                   geometry_msgs/Twist, std_msgs/Float64,
//                                                                    sensor_msgs/Imu
//
// QOS: reliable, best_effort. It says `matched TOPIC` when it has found the other side, `hash TOPIC …` with
// what the other side's USER_DATA says, and a line for each message. It ends when it has COUNT of each topic,
// or when a line comes on its standard input. A writer begins when the file FASTDDS_PEER_GO is there, if that
// is set.
#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <poll.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cinttypes>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/publisher/qos/DataWriterQos.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/subscriber/qos/DataReaderQos.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace fast = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;

namespace {

using Message = std::vector<char>;  ///< encoded, with the encapsulation

/// A type whose samples stay encoded.
class EncodedType final : public fast::TopicDataType {
 public:
  explicit EncodedType(const std::string& name) {
    setName(name.c_str());
    m_typeSize = 4u << 20;
    m_isGetKeyDefined = false;
  }
  bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
    const auto& message = *static_cast<Message*>(data);
    if (message.size() > payload->max_size) return false;
    std::memcpy(payload->data, message.data(), message.size());
    payload->length = static_cast<std::uint32_t>(message.size());
    payload->encapsulation = CDR_LE;
    return true;
  }
  bool deserialize(rtps::SerializedPayload_t* payload, void* data) override {
    const auto* bytes = reinterpret_cast<const char*>(payload->data);
    static_cast<Message*>(data)->assign(bytes, bytes + payload->length);
    return true;
  }
  std::function<std::uint32_t()> getSerializedSizeProvider(void* data) override {
    return [data] { return static_cast<std::uint32_t>(static_cast<Message*>(data)->size()); };
  }
  void* createData() override { return new Message; }
  void deleteData(void* data) override { delete static_cast<Message*>(data); }
  bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
};

std::mutex out_mutex;
template <class... Args>
void say(const char* format, Args... args) {
  const std::lock_guard<std::mutex> lock(out_mutex);
  std::printf(format, args...);
  std::fflush(stdout);
}

std::string dds_type(const std::string& type) {
  const std::size_t slash = type.find('/');
  return type.substr(0, slash) + "::msg::dds_::" + type.substr(slash + 1) + "_";
}

// ------------------------------------------------------------------ messages

struct Header {
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;
  std::string frame_id;
};
Header header(Cdr& cdr) {
  Header h;
  cdr >> h.sec >> h.nanosec >> h.frame_id;
  return h;
}

/// FNV-1a, so that a test knows that each byte came.
std::uint64_t digest(const std::vector<std::uint8_t>& bytes) {
  std::uint64_t hash = 14695981039346656037u;
  for (const std::uint8_t b : bytes) hash = (hash ^ b) * 1099511628211u;
  return hash;
}

void show(const std::string& topic, const std::string& type, Message& message) {
  FastBuffer buffer(message.data(), message.size());
  Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
  cdr.read_encapsulation();
  if (type == "sensor_msgs/Image") {
    const Header h = header(cdr);
    std::uint32_t height = 0, width = 0, step = 0;
    std::string encoding;
    std::uint8_t bigendian = 0;
    std::vector<std::uint8_t> data;
    cdr >> height >> width >> encoding >> bigendian >> step >> data;
    say("image %s %d.%09u %s %ux%u %s %u %zu %016" PRIx64 "\n", topic.c_str(), h.sec, h.nanosec,
        h.frame_id.c_str(), width, height, encoding.c_str(), step, data.size(), digest(data));
  } else if (type == "sensor_msgs/PointCloud2") {
    const Header h = header(cdr);
    std::uint32_t height = 0, width = 0, fields = 0, point_step = 0, row_step = 0;
    cdr >> height >> width >> fields;
    std::string names;
    for (std::uint32_t i = 0; i < fields; ++i) {
      std::string name;
      std::uint32_t offset = 0, count = 0;
      std::uint8_t datatype = 0;
      cdr >> name >> offset >> datatype >> count;
      names += (names.empty() ? "" : ",") + name;
    }
    bool bigendian = false, dense = false;
    std::vector<std::uint8_t> data;
    cdr >> bigendian >> point_step >> row_step >> data >> dense;
    say("cloud %s %d.%09u %s %u %s %u %zu %016" PRIx64 " %d\n", topic.c_str(), h.sec, h.nanosec,
        h.frame_id.c_str(), width * height, names.c_str(), point_step, data.size(), digest(data),
        dense ? 1 : 0);
  } else if (type == "sensor_msgs/Imu") {
    const Header h = header(cdr);
    std::array<double, 4> orientation{};
    std::array<double, 9> covariance{};
    std::array<double, 3> rate{}, force{};
    cdr >> orientation >> covariance >> rate >> covariance >> force;
    say("imu %s %d.%09u %s %g %g %g %g %g %g\n", topic.c_str(), h.sec, h.nanosec, h.frame_id.c_str(), rate[0],
        rate[1], rate[2], force[0], force[1], force[2]);
  } else if (type == "std_msgs/Float64") {
    double value = 0;
    cdr >> value;
    say("value %s %g\n", topic.c_str(), value);
  } else {
    say("unknown %s %s\n", topic.c_str(), type.c_str());
  }
}

Message make(const std::string& type, int n) {
  Message message(1024);
  FastBuffer buffer(message.data(), message.size());
  Cdr cdr(buffer, Cdr::LITTLE_ENDIANNESS, Cdr::DDS_CDR);
  cdr.serialize_encapsulation();
  const double v = n;
  if (type == "geometry_msgs/Twist") {
    cdr << v * 0.01 << 0.0 << 0.0 << 0.0 << 0.0 << -v;
  } else if (type == "std_msgs/Float64") {
    cdr << v;
  } else {
    timespec now{};
    clock_gettime(CLOCK_REALTIME, &now);
    cdr << static_cast<std::int32_t>(now.tv_sec) << static_cast<std::uint32_t>(now.tv_nsec)
        << std::string("imu_link");
    const std::array<double, 9> none{};
    cdr << std::array<double, 4>{0, 0, 0, 1} << none << std::array<double, 3>{0.1, 0.2, v} << none
        << std::array<double, 3>{v, 0, 9.81} << none;
  }
  message.resize(cdr.getSerializedDataLength());
  return message;
}

// ------------------------------------------------------------------ endpoints

struct Reader final : fast::DataReaderListener {
  std::string topic, type;
  std::atomic<int> got{0};
  void on_subscription_matched(fast::DataReader*, const fast::SubscriptionMatchedStatus& status) override {
    if (status.current_count_change > 0) say("matched %s\n", topic.c_str());
  }
  void on_requested_incompatible_qos(fast::DataReader*,
                                     const fast::RequestedIncompatibleQosStatus& status) override {
    say("incompatible %s policy %d\n", topic.c_str(), static_cast<int>(status.last_policy_id));
  }
  void on_data_available(fast::DataReader* reader) override {
    Message message;
    fast::SampleInfo info;
    while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      try {
        show(topic, type, message);
      } catch (const std::exception& e) {
        say("malformed %s %zu bytes: %s\n", topic.c_str(), message.size(), e.what());
      }
      ++got;
    }
  }
};

struct Writer final : fast::DataWriterListener {
  std::atomic<int> matched{0};
  void on_publication_matched(fast::DataWriter*, const fast::PublicationMatchedStatus& status) override {
    matched = status.current_count;
  }
};

struct Discovery final : fast::DomainParticipantListener {
  void on_publisher_discovery(fast::DomainParticipant*, rtps::WriterDiscoveryInfo&& info) override {
    const auto& data = info.info.m_qos.m_userData;
    if (info.status == rtps::WriterDiscoveryInfo::DISCOVERED_WRITER && !data.empty())
      say("hash %s %s\n", info.info.topicName().c_str(), std::string(data.begin(), data.end()).c_str());
  }
};

/// Somebody wrote a line, or closed it.
bool told_to_end() {
  pollfd p{STDIN_FILENO, POLLIN, 0};
  return poll(&p, 1, 10) > 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 7) return 2;
  const std::string mode = argv[1], qos_name = argv[3];
  const int count = std::atoi(argv[4]);
  Discovery discovery;
  // With what FASTRTPS_DEFAULT_PROFILES_FILE names, as nodes of rmw_fastrtps do.
  auto* factory = fast::DomainParticipantFactory::get_instance();
  factory->load_profiles();
  fast::DomainParticipantQos participant_qos = factory->get_default_participant_qos();
  participant_qos.name("fastdds_peer");
  fast::DomainParticipant* participant =
      factory->create_participant(static_cast<fast::DomainId_t>(std::atoi(argv[2])), participant_qos,
                                  &discovery, fast::StatusMask::none());
  if (!participant) return 1;
  const auto reliability =
      qos_name == "reliable" ? fast::RELIABLE_RELIABILITY_QOS : fast::BEST_EFFORT_RELIABILITY_QOS;
  const auto topic_of = [&](const std::string& name, const std::string& type) {
    const std::string type_name = dds_type(type);
    fast::TypeSupport support(new EncodedType(type_name));
    support.register_type(participant);
    return participant->create_topic("rt" + name, type_name, fast::TOPIC_QOS_DEFAULT);
  };
  int status = 0;
  if (mode == "read") {
    std::vector<std::unique_ptr<Reader>> readers;
    fast::Subscriber* subscriber = participant->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT);
    for (int i = 5; i + 1 < argc; i += 2) {
      auto reader = std::make_unique<Reader>();
      reader->topic = argv[i];
      reader->type = argv[i + 1];
      fast::DataReaderQos qos = fast::DATAREADER_QOS_DEFAULT;
      qos.reliability().kind = reliability;
      qos.durability().kind = fast::VOLATILE_DURABILITY_QOS;
      qos.history().kind = fast::KEEP_LAST_HISTORY_QOS;
      qos.history().depth = 1000;
      qos.endpoint().history_memory_policy = rtps::DYNAMIC_RESERVE_MEMORY_MODE;
      if (!subscriber->create_datareader(topic_of(argv[i], argv[i + 1]), qos, reader.get())) return 1;
      readers.push_back(std::move(reader));
    }
    const auto all = [&] {
      for (const auto& reader : readers)
        if (reader->got < count) return false;
      return true;
    };
    while (!all() && !told_to_end()) {
    }
    for (const auto& reader : readers) say("got %s %d\n", reader->topic.c_str(), reader->got.load());
    status = all() ? 0 : 1;
  } else {
    Writer listener;
    fast::Publisher* publisher = participant->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
    fast::DataWriterQos qos = fast::DATAWRITER_QOS_DEFAULT;
    qos.reliability().kind = reliability;
    qos.durability().kind = fast::VOLATILE_DURABILITY_QOS;
    qos.history().kind = fast::KEEP_ALL_HISTORY_QOS;
    qos.endpoint().history_memory_policy = rtps::DYNAMIC_RESERVE_MEMORY_MODE;
    fast::DataWriter* writer = publisher->create_datawriter(topic_of(argv[5], argv[6]), qos, &listener);
    if (!writer) return 1;
    while (listener.matched == 0 && !told_to_end()) {
    }
    say("matched %s\n", argv[5]);
    // The other side may learn of this one later: it says when it has.
    if (const char* go = std::getenv("FASTDDS_PEER_GO"))
      while (access(go, F_OK) != 0 && !told_to_end()) {
      }
    int sent = 0;
    for (; sent < count && !(count > 100000 && told_to_end()); ++sent) {
      Message message = make(argv[6], sent);
      if (!writer->write(&message)) break;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    const bool known = writer->wait_for_acknowledgments({5, 0}) == ReturnCode_t::RETCODE_OK;
    say("sent %d %s\n", sent, known ? "acknowledged" : "unacknowledged");
    while (!told_to_end()) {
    }
  }
  participant->delete_contained_entities();
  factory->delete_participant(participant);
  return status;
}
