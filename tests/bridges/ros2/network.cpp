#include "tests/bridges/ros2/network.h"

#include <gtest/gtest.h>
#include <net/if.h>
#include <sched.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstring>

namespace rigor::test {
namespace {

bool has_own_network = false;

class OwnNetwork final : public ::testing::Environment {
 public:
  /// Before any thread is started: a namespace belongs to the thread that asked for it and to its children.
  void SetUp() override {
    if (unshare(CLONE_NEWNET) != 0) return;
    const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (fd < 0) return;
    ifreq request{};
    std::strcpy(request.ifr_name, "lo");
    request.ifr_flags = IFF_UP | IFF_LOOPBACK | IFF_RUNNING;
    has_own_network = ioctl(fd, SIOCSIFFLAGS, &request) == 0;
    close(fd);
  }
};

const auto* const environment = ::testing::AddGlobalTestEnvironment(new OwnNetwork);

}  // namespace

bool own_network() { return has_own_network; }

std::uint32_t free_domain() { return has_own_network ? 0 : 1 + static_cast<std::uint32_t>(getpid()) % 100; }

}  // namespace rigor::test
