#include "python/application.h"

#include <utility>

namespace rigor::python {
namespace {

namespace py = pybind11;

class Handler final : public application::TurnHandler {
 public:
  explicit Handler(std::shared_ptr<ApplicationCalls> calls) : calls_(std::move(calls)) {}
  Result<std::string> start(const std::string& setup) override { return calls_->start(setup); }
  std::optional<std::span<const std::byte>> turn(std::span<const std::byte> body) noexcept override {
    return calls_->turn(body);
  }
  Status finish() override { return calls_->finish(); }

 private:
  std::shared_ptr<ApplicationCalls> calls_;  // the rig holds it, too, and ends it with the GIL
};

}  // namespace

std::unique_ptr<application::TurnHandler> python_handler(std::shared_ptr<ApplicationCalls> calls) {
  return std::make_unique<Handler>(std::move(calls));
}

void ApplicationCalls::keep_exception() {
  raised_ = std::current_exception();
  try {
    throw;
  } catch (const std::exception& e) {
    said_ = e.what();
  } catch (...) {
    said_ = "an unknown exception";
  }
}

void ApplicationCalls::rethrow() {
  if (raised_) std::rethrow_exception(std::exchange(raised_, nullptr));
}

Result<std::string> ApplicationCalls::start(const std::string& setup) {
  const py::gil_scoped_acquire gil;
  try {
    return called_.attr("start")(setup).cast<std::string>();
  } catch (...) {
    keep_exception();
    return fail(ErrorCode::unavailable, "", "the application says: " + said_);
  }
}

std::optional<std::span<const std::byte>> ApplicationCalls::turn(std::span<const std::byte> body) noexcept {
  const py::gil_scoped_acquire gil;
  try {
    // Ctrl-C ends the run as what the application raises does.
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    answer_ =
        called_.attr("turn")(py::memoryview::from_memory(body.data(), static_cast<py::ssize_t>(body.size())));
    const std::string_view bytes = answer_;
    return std::as_bytes(std::span<const char>(bytes.data(), bytes.size()));
  } catch (...) {
    keep_exception();
    return std::nullopt;
  }
}

Status ApplicationCalls::finish() {
  const py::gil_scoped_acquire gil;
  if (raised_ || !said_.empty()) return fail(ErrorCode::unavailable, "", "the application says: " + said_);
  try {
    called_.attr("finish")();
    return {};
  } catch (...) {
    keep_exception();
    return fail(ErrorCode::unavailable, "", "the application says: " + said_);
  }
}

}  // namespace rigor::python
