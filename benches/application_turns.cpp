// An application that does next to nothing, for benches/application_process.py: what is measured is the way
// to it.
#include "clients/cpp/rigor_client.h"

namespace {

class Turns : public rigor_client::Application {
 public:
  void step(rigor_client::Turn& turn) override {
    n_ += static_cast<double>(turn["imu"].samples.size());
    const rigor_client::Port& camera = turn["camera"];
    if (camera.fresh()) n_ += static_cast<double>(camera.sample().bytes[camera.sample().bytes.size() / 2]);
    turn.command("out", {n_});
  }

 private:
  double n_ = 0;
};

}  // namespace

RIGOR_APPLICATION(Turns)
