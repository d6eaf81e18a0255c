#include "drivers/aravis/u3v_genicam_xml.h"

#include <cctype>
#include <cstdio>
#include <initializer_list>
#include <locale>
#include <sstream>
#include <utility>
#include <vector>

#include "drivers/aravis/u3v_registers.h"
#include "rt-core/device_text.h"

namespace rigor::u3v {
namespace {

std::string hexadecimal(std::uint64_t v) {
  char text[24];
  std::snprintf(text, sizeof text, "0x%llX", static_cast<unsigned long long>(v));
  return text;
}

std::string decimal(double v) {
  std::ostringstream s;
  s.imbue(std::locale::classic());
  s.precision(17);
  s << v;
  return s.str();
}

/// In an attribute of names: letters, digits and underscores.
std::string xml_name(const std::string& text) {
  std::string out;
  for (const char c : device_text(text))
    out += std::isalnum(static_cast<unsigned char>(c)) != 0 && static_cast<unsigned char>(c) < 128 ? c : '_';
  return out.empty() ? "Camera" : out;
}

using Entry = std::pair<std::string, std::uint32_t>;

/// Collects nodes; a feature and its register are made by one call.
class Description {
 public:
  [[nodiscard]] const std::string& text() const { return text_; }
  void add(const std::string& line) { text_ += line + "\n"; }

  void category(const std::string& name, std::initializer_list<const char*> features) {
    add("<Category Name=\"" + name + "\" NameSpace=\"Standard\">");
    for (const char* f : features) leaf("pFeature", f);
    add("</Category>");
  }
  void text_feature(const std::string& name, reg::Address address, bool writable) {
    begin("StringReg", name);
    leaf("Address", hexadecimal(address));
    leaf("Length", std::to_string(reg::kTextBytes));
    leaf("AccessMode", writable ? "RW" : "RO");
    leaf("pPort", "Device");
    add("</StringReg>");
  }
  /// `limits`: the nodes of its range.
  void integer(const std::string& name, reg::Address address, const char* access,
               const std::string& limits = "", std::size_t bytes = 4) {
    begin("Integer", name);
    leaf("pValue", name + "Reg");
    text_ += limits;
    add("</Integer>");
    int_register(name, address, access, bytes);
  }
  void real(const std::string& name, reg::Address address, const char* unit, double min, double max,
            const char* access = "RW") {
    begin("Float", name);
    leaf("pValue", name + "Reg");
    if (max > min) {
      leaf("Min", decimal(min));
      leaf("Max", decimal(max));
    }
    leaf("Unit", unit);
    add("</Float>");
    add("<FloatReg Name=\"" + name + "Reg\">");
    place(address, 8, access);
    leaf("Endianess", "LittleEndian");
    add("</FloatReg>");
  }
  void enumeration(const std::string& name, reg::Address address, const std::vector<Entry>& entries,
                   bool lockable = false, const char* access = "RW") {
    begin("Enumeration", name);
    if (lockable) leaf("pIsLocked", "TLParamsLocked");
    for (const auto& [entry, value] : entries)
      add("<EnumEntry Name=\"" + entry + "\" NameSpace=\"Standard\"><Value>" + std::to_string(value) +
          "</Value></EnumEntry>");
    leaf("pValue", name + "Reg");
    add("</Enumeration>");
    int_register(name, address, access);
  }
  /// An enumeration that has one value.
  void fixed(const std::string& name, const std::string& entry) {
    begin("Enumeration", name);
    add("<EnumEntry Name=\"" + entry + "\" NameSpace=\"Standard\"><Value>0</Value></EnumEntry>");
    leaf("Value", "0");
    add("</Enumeration>");
  }
  void boolean(const std::string& name, reg::Address address, const char* access = "RW") {
    begin("Boolean", name);
    leaf("pValue", name + "Reg");
    leaf("OnValue", "1");
    leaf("OffValue", "0");
    add("</Boolean>");
    int_register(name, address, access);
  }
  void command(const std::string& name, reg::Address address, const char* access = "RW") {
    begin("Command", name);
    leaf("pValue", name + "Reg");
    leaf("CommandValue", "1");
    add("</Command>");
    int_register(name, address, access);
  }
  /// A side of the region: it may use what the other one leaves of the sensor.
  void side(const std::string& name, reg::Address address, std::uint32_t min, std::uint32_t step,
            const std::string& whole, const std::string& other) {
    begin("Integer", name);
    leaf("pIsLocked", "TLParamsLocked");
    leaf("pValue", name + "Reg");
    leaf("Min", std::to_string(min));
    leaf("pMax", name + "Room");
    leaf("Inc", std::to_string(step));
    leaf("Unit", "px");
    add("</Integer>");
    int_register(name, address, "RW");
    add("<IntSwissKnife Name=\"" + name + "Room\">");
    add("<pVariable Name=\"WHOLE\">" + whole + "Reg</pVariable>");
    add("<pVariable Name=\"USED\">" + other + "Reg</pVariable>");
    const std::string s = std::to_string(step);
    leaf("Formula", "((WHOLE - USED) / " + s + ") * " + s);
    add("</IntSwissKnife>");
  }
  [[nodiscard]] static std::string element(const char* name, const std::string& value) {
    return std::string("<") + name + ">" + value + "</" + name + ">\n";
  }

