#include "bridges/ros2/settings.h"

namespace rigor::ros2 {

DomainSettings read_domain(const ConfigNode& n) {
  DomainSettings d;
  // Ports of domains above 232 would be beyond 65535 (DDSI-RTPS 2.5, 9.6.1).
  d.domain = static_cast<std::uint32_t>(n.integer_or("domain", 0, {.min = 0, .max = 232}));
  d.interface = n.text_or("interface", d.interface);
  if (d.interface.empty())
    throw n.error("interface", "expected an interface of the network by name or address, or auto, got none");
  for (const ConfigNode& peer : n.list_or_empty("peers")) d.peers.push_back(peer.as_text());
  return d;
}

Qos read_qos(const ConfigNode& n, Qos fallback) {
  if (n.has("qos")) fallback = {qos_profile(n.choice("qos", qos_names())), 0};
  fallback.depth = static_cast<int>(n.integer_or("depth", fallback.depth, {.min = 0, .max = 10000}));
  (void)n.choice_or("qos", qos_names(), qos_names().front());  // known to finish()
  return fallback;
}

void check_topic(const ConfigNode& n, std::string_view key, const std::string& topic) {
  bool good = topic.size() > 1 && topic.size() < 250 && topic.front() == '/' && topic.back() != '/';
  for (std::size_t i = 0; good && i < topic.size(); ++i) {
    const char c = topic[i];
    const bool letter = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
    const bool digit = c >= '0' && c <= '9';
    good = letter || (c == '/' ? topic[i + 1] != '/' : digit && topic[i - 1] != '/');
  }
  if (!good)
    throw n.error(
        key, "expected a topic of ROS 2 such as /camera/image_raw (letters, digits, `_` and `/`), got \"" +
                 topic + "\"");
}

}  // namespace rigor::ros2
