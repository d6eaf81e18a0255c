// Messages as Cyclone DDS takes and gives them.
#include "bridges/ros2/payload.h"

#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <dds/ddsi/ddsi_sertype.h>
#include <gmock/gmock.h>

#include <cstring>
#include <thread>

#include "bridges/ros2/participant.h"
#include "tests/bridges/ros2/network.h"

namespace rigor::ros2 {
namespace {

using record::Bytes;

std::vector<std::byte> counted(std::size_t n, unsigned first) {
  std::vector<std::byte> bytes(n);
  for (std::size_t i = 0; i < n; ++i) bytes[i] = static_cast<std::byte>(first + i * 31);
  return bytes;
}

struct PayloadTest : ::testing::Test {
  ddsi_sertype* type = make_type("p::msg::dds_::T_");
  Borrowed borrowed = std::make_shared<std::atomic<std::uint32_t>>(0);
  std::unique_ptr<SamplePool> pool = make_sample_pool(1, 5000);
  ~PayloadTest() override { ddsi_sertype_unref(type); }

  /// A sample whose 5000 bytes are known.
  SampleLease sample() {
    SampleSlot slot = pool->try_acquire();
    EXPECT_TRUE(slot);
    const auto bytes = counted(5000, 77);
    std::copy(bytes.begin(), bytes.end(), slot->memory().begin());
    slot->size_bytes = bytes.size();
    return slot;
  }
};

TEST_F(PayloadTest, EachRangeOfAMessageInPiecesIsItsBytes) {
  for (const std::size_t tail_bytes : {0u, 1u, 2u, 7u}) {
    const SampleLease lease = sample();
    const auto head = counted(61, 1), tail = counted(tail_bytes, 200);
    const std::array<Bytes, 3> pieces{head, lease->bytes(), tail};
    std::vector<std::byte> all(head);
    all.insert(all.end(), lease->bytes().begin(), lease->bytes().end());
    all.insert(all.end(), tail.begin(), tail.end());
    const std::size_t padded = (all.size() + 3) / 4 * 4;
    ddsi_serdata* message = make_message(type, pieces, lease, borrowed);
    EXPECT_EQ(borrowed->load(), 1u);
    ASSERT_EQ(ddsi_serdata_size(message), all.size());
    all.resize(padded);  // DDS may ask for the padding

    std::size_t in_place = 0, ranges = 0;
    for (std::size_t offset = 0; offset < padded; offset += 1344) {
      const std::size_t n = std::min<std::size_t>(1344, padded - offset);
      ddsrt_iovec_t part;
      ddsi_serdata* reference = ddsi_serdata_to_ser_ref(message, offset, n, &part);
      ASSERT_EQ(part.iov_len, n);
      EXPECT_EQ(std::memcmp(part.iov_base, all.data() + offset, n), 0) << offset;
      const auto* at = static_cast<const std::byte*>(part.iov_base);
      in_place += at >= lease->bytes().data() && at + n <= lease->bytes().data() + 5000;
      ++ranges;
      ddsi_serdata_to_ser_unref(reference, &part);
    }
    EXPECT_GE(in_place + 2, ranges) << "at most the fragments over a boundary are joined";
    for (const std::size_t offset : {0u, 59u, 61u, 62u, 5060u, 5061u})
      for (std::size_t n = 1; n < 8 && offset + n <= padded; ++n) {
        std::vector<std::byte> copy(n);
        ddsi_serdata_to_ser(message, offset, n, copy.data());
        EXPECT_EQ(std::memcmp(copy.data(), all.data() + offset, n), 0) << offset << " " << n;
      }
    ddsi_serdata_unref(message);
    EXPECT_EQ(borrowed->load(), 0u);
  }
}

TEST_F(PayloadTest, TheLeaseOfASampleEndsWithTheMessage) {
  SampleLease lease = sample();
  const std::array<Bytes, 1> pieces{lease->bytes()};
  ddsi_serdata* message = make_message(type, pieces, lease, borrowed);
  lease.reset();
  EXPECT_EQ(pool->in_use(), 1u) << "the message still needs the slot";
  ddsi_serdata* second = ddsi_serdata_ref(message);
  ddsi_serdata_unref(message);
  EXPECT_EQ(pool->in_use(), 1u);
  ddsi_serdata_unref(second);
  EXPECT_EQ(pool->in_use(), 0u);
  EXPECT_EQ(borrowed->load(), 0u);
}

TEST_F(PayloadTest, WithoutALeaseItsBytesAreItsOwn) {
  auto bytes = counted(100, 3);
  const std::array<Bytes, 2> pieces{Bytes(bytes).first(40), Bytes(bytes).subspan(40)};
  ddsi_serdata* message = make_message(type, pieces, {}, borrowed);
  const auto before = bytes;
  std::fill(bytes.begin(), bytes.end(), std::byte{0});
  std::vector<std::byte> joined;
  EXPECT_THAT(bytes_of(message, joined), ::testing::ElementsAreArray(before));
  EXPECT_EQ(borrowed->load(), 0u);
  ddsi_serdata_unref(message);
}

TEST_F(PayloadTest, PartsThatComeInAreJoined) {
  auto bytes = counted(3001, 9);
  const std::array<ddsrt_iovec_t, 3> parts{
      {{bytes.data(), 1344}, {bytes.data() + 1344, 1344}, {bytes.data() + 2688, 313}}};
  ddsi_serdata* message = ddsi_serdata_from_ser_iov(type, SDK_DATA, 3, parts.data(), bytes.size());
  std::vector<std::byte> joined;
  EXPECT_THAT(bytes_of(message, joined), ::testing::ElementsAreArray(bytes));
  ddsi_serdata_unref(message);
}

/// A bare program of Cyclone DDS, with a type and a participant of its own, as the other side.
TEST(Participant, ExchangesMessagesWithWhoeverHasTheSameTopicAndType) {
  const DomainSettings settings{.domain = test::free_domain()};
  auto ours = Participant::open(settings);
  ASSERT_TRUE(ours) << ours.error().text();
  const MessageType type{"std_msgs/msg/Float64", "float64 data\n"};
  auto writer = (*ours)->write("/value", type, {Qos::Profile::reliable, 0});
  ASSERT_TRUE(writer) << writer.error().text();

  const dds_entity_t theirs = dds_create_participant(settings.domain, nullptr, nullptr);
  ASSERT_GT(theirs, 0);
  ddsi_sertype* sertype = make_type("std_msgs::msg::dds_::Float64_");
  const dds_entity_t topic =
      dds_create_topic_sertype(theirs, "rt/value", &sertype, nullptr, nullptr, nullptr);
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, 0);
  dds_qset_history(qos, DDS_HISTORY_KEEP_ALL, 0);
  const dds_entity_t reader = dds_create_reader(theirs, topic, qos, nullptr);
  ASSERT_GT(reader, 0);
  ASSERT_TRUE(test::holds_soon([&] { return (*writer)->peers() > 0; })) << "no reader was found";

