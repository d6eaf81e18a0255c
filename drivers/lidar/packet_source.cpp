#include "drivers/lidar/packet_source.h"

#include <pthread.h>

namespace rigor::packet_lidar {
namespace {

constexpr Duration kSilence = seconds(1);

}  // namespace

Status PacketSource::do_arm(const ArmContext& context) {
  warnings_.clear();
  feed_.reset();
  foreign_ = 0;
  if (auto s = deadline_.open(); !s) return s;
  deadline_.reset();
  if (requires_wall_clock()) {
    auto s = arm_network();
    if (s) return s;
    leave_network();
    health_.connected = false;
    if (s.error().where == config().name) return s;
    return fail(s.error().code, config().name, s.error().text());
  }
  const Feed feed = context.virtual_time ? Feed::virtual_time : Feed::recording;
  if (auto s = arm_file(feed); !s) return s;
  health_.connected = true;
  if (feed == Feed::recording)
    thread_ = std::thread([this] {
      pthread_setname_np(pthread_self(), (std::string(driver_name()) + "-file").c_str());
      const auto take_one = [this](Bytes datagram, BenchTime due) {
        take(datagram, due);
        publish();
      };
      if (feed_->play(origin(), deadline_, take_one)) end_of_recording();
    });
  return {};
}

Status PacketSource::do_start(BenchTime t0) {
  t0_ = t0;
  // Of a recording; its thread waits for the origin, which is published after this.
  if (feed_) set_epoch({t0, feed_->first_stamp(), Duration(0)});
  return {};
}

Status PacketSource::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  leave_network();
  feed_.reset();
  close_stream();
  health_.connected = false;
  return {};
}

Status PacketSource::open_recording(const std::filesystem::path& file, network::PcapFeed::Wanted wanted) {
  auto feed = network::PcapFeed::open(file, std::move(wanted));
  if (!feed) return fail(feed.error().code, config().name, feed.error().text());
  feed_.emplace(std::move(*feed));
  return {};
}

void PacketSource::complete_until(BenchTime now) {
  if (!feed_) return;
  // On until a sample is there that is not released yet: what is released later was captured later.
  const auto more = [this, now] { return !handed_past(now); };
  if (feed_->play_while(more, t0_, [this](Bytes datagram, BenchTime due) { take(datagram, due); }))
    end_of_recording();
  publish();
}

void PacketSource::end_of_recording() {
  on_end_of_recording();
  if (feed_->broken()) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  health_.connected.store(false, std::memory_order_release);
  publish();
}

void PacketSource::begin_listening() {
  t_last_packet_ = t_last_datagram_ = bench_now();
  health_.connected = true;
}

void PacketSource::warn_of_small_buffer(std::int64_t granted_bytes, std::int64_t asked_bytes) {
  if (granted_bytes < asked_bytes)
    warnings_.push_back("the kernel grants " + std::to_string(granted_bytes / 1024) + " KiB of the " +
                        std::to_string(asked_bytes / 1024) +
                        " KiB asked for: `rigor doctor` says how to have more");
}

void PacketSource::receive(std::span<const network::UdpReceiver::Datagram> batch) {
  for (const auto& d : batch) {
    t_last_datagram_ = d.arrival;
    if (device_ipv4_ != 0 && d.source_ipv4 != device_ipv4_) {
      ++foreign_;
      continue;
    }
    const std::uint64_t before = good_packets();
    take(d.bytes, d.arrival);
    if (good_packets() == before) continue;
    t_last_packet_ = d.arrival;
    if (!health_.connected.load(std::memory_order_relaxed)) {
      health_.connected.store(true, std::memory_order_release);
      health_.reconnects.fetch_add(1, std::memory_order_relaxed);
      on_return();
    }
  }
  publish();
}

bool PacketSource::watch_silence() {
  const bool silent = bench_now() - t_last_packet_ > kSilence;
  if (silent) health_.connected.store(false, std::memory_order_release);
  return silent;
}

bool PacketSource::hears_nobody() const { return bench_now() - t_last_datagram_ > kSilence; }

}  // namespace rigor::packet_lidar