 private:
  void begin(const char* kind, const std::string& name) {
    add(std::string("<") + kind + " Name=\"" + name + "\" NameSpace=\"Standard\">");
  }
  void leaf(const char* name, const std::string& value) { text_ += element(name, value); }
  void place(reg::Address address, std::size_t bytes, const char* access) {
    leaf("Address", hexadecimal(address));
    leaf("Length", std::to_string(bytes));
    leaf("AccessMode", access);
    leaf("pPort", "Device");
    leaf("Cachable", "NoCache");
  }
  void int_register(const std::string& name, reg::Address address, const char* access,
                    std::size_t bytes = 4) {
    add("<IntReg Name=\"" + name + "Reg\">");
    place(address, bytes, access);
    leaf("Sign", "Unsigned");
    leaf("Endianess", "LittleEndian");
    add("</IntReg>");
  }

  std::string text_;
};

void describe_device(Description& d) {
  d.category("DeviceControl", {"DeviceVendorName", "DeviceModelName", "DeviceFamilyName", "DeviceVersion",
                               "DeviceManufacturerInfo", "DeviceSerialNumber", "DeviceID", "DeviceUserID",
                               "TimestampLatch", "TimestampLatchValue"});
  d.text_feature("DeviceVendorName", reg::kManufacturerName, false);
  d.text_feature("DeviceModelName", reg::kModelName, false);
  d.text_feature("DeviceFamilyName", reg::kFamilyName, false);
  d.text_feature("DeviceVersion", reg::kDeviceVersion, false);
  d.text_feature("DeviceManufacturerInfo", reg::kManufacturerInfo, false);
  d.text_feature("DeviceSerialNumber", reg::kSerialNumber, false);
  d.text_feature("DeviceID", reg::kSerialNumber, false);
  d.text_feature("DeviceUserID", reg::kUserName, true);
  d.command("TimestampLatch", reg::kTimestampLatch, "WO");
  d.integer("TimestampLatchValue", reg::kTimestamp, "RO", "", 8);
}

void describe_image(Description& d, const gige::GigeCameraConfig& c) {
  d.category("ImageFormatControl",
             {"SensorWidth", "SensorHeight", "Width", "Height", "OffsetX", "OffsetY", "PixelFormat"});
  d.integer("SensorWidth", reg::kSensorWidth, "RO");
  d.integer("SensorHeight", reg::kSensorHeight, "RO");
  d.side("Width", reg::kWidth, c.min_width_px, c.width_step_px, "SensorWidth", "OffsetX");
  d.side("Height", reg::kHeight, c.min_height_px, c.height_step_px, "SensorHeight", "OffsetY");
  d.side("OffsetX", reg::kOffsetX, 0, c.offset_step_px, "SensorWidth", "Width");
  d.side("OffsetY", reg::kOffsetY, 0, c.offset_step_px, "SensorHeight", "Height");
  std::vector<Entry> formats;
  for (const auto f : c.formats) formats.emplace_back(gige::to_string(f), static_cast<std::uint32_t>(f));
  d.enumeration("PixelFormat", reg::kPixelFormat, formats, true);
}

void describe_acquisition(Description& d, const gige::GigeCameraConfig& c) {
  d.category("AcquisitionControl",
             {"AcquisitionMode", "AcquisitionStart", "AcquisitionStop", "AcquisitionFrameCount",
              "AcquisitionFrameRateEnable", "AcquisitionFrameRate", "ResultingFrameRate", "ExposureMode",
              "ExposureTime", "TriggerSelector", "TriggerMode", "TriggerSource", "TriggerActivation",
              "TriggerDelay", "TriggerSoftware"});
  d.enumeration("AcquisitionMode", reg::kAcquisitionMode,
                {{"Continuous", reg::kModeContinuous},
                 {"SingleFrame", reg::kModeSingleFrame},
                 {"MultiFrame", reg::kModeMultiFrame}},
                true);
  d.command("AcquisitionStart", reg::kAcquisitionStart);
  d.command("AcquisitionStop", reg::kAcquisitionStop);
  d.integer("AcquisitionFrameCount", reg::kAcquisitionFrameCount, "RW",
            Description::element("Min", "1") + Description::element("Max", "65535"));
  d.boolean("AcquisitionFrameRateEnable", reg::kFrameRateEnable);
  d.real("AcquisitionFrameRate", reg::kFrameRate, "Hz", c.min_frame_rate_hz, c.max_frame_rate_hz);
  d.real("ResultingFrameRate", reg::kResultingFrameRate, "Hz", 0, 0, "RO");
  d.fixed("ExposureMode", "Timed");
  d.real("ExposureTime", reg::kExposureTime, "us", c.min_exposure_us, c.max_exposure_us);
  d.fixed("TriggerSelector", "FrameStart");
  d.enumeration("TriggerMode", reg::kTriggerMode, {{"Off", 0}, {"On", 1}});
  d.enumeration("TriggerSource", reg::kTriggerSource,
                {{"Software", reg::kTriggerSourceSoftware}, {"Line1", reg::kTriggerSourceLine1}});
  d.enumeration("TriggerActivation", reg::kTriggerActivation,
                {{"RisingEdge", reg::kRisingEdge}, {"FallingEdge", reg::kFallingEdge}});
  d.real("TriggerDelay", reg::kTriggerDelay, "us", 0, 1e6);
  d.command("TriggerSoftware", reg::kTriggerSoftware);

  d.category("AnalogControl", {"Gain"});
  d.real("Gain", reg::kGain, "dB", c.min_gain_db, c.max_gain_db);
  d.category("DigitalIOControl", {"LineSelector", "LineMode", "LineStatus"});
  d.fixed("LineSelector", "Line1");
  d.fixed("LineMode", "Input");
  d.boolean("LineStatus", reg::kLineStatus, "RO");
  d.category("EventControl", {"EventSelector", "EventNotification"});
  d.fixed("EventSelector", "ExposureStart");
  d.enumeration("EventNotification", reg::kEventNotification, {{"Off", 0}, {"On", 1}});
}

}  // namespace

std::string make_genicam_xml(const gige::GigeCameraConfig& c) {
  Description d;
  d.add("<?xml version=\"1.0\" encoding=\"utf-8\"?>");
  d.add("<RegisterDescription ModelName=\"" + xml_name(c.model) + "\" VendorName=\"" + xml_name(c.vendor) +
        "\" StandardNameSpace=\"USB\" SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" "
        "SchemaSubMinorVersion=\"0\" MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" "
        "ProductGuid=\"9B0C7B52-6E1A-4F55-A3D5-0C1E6B7F9A42\" "
        "VersionGuid=\"3F6F1D0A-92C4-4E0B-8E63-7A5B1C2D3E4F\" "
        "xmlns=\"http://www.genicam.org/GenApi/Version_1_1\" "
        "xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" "
        "xsi:schemaLocation=\"http://www.genicam.org/GenApi/Version_1_1 "
        "http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd\">");
  d.category("Root", {"DeviceControl", "ImageFormatControl", "AcquisitionControl", "AnalogControl",
                      "DigitalIOControl", "EventControl", "TransportLayerControl"});
  describe_device(d);
  describe_image(d, c);
  describe_acquisition(d, c);
  d.category("TransportLayerControl", {"PayloadSize", "TLParamsLocked"});
  d.integer("PayloadSize", reg::kPayloadSize, "RO");
  d.integer("TLParamsLocked", reg::kTlParamsLocked, "RW",
            Description::element("Min", "0") + Description::element("Max", "1"));
  d.add("<Port Name=\"Device\" NameSpace=\"Standard\"></Port>");
  d.add("</RegisterDescription>");
  return d.text();
}

}  // namespace rigor::u3v