  for (unsigned i = 0; i < 100; ++i) {
    std::array<std::byte, 12> bytes{std::byte{0}, std::byte{1}};
    const double value = i;
    std::memcpy(bytes.data() + 4, &value, 8);
    const Bytes piece(bytes);
    ASSERT_TRUE((*writer)->send(make_message((*writer)->type(), record::Pieces(&piece, 1), {}, {})));
  }
  for (unsigned i = 0; i < 100; ++i) {
    ddsi_serdata* message = nullptr;
    dds_sample_info_t info;
    ASSERT_EQ(dds_takecdr(reader, &message, 1, &info, DDS_ANY_STATE), 1) << i;
    double value = -1;
    std::vector<std::byte> joined;
    ASSERT_EQ(bytes_of(message, joined).size(), 12u);
    std::memcpy(&value, bytes_of(message, joined).data() + 4, 8);
    EXPECT_EQ(value, i);
    ddsi_serdata_unref(message);
  }
  // The hash of the type, as ROS 2 writes it, among what the other side learns of the writer.
  const dds_entity_t publications =
      dds_create_reader(theirs, DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr, nullptr);
  std::string user_data;
  for (void* sample = nullptr; user_data.empty(); sample = nullptr) {
    dds_sample_info_t info;
    if (dds_take(publications, &sample, &info, 1, 1) <= 0) break;
    const auto& endpoint = *static_cast<const dds_builtintopic_endpoint_t*>(sample);
    void* data = nullptr;
    std::size_t size = 0;
    if (info.valid_data && std::string(endpoint.topic_name) == "rt/value" &&
        dds_qget_userdata(endpoint.qos, &data, &size)) {
      user_data.assign(static_cast<const char*>(data), size);
      dds_free(data);
    }
    dds_return_loan(publications, &sample, 1);
  }
  EXPECT_EQ(user_data, "typehash=RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a;");
  dds_delete_qos(qos);
  dds_delete(theirs);
}

TEST(Participant, OneDomainHasOneInterfaceInAProcess) {
  const std::uint32_t domain = test::free_domain();
  const auto first = Participant::open({.domain = domain});
  ASSERT_TRUE(first);
  const auto again = Participant::open({.domain = domain});
  ASSERT_TRUE(again);
  EXPECT_EQ(first->get(), again->get());
  const auto other = Participant::open({.domain = domain, .interface = "auto"});
  ASSERT_FALSE(other);
  EXPECT_THAT(other.error().message, ::testing::HasSubstr("got the interfaces lo and auto"));
}

TEST(Participant, AnInterfaceThatIsNotThereIsAnErrorThatNamesIt) {
  const auto none = Participant::open({.domain = test::free_domain(), .interface = "no0such"});
  ASSERT_FALSE(none);
  EXPECT_THAT(none.error().message, ::testing::HasSubstr("expected to join it on the interface no0such"));
  // And the domain is free again.
  EXPECT_TRUE(Participant::open({.domain = test::free_domain()}));
}

}  // namespace
}  // namespace rigor::ros2
