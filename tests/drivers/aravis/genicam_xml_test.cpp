// The description of an emulated camera is XML whatever a rig calls the camera.
#include "drivers/aravis/gige_genicam_xml.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <string_view>
#include <vector>

#include "rt-core/device_text.h"

namespace rigor::gige {
namespace {

/// Elements that close, attributes in quotes, entities that XML has, no character that it has not. Empty:
/// good.
std::string fault_of(std::string_view xml) {
  std::vector<std::string_view> open;
  if (!xml.starts_with("<?xml ")) return "no declaration";
  std::size_t at = xml.find("?>") + 2;
  while (at < xml.size()) {
    if (xml[at] == '&') {
      const auto entity = xml.substr(at, xml.find(';', at) - at + 1);
      if (entity != "&amp;" && entity != "&lt;" && entity != "&gt;" && entity != "&quot;")
        return "entity " + std::string(entity.substr(0, 10));
    }
    if (xml[at++] != '<') continue;
    const std::size_t end = xml.find('>', at);
    if (end == std::string_view::npos) return "a tag does not end";
    const std::string_view tag = xml.substr(at, end - at);
    if (std::count(tag.begin(), tag.end(), '"') % 2 != 0 || tag.find('<') != std::string_view::npos)
      return "tag " + std::string(tag);
    if (!tag.starts_with('/')) {
      open.push_back(tag.substr(0, tag.find(' ')));
    } else {
      if (open.empty() || open.back() != tag.substr(1)) return "end of " + std::string(tag.substr(1));
      open.pop_back();
    }
    at = end + 1;
  }
  if (!open.empty()) return "no end of " + std::string(open.back());
  std::string lines(xml);
  std::replace(lines.begin(), lines.end(), '\n', ' ');
  return device_text(lines) == lines ? "" : "a character that XML has not";
}

// Seen to fail with bytes that are no UTF-8 handed through as they are.
TEST(GenicamXml, IsWellFormedWhateverTheCamerasNames) {
  std::mt19937 random(1);
  GigeCameraConfig config;
  for (int n = 0; n < 300; ++n) {
    for (std::string* name : {&config.vendor, &config.model}) {
      name->resize(random() % 20);
      for (char& c : *name) c = static_cast<char>(random() % 4 == 0 ? "<>&\"'/ ;"[random() % 8] : random());
    }
    config.ptp.present = n % 2 == 0;
    const std::string xml = make_genicam_xml(config, GigeDeviceModel::registers(config));
    ASSERT_EQ(fault_of(xml), "") << "names " << testing::PrintToString(config.vendor) << " and "
                                 << testing::PrintToString(config.model);
    ASSERT_EQ(xml.size() % 4, 0u);
  }
}

}  // namespace
}  // namespace rigor::gige
