#include "bench/dataset/fill_dataset.h"

#include <fmt/format.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <thread>

#include "bench/console/progress.h"

namespace rigor {
namespace {

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

/// Writes one sample while the next one is measured. With `beside` false on the caller's thread.
class Writer {
 public:
  Writer(DatasetOutput& output, bool beside) : output_(output) {
    if (beside) thread_ = std::thread([this] { run(); });
  }
  ~Writer() { (void)finish(); }
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  /// Waits while the one before is being written; its error.
  Status put(DatasetSample sample) {
    if (!thread_.joinable()) return write(sample);
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return !waiting_; });
    if (error_) return tl::unexpected<Error>(*error_);
    waiting_ = std::move(sample);
    changed_.notify_all();
    return {};
  }
  Status finish() {
    if (thread_.joinable()) {
      {
        const std::lock_guard lock(mutex_);
        ended_ = true;
        changed_.notify_all();
      }
      thread_.join();
    }
    if (error_) return tl::unexpected<Error>(*error_);
    return {};
  }
  [[nodiscard]] double spent_s() const { return spent_s_; }         ///< after finish()
  [[nodiscard]] std::uint64_t written() const { return written_; }  ///< after finish()

 private:
  Status write(const DatasetSample& sample) {
    const auto begin = Clock::now();
    auto written = output_.write(sample);
    spent_s_ += seconds_since(begin);
    if (written) ++written_;
    return written;
  }
  void run() {
    std::unique_lock lock(mutex_);
    while (true) {
      changed_.wait(lock, [this] { return waiting_ || ended_; });
      if (!waiting_) return;
      lock.unlock();
      const Status written = error_ ? Status{} : write(*waiting_);
      lock.lock();
      if (!written) error_ = written.error();
      waiting_.reset();
      changed_.notify_all();
    }
  }

  DatasetOutput& output_;
  double spent_s_ = 0;
  std::uint64_t written_ = 0;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<DatasetSample> waiting_;  ///< until it is written
  std::optional<Error> error_;
  bool ended_ = false;
  std::thread thread_;
};

}  // namespace

Result<Filled> fill_dataset(Dataset& dataset, DatasetOutput& output, const FillOptions& options) {
  const auto begin = Clock::now();
  Filled filled;
  std::vector<std::uint64_t> wanted;
  const auto want = [&](std::uint64_t first, std::uint64_t last) {
    for (std::uint64_t i = first; i <= last && i < dataset.size(); ++i) {
      if (output.has(i))
        ++filled.there;
      else
        wanted.push_back(i);
    }
  };
  if (options.only.empty()) want(0, dataset.size() - 1);
  for (const auto& [first, last] : options.only) want(first, last);
  std::sort(wanted.begin(), wanted.end());
  wanted.erase(std::unique(wanted.begin(), wanted.end()), wanted.end());

  std::optional<tbb::global_control> limit;
  if (options.threads > 0)
    limit.emplace(tbb::global_control::max_allowed_parallelism, static_cast<std::size_t>(options.threads));
  Writer writer(output, options.threads != 1);
  ProgressTask progress("dataset", static_cast<double>(wanted.size()), "samples");
  const auto stopped = [&](Error e) {
    (void)writer.finish();
    e.message += fmt::format("; {} samples are whole, and the same command goes on from there",
                             filled.there + writer.written());
    return tl::unexpected<Error>(std::move(e));
  };
  for (const std::uint64_t index : wanted) {
    if (options.stop.stop_requested()) break;
    auto sample = dataset.sample(index);
    if (!sample) return stopped(sample.error());
    if (auto s = writer.put(std::move(*sample)); !s) return stopped(s.error());
    ++filled.made;
    progress.set(static_cast<double>(filled.made));
  }
  if (auto s = writer.finish(); !s) return stopped(s.error());
  progress.finish();
  auto summary = output.finish();
  if (!summary) return tl::unexpected<Error>(summary.error());
  filled.summary = std::move(*summary);
  filled.write_s = writer.spent_s();
  filled.whole_s = seconds_since(begin);
  filled.times = dataset.times();
  return filled;
}

}  // namespace rigor
