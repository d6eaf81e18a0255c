#include "drivers/aravis/gige_genicam_xml.h"

#include <cinttypes>
#include <cstdarg>
#include <cstdio>
#include <locale>
#include <sstream>

#include "rt-core/device_text.h"

namespace rigor::gige {
namespace {

std::string hex(std::uint32_t v) {
  char text[16];
  std::snprintf(text, sizeof text, "0x%" PRIX32, v);
  return text;
}

std::string number(double v) {
  std::ostringstream s;
  s.imbue(std::locale::classic());
  s.precision(17);
  s << v;
  return s.str();
}

std::string escaped(const std::string& s) {
  std::string out;
  for (const char c : device_text(s)) {
    if (c == '&')
      out += "&amp;";
    else if (c == '<')
      out += "&lt;";
    else if (c == '>')
      out += "&gt;";
    else if (c == '"')
      out += "&quot;";
    else
      out += c;
  }
  return out;
}

/// The name that XML attributes may have: letters, digits and underscores.
std::string identifier(const std::string& s) {
  std::string out;
  for (const char c : s) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
    out += plain ? c : '_';
  }
  return out.empty() ? "Camera" : out;
}

class Writer {
 public:
  std::string text;

  void open(const char* element, const std::string& name) {
    text += std::string("  <") + element + " Name=\"" + name + "\">\n";
  }
  void close(const char* element) { text += std::string("  </") + element + ">\n"; }
  void leaf(const char* element, const std::string& value) {
    text += std::string("    <") + element + ">" + value + "</" + element + ">\n";
  }
  void about(const char* tooltip, const char* display, const char* visibility = "Beginner") {
    leaf("ToolTip", tooltip);
    leaf("DisplayName", display);
    leaf("Visibility", visibility);
  }

  void category(const std::string& name, std::initializer_list<const char*> features) {
    text += "  <Category Name=\"" + name + "\" NameSpace=\"Standard\">\n";
    for (const char* f : features) leaf("pFeature", f);
    close("Category");
  }

  void int_register(const std::string& name, std::uint32_t address, const char* access,
                    bool cachable = false) {
    open("IntReg", name);
    leaf("Address", hex(address));
    leaf("Length", "4");
    leaf("AccessMode", access);
    leaf("pPort", "Device");
    leaf("Cachable", cachable ? "WriteThrough" : "NoCache");
    leaf("Sign", "Unsigned");
    leaf("Endianess", "BigEndian");
    close("IntReg");
  }
  /// Bits as the specification counts them: 0 is the most significant.
  void masked_register(const std::string& name, std::uint32_t address, const char* access, int lsb, int msb) {
    open("MaskedIntReg", name);
    leaf("Address", hex(address));
    leaf("Length", "4");
    leaf("AccessMode", access);
    leaf("pPort", "Device");
    leaf("Cachable", "NoCache");
    if (lsb == msb) {
      leaf("Bit", std::to_string(lsb));
    } else {
      leaf("LSB", std::to_string(lsb));
      leaf("MSB", std::to_string(msb));
    }
    leaf("Sign", "Unsigned");
    leaf("Endianess", "BigEndian");
    close("MaskedIntReg");
  }
  void float_register(const std::string& name, std::uint32_t address, const char* access) {
    open("FloatReg", name);
    leaf("Address", hex(address));
    leaf("Length", "8");
    leaf("AccessMode", access);
    leaf("pPort", "Device");
    leaf("Cachable", "NoCache");
    leaf("Endianess", "BigEndian");
    close("FloatReg");
  }
  void string_register(const std::string& name, const char* display, std::uint32_t address, int length,
                       const char* access) {
    text += "  <StringReg Name=\"" + name + "\" NameSpace=\"Standard\">\n";
    leaf("DisplayName", display);
    leaf("Address", hex(address));
    leaf("Length", std::to_string(length));
    leaf("AccessMode", access);
    leaf("pPort", "Device");
    close("StringReg");
  }
  void feature(const char* element, const std::string& name) {
    text += std::string("  <") + element + " Name=\"" + name + "\" NameSpace=\"Standard\">\n";
  }
  void entry(const std::string& name, std::uint32_t value) {
    text += "    <EnumEntry Name=\"" + name + "\" NameSpace=\"Standard\">\n      <Value>" +
            std::to_string(value) + "</Value>\n    </EnumEntry>\n";
  }
  void command(const std::string& name, const char* tooltip, std::uint32_t address) {
    feature("Command", name);
    leaf("ToolTip", tooltip);
    leaf("pValue", name + "Reg");
    leaf("CommandValue", "1");
    close("Command");
    int_register(name + "Reg", address, "RW");
  }
  void float_feature(const std::string& name, const char* tooltip, const char* unit, double min, double max,
                     std::uint32_t address) {
    feature("Float", name);
    about(tooltip, name.c_str());
    leaf("pValue", name + "Reg");
    leaf("Min", number(min));
    leaf("Max", number(max));
    leaf("Unit", unit);
    close("Float");
    float_register(name + "Reg", address, "RW");
  }
  /// MAX = `whole` - `used`, rounded down to `step`: the room that the other edge of the region leaves.
  void room(const std::string& name, const char* whole, const char* used, std::uint32_t step) {
    open("IntSwissKnife", name);
    text += std::string("    <pVariable Name=\"WHOLE\">") + whole + "</pVariable>\n";
    text += std::string("    <pVariable Name=\"USED\">") + used + "</pVariable>\n";
    leaf("Formula", "((WHOLE - USED) / " + std::to_string(step) + ") * " + std::to_string(step));
    close("IntSwissKnife");
  }
  void region_feature(const std::string& name, const char* tooltip, std::uint32_t min, const std::string& max,
                      std::uint32_t step, std::uint32_t address) {
    feature("Integer", name);
    about(tooltip, name.c_str());
    leaf("pIsLocked", "TLParamsLocked");
    leaf("pValue", name + "Reg");
    leaf("Min", std::to_string(min));
    leaf("pMax", max);
    leaf("Inc", std::to_string(step));
    leaf("Unit", "px");
    close("Integer");
    int_register(name + "Reg", address, "RW");
  }
  void read_only_integer(const std::string& name, const char* tooltip, std::uint32_t address,
                         const char* visibility = "Expert") {
    feature("Integer", name);
    about(tooltip, name.c_str(), visibility);
    leaf("pValue", name + "Reg");
    close("Integer");
    int_register(name + "Reg", address, "RO");
  }
  void high_low(const std::string& name, const char* tooltip, std::uint32_t high, std::uint32_t low) {
    feature("Integer", name);
    about(tooltip, name.c_str(), "Expert");
    leaf("pValue", name + "Calc");
    leaf("Min", "0");  // a formula has no range of its own
    leaf("Max", "9223372036854775807");
    close("Integer");
    open("IntSwissKnife", name + "Calc");
    text += "    <pVariable Name=\"HIGH\">" + name + "HighReg</pVariable>\n";
    text += "    <pVariable Name=\"LOW\">" + name + "LowReg</pVariable>\n";
    leaf("Formula", "(HIGH &lt;&lt; 32) | LOW");
    close("IntSwissKnife");
    int_register(name + "HighReg", high, "RO");
    int_register(name + "LowReg", low, "RO");
  }
};

void write_device_control(Writer& w) {
  w.category("DeviceControl", {"DeviceVendorName", "DeviceModelName", "DeviceManufacturerInfo",
                               "DeviceVersion", "DeviceID", "DeviceUserID"});
  w.string_register("DeviceVendorName", "Device Vendor Name", reg::kManufacturerName, 32, "RO");
  w.string_register("DeviceModelName", "Device Model Name", reg::kModelName, 32, "RO");
  w.string_register("DeviceManufacturerInfo", "Device Manufacturer Info", reg::kManufacturerInfo, 48, "RO");
  w.string_register("DeviceVersion", "Device Version", reg::kDeviceVersion, 32, "RO");
  w.string_register("DeviceID", "Device ID", reg::kSerialNumber, 16, "RO");
  w.string_register("DeviceUserID", "Device User ID", reg::kUserName, 16, "RW");
}

void write_image_format(Writer& w, const GigeCameraConfig& c) {
  w.category("ImageFormatControl", {"SensorWidth", "SensorHeight", "WidthMax", "HeightMax", "Width", "Height",
                                    "OffsetX", "OffsetY", "PixelFormat"});
  w.read_only_integer("SensorWidth", "Width of the sensor", reg::kWidthMax);
  w.read_only_integer("SensorHeight", "Height of the sensor", reg::kHeightMax);
  w.read_only_integer("WidthMax", "Largest width of the region", reg::kWidthMax);
  w.read_only_integer("HeightMax", "Largest height of the region", reg::kHeightMax);
  w.region_feature("Width", "Width of the region", c.min_width_px, "WidthRoom", c.width_step_px, reg::kWidth);
  w.region_feature("Height", "Height of the region", c.min_height_px, "HeightRoom", c.height_step_px,
                   reg::kHeight);
  w.region_feature("OffsetX", "Left edge of the region", 0, "OffsetXRoom", c.offset_step_px, reg::kOffsetX);
  w.region_feature("OffsetY", "Top edge of the region", 0, "OffsetYRoom", c.offset_step_px, reg::kOffsetY);
  w.room("WidthRoom", "WidthMaxReg", "OffsetXReg", c.width_step_px);
  w.room("HeightRoom", "HeightMaxReg", "OffsetYReg", c.height_step_px);
  w.room("OffsetXRoom", "WidthMaxReg", "WidthReg", c.offset_step_px);
  w.room("OffsetYRoom", "HeightMaxReg", "HeightReg", c.offset_step_px);

  w.feature("Enumeration", "PixelFormat");
  w.about("Format of the pixels", "Pixel Format");
  w.leaf("pIsLocked", "TLParamsLocked");
  for (const auto f : c.formats) w.entry(to_string(f), static_cast<std::uint32_t>(f));
  w.leaf("pValue", "PixelFormatReg");
  w.close("Enumeration");
  w.int_register("PixelFormatReg", reg::kPixelFormat, "RW");
}

void write_acquisition(Writer& w, const GigeCameraConfig& c) {
  w.category("AcquisitionControl",
             {"AcquisitionMode", "AcquisitionStart", "AcquisitionStop", "AcquisitionAbort",
              "AcquisitionFrameCount", "AcquisitionFrameRate", "AcquisitionFrameRateEnable",
              "ResultingFrameRate", "ExposureMode", "ExposureTime", "TriggerSelector", "TriggerMode",
              "TriggerSource", "TriggerActivation", "TriggerDelay", "TriggerSoftware"});
  w.feature("Enumeration", "AcquisitionMode");
  w.about("How many frames an acquisition has", "Acquisition Mode");
  w.leaf("pIsLocked", "TLParamsLocked");
  w.entry("Continuous", reg::kModeContinuous);
  w.entry("SingleFrame", reg::kModeSingleFrame);
  w.entry("MultiFrame", reg::kModeMultiFrame);
  w.leaf("pValue", "AcquisitionModeReg");
  w.close("Enumeration");
  w.int_register("AcquisitionModeReg", reg::kAcquisitionMode, "RW");
  w.command("AcquisitionStart", "Starts the acquisition", reg::kAcquisitionStart);
  w.command("AcquisitionStop", "Ends the acquisition; an exposure in progress is dropped",
            reg::kAcquisitionStop);
  w.command("AcquisitionAbort", "Ends the acquisition at once", reg::kAcquisitionAbort);

  w.feature("Integer", "AcquisitionFrameCount");
  w.about("Frames of a MultiFrame acquisition", "Acquisition Frame Count");
  w.leaf("pIsLocked", "TLParamsLocked");
  w.leaf("pValue", "AcquisitionFrameCountReg");
  w.leaf("Min", "1");
  w.leaf("Max", "65535");
  w.close("Integer");
  w.int_register("AcquisitionFrameCountReg", reg::kAcquisitionFrameCount, "RW");

  w.float_feature("AcquisitionFrameRate", "Frame rate, where exposure allows it", "Hz", c.min_frame_rate_hz,
                  c.max_frame_rate_hz, reg::kFrameRate);
  w.feature("Boolean", "AcquisitionFrameRateEnable");
  w.about("Off: the highest rate that the exposure time allows", "Acquisition Frame Rate Enable");
  w.leaf("pValue", "AcquisitionFrameRateEnableReg");
  w.leaf("OnValue", "1");
  w.leaf("OffValue", "0");
  w.close("Boolean");
  w.int_register("AcquisitionFrameRateEnableReg", reg::kFrameRateEnable, "RW");
  w.open("Float", "ResultingFrameRate");
  w.about("The rate that frame rate and exposure time give together", "Resulting Frame Rate", "Expert");
  w.leaf("pValue", "ResultingFrameRateReg");
  w.leaf("Unit", "Hz");
  w.close("Float");
  w.float_register("ResultingFrameRateReg", reg::kResultingFrameRate, "RO");

  const auto fixed = [&w](const char* name, const char* tooltip, const char* value) {
    w.feature("Enumeration", name);
    w.about(tooltip, name, "Expert");
    w.entry(value, 0);
    w.leaf("Value", "0");
    w.close("Enumeration");
  };
  fixed("ExposureMode", "How the exposure time is set", "Timed");
  w.float_feature("ExposureTime", "Exposure time", "us", c.min_exposure_us, c.max_exposure_us,
                  reg::kExposureTime);

  fixed("TriggerSelector", "The trigger that the other features mean", "FrameStart");
  w.feature("Enumeration", "TriggerMode");
  w.about("On: each frame waits for its trigger", "Trigger Mode");
  w.entry("Off", 0);
  w.entry("On", 1);
  w.leaf("pValue", "TriggerModeReg");
  w.close("Enumeration");
  w.int_register("TriggerModeReg", reg::kTriggerMode, "RW");
  w.feature("Enumeration", "TriggerSource");
  w.about("Where triggers come from", "Trigger Source");
  w.entry("Software", reg::kTriggerSourceSoftware);
  w.entry("Line1", reg::kTriggerSourceLine1);
  w.leaf("pValue", "TriggerSourceReg");
  w.close("Enumeration");
  w.int_register("TriggerSourceReg", reg::kTriggerSource, "RW");
  w.feature("Enumeration", "TriggerActivation");
  w.about("Edge that triggers", "Trigger Activation");
  w.entry("RisingEdge", reg::kRisingEdge);
  w.entry("FallingEdge", reg::kFallingEdge);
  w.leaf("pValue", "TriggerActivationReg");
  w.close("Enumeration");
  w.int_register("TriggerActivationReg", reg::kTriggerActivation, "RW");
  w.float_feature("TriggerDelay", "From the edge to the exposure", "us", 0, 1e6, reg::kTriggerDelay);
  w.command("TriggerSoftware", "Triggers one frame", reg::kTriggerSoftware);

  w.category("DigitalIOControl", {"LineSelector", "LineMode", "LineStatus"});
  fixed("LineSelector", "The line that the other features mean", "Line1");
  fixed("LineMode", "Direction of the line", "Input");
  w.feature("Boolean", "LineStatus");
  w.about("Whether the line is high now", "Line Status");
  w.leaf("pValue", "LineStatusReg");
  w.leaf("OnValue", "1");
  w.leaf("OffValue", "0");
  w.close("Boolean");
  w.int_register("LineStatusReg", reg::kLineStatus, "RO");

  w.category("AnalogControl", {"Gain"});
  w.float_feature("Gain", "Analogue gain", "dB", c.min_gain_db, c.max_gain_db, reg::kGain);
}

void write_chunks(Writer& w) {
  w.category("ChunkDataControl", {"ChunkModeActive", "ChunkSelector", "ChunkEnable", "ChunkTimestamp",
                                  "ChunkExposureTime", "ChunkGain", "ChunkFrameID"});
  const auto flag = [&w](const char* name, const char* tooltip, std::uint32_t address) {
    w.feature("Boolean", name);
    w.about(tooltip, name, "Expert");
    w.leaf("pIsLocked", "TLParamsLocked");
    w.leaf("pValue", std::string(name) + "Reg");
    w.leaf("OnValue", "1");
    w.leaf("OffValue", "0");
    w.close("Boolean");
    w.int_register(std::string(name) + "Reg", address, "RW");
  };
  flag("ChunkModeActive", "Whether chunks follow each picture", reg::kChunkModeActive);
  w.feature("Enumeration", "ChunkSelector");
  w.about("The chunk that ChunkEnable means", "Chunk Selector", "Expert");
  w.entry("Image", reg::kChunkImage);
  w.entry("Timestamp", reg::kChunkTimestamp);
  w.entry("ExposureTime", reg::kChunkExposureTime);
  w.entry("Gain", reg::kChunkGain);
  w.entry("FrameID", reg::kChunkFrameId);
  w.leaf("pValue", "ChunkSelectorReg");
  w.leaf("pSelected", "ChunkEnable");
  w.close("Enumeration");
  w.int_register("ChunkSelectorReg", reg::kChunkSelector, "RW");
  flag("ChunkEnable", "Whether the selected chunk is sent", reg::kChunkEnable);
  const auto value = [&w](const std::string& name, const char* tooltip, std::uint32_t id, bool real) {
    w.feature(real ? "Float" : "Integer", name);
    w.about(tooltip, name.c_str(), "Expert");
    w.leaf("pValue", name + "Value");
    w.close(real ? "Float" : "Integer");
    w.open(real ? "FloatReg" : "IntReg", name + "Value");
    w.leaf("Address", "0x0");
    w.leaf("Length", "8");
    w.leaf("AccessMode", "RO");
    w.leaf("pPort", name + "Port");
    w.leaf("Cachable", "NoCache");
    if (!real) w.leaf("Sign", "Unsigned");
    w.leaf("Endianess", "BigEndian");
    w.close(real ? "FloatReg" : "IntReg");
    w.text += "  <Port Name=\"" + name + "Port\" NameSpace=\"Standard\">\n";
    char hexadecimal[16];
    std::snprintf(hexadecimal, sizeof hexadecimal, "%08X", id);
    w.leaf("ChunkID", hexadecimal);
    w.close("Port");
  };
  value("ChunkTimestamp", "Start of the exposure in ticks", reg::kChunkTimestamp, false);
  value("ChunkExposureTime", "Exposure time of this picture in microseconds", reg::kChunkExposureTime, true);
  value("ChunkGain", "Gain of this picture in dB", reg::kChunkGain, true);
  value("ChunkFrameID", "Exposures since the start of the acquisition", reg::kChunkFrameId, false);
}

void write_ptp(Writer& w) {
  w.category("PtpControl", {"PtpEnable", "PtpDataSetLatch", "PtpStatus", "PtpOffsetFromMaster"});
  w.feature("Boolean", "PtpEnable");
  w.about("Whether the clock follows a PTP master", "Ptp Enable", "Expert");
  w.leaf("pValue", "PtpEnableReg");
  w.leaf("OnValue", "1");
  w.leaf("OffValue", "0");
  w.close("Boolean");
  w.int_register("PtpEnableReg", reg::kPtpEnable, "RW");
  w.command("PtpDataSetLatch", "Latches the offset", reg::kPtpLatch);
  w.feature("Enumeration", "PtpStatus");
  w.about("State of the PTP clock", "Ptp Status", "Expert");
  w.entry("Disabled", reg::kPtpDisabled);
  w.entry("Listening", reg::kPtpListening);
  w.entry("Uncalibrated", reg::kPtpUncalibrated);
  w.entry("Slave", reg::kPtpSlave);
  w.leaf("pValue", "PtpStatusReg");
  w.close("Enumeration");
  w.int_register("PtpStatusReg", reg::kPtpStatus, "RO");
  w.feature("Integer", "PtpOffsetFromMaster");
  w.about("Nanoseconds from the master at the last latch", "Ptp Offset From Master", "Expert");
  w.leaf("pValue", "PtpOffsetFromMasterReg");
  w.close("Integer");
  w.open("IntReg", "PtpOffsetFromMasterReg");
  w.leaf("Address", hex(reg::kPtpOffsetHigh));
  w.leaf("Length", "8");
  w.leaf("AccessMode", "RO");
  w.leaf("pPort", "Device");
  w.leaf("Cachable", "NoCache");
  w.leaf("Sign", "Signed");
  w.leaf("Endianess", "BigEndian");
  w.close("IntReg");
}

void write_transport(Writer& w, const GigeCameraConfig& c) {
  w.category("TransportLayerControl", {"PayloadSize",
                                       "GevVersionMajor",
                                       "GevVersionMinor",
                                       "GevMACAddress",
                                       "GevCurrentIPAddress",
                                       "GevCurrentSubnetMask",
                                       "GevCurrentDefaultGateway",
                                       "GevStreamChannelCount",
                                       "GevHeartbeatTimeout",
                                       "GevTimestampTickFrequency",
                                       "GevTimestampControlLatch",
                                       "GevTimestampControlReset",
                                       "GevTimestampControlLatchReset",
                                       "GevTimestampValue",
                                       "GevCCP",
                                       "GevStreamChannelSelector",
                                       "GevSCPInterfaceIndex",
                                       "GevSCPHostPort",
                                       "GevSCPSFireTestPacket",
                                       "GevSCPSDoNotFragment",
                                       "GevSCPSPacketSize",
                                       "GevSCPD",
                                       "GevSCDA",
                                       "GevSCSP"});
  w.read_only_integer("PayloadSize", "Bytes of a frame", reg::kPayloadSize);
  w.feature("Integer", "TLParamsLocked");
  w.about("1 while features that shape the stream may not change", "TL Params Locked", "Invisible");
  w.leaf("pValue", "TLParamsLockedReg");
  w.leaf("Min", "0");
  w.leaf("Max", "1");
  w.close("Integer");
  w.int_register("TLParamsLockedReg", reg::kTlParamsLocked, "RW");

  const auto masked = [&w](const char* name, const char* tooltip, std::uint32_t address, int lsb, int msb) {
    w.feature("Integer", name);
    w.about(tooltip, name, "Expert");
    w.leaf("pValue", std::string(name) + "Reg");
    w.close("Integer");
    w.masked_register(std::string(name) + "Reg", address, "RO", lsb, msb);
  };
  masked("GevVersionMajor", "GigE Vision version, major", reg::kVersion, 15, 0);
  masked("GevVersionMinor", "GigE Vision version, minor", reg::kVersion, 31, 16);
  w.high_low("GevMACAddress", "MAC address", reg::kMacHigh, reg::kMacLow);
  w.read_only_integer("GevCurrentIPAddress", "IP address", reg::kCurrentIp);
  w.read_only_integer("GevCurrentSubnetMask", "Subnet mask", reg::kCurrentMask);
  w.read_only_integer("GevCurrentDefaultGateway", "Gateway", reg::kCurrentGateway);
  w.read_only_integer("GevStreamChannelCount", "Stream channels", reg::kStreamChannelCount);
  w.high_low("GevTimestampTickFrequency", "Ticks per second of the timestamp", reg::kTickFrequencyHigh,
             reg::kTickFrequencyLow);
  w.high_low("GevTimestampValue", "Timestamp at the last latch", reg::kTimestampHigh, reg::kTimestampLow);
  const auto control = [&w](const char* name, const char* tooltip, std::uint32_t value) {
    w.feature("Command", name);
    w.leaf("ToolTip", tooltip);
    w.leaf("pValue", "GevTimestampControlReg");
    w.leaf("CommandValue", std::to_string(value));
    w.close("Command");
  };
  control("GevTimestampControlLatch", "Latches the timestamp", reg::kTimestampLatch);
  control("GevTimestampControlReset", "Sets the timestamp to zero", reg::kTimestampReset);
  control("GevTimestampControlLatchReset", "Latches the timestamp, then sets it to zero",
          reg::kTimestampLatch | reg::kTimestampReset);
  w.int_register("GevTimestampControlReg", reg::kTimestampControl, "WO");

  w.feature("Integer", "GevHeartbeatTimeout");
  w.about("Silence after which the controller loses control", "GevHeartbeatTimeout", "Guru");
  w.leaf("pValue", "GevHeartbeatTimeoutReg");
  w.leaf("Min", "500");
  w.leaf("Max", "3600000");
  w.leaf("Unit", "ms");
  w.close("Integer");
  w.int_register("GevHeartbeatTimeoutReg", reg::kHeartbeatTimeout, "RW");

  w.feature("Enumeration", "GevCCP");
  w.about("Control channel privilege", "GevCCP", "Guru");
  w.entry("OpenAccess", 0);
  w.entry("ExclusiveAccess", 1);
  w.entry("ControlAccess", 2);
  w.leaf("pValue", "GevCCPReg");
  w.close("Enumeration");
  w.int_register("GevCCPReg", reg::kControlPrivilege, "RW");

  w.feature("Integer", "GevStreamChannelSelector");
  w.about("The stream channel that the other features mean", "GevStreamChannelSelector", "Expert");
  w.leaf("Value", "0");
  w.leaf("Min", "0");
  w.leaf("Max", "0");
  w.leaf("Inc", "1");
  w.close("Integer");
  masked("GevSCPInterfaceIndex", "Network interface of the stream", reg::kStreamPort, 3, 0);
  w.feature("Integer", "GevSCPHostPort");
  w.about("UDP port that the stream goes to; 0 closes it", "GevSCPHostPort", "Expert");
  w.leaf("pValue", "GevSCPHostPortReg");
  w.leaf("Min", "0");
  w.leaf("Max", "65535");
  w.close("Integer");
  w.masked_register("GevSCPHostPortReg", reg::kStreamPort, "RW", 31, 16);

  w.feature("Command", "GevSCPSFireTestPacket");
  w.leaf("ToolTip", "Sends one packet of the current packet size");
  w.leaf("pIsLocked", "TLParamsLocked");
  w.leaf("pValue", "GevSCPSFireTestPacketReg");
  w.leaf("CommandValue", "1");
  w.close("Command");
  w.masked_register("GevSCPSFireTestPacketReg", reg::kStreamPacketSize, "RW", 0, 0);
  w.feature("Boolean", "GevSCPSDoNotFragment");
  w.about("Sets the IP bit of the same name", "GevSCPSDoNotFragment", "Guru");
  w.leaf("pIsLocked", "TLParamsLocked");
  w.leaf("pValue", "GevSCPSDoNotFragmentReg");
  w.close("Boolean");
  w.masked_register("GevSCPSDoNotFragmentReg", reg::kStreamPacketSize, "RW", 1, 1);
  w.feature("Integer", "GevSCPSPacketSize");
  w.about("Size of a stream packet with IP and UDP headers", "GevSCPSPacketSize", "Expert");
  w.leaf("pIsLocked", "TLParamsLocked");
  w.leaf("pValue", "GevSCPSPacketSizeReg");
  w.leaf("Min", std::to_string(c.min_packet_size));
  w.leaf("Max", std::to_string(c.max_packet_size));
  w.leaf("Inc", "4");
  w.leaf("Unit", "B");
  w.close("Integer");
  w.masked_register("GevSCPSPacketSizeReg", reg::kStreamPacketSize, "RW", 31, 16);
  w.feature("Integer", "GevSCPD");
  w.about("Delay between stream packets in timestamp ticks", "GevSCPD", "Expert");
  w.leaf("pValue", "GevSCPDReg");
  w.leaf("Min", "0");
  w.leaf("Max", "10000000");
  w.close("Integer");
  w.int_register("GevSCPDReg", reg::kStreamPacketDelay, "RW");
  w.feature("Integer", "GevSCDA");
  w.about("IP address that the stream goes to", "GevSCDA", "Expert");
  w.leaf("pValue", "GevSCDAReg");
  w.close("Integer");
  w.int_register("GevSCDAReg", reg::kStreamDestination, "RW");
  masked("GevSCSP", "UDP port that the stream comes from", reg::kStreamSourcePort, 31, 16);
}

/// SFNC 2.4, 3D scan control: what the counts of the range picture mean, and which pictures a frame has.
void write_range(Writer& w) {
  w.category("Scan3dControl",
             {"ComponentSelector", "ComponentEnable", "Scan3dDistanceUnit", "Scan3dCoordinateSystem",
              "Scan3dOutputMode", "Scan3dCoordinateSelector", "Scan3dCoordinateScale",
              "Scan3dCoordinateOffset", "Scan3dInvalidDataFlag", "Scan3dInvalidDataValue"});
  w.feature("Enumeration", "ComponentSelector");
  w.about("The picture of a frame that ComponentEnable means", "Component Selector");
  w.entry("Intensity", kIntensity);
  w.entry("Range", kRange);
  w.leaf("pValue", "ComponentSelectorReg");
  w.close("Enumeration");
  w.int_register("ComponentSelectorReg", reg::kComponentSelector, "RW");
  w.feature("Boolean", "ComponentEnable");
  w.about("Whether multi-part frames have this picture", "Component Enable");
  w.leaf("pIsLocked", "TLParamsLocked");
  w.leaf("pValue", "ComponentEnableReg");
  w.leaf("OnValue", "1");
  w.leaf("OffValue", "0");
  w.close("Boolean");
  w.int_register("ComponentEnableReg", reg::kComponentEnable, "RW");
  const auto fixed = [&w](const char* name, const char* tooltip, const char* value) {
    w.feature("Enumeration", name);
    w.about(tooltip, name, "Expert");
    w.entry(value, 0);
    w.leaf("Value", "0");
    w.close("Enumeration");
  };
  fixed("Scan3dDistanceUnit", "Unit of scale and offset", "Millimeter");
  fixed("Scan3dCoordinateSystem", "What coordinate C is: the length of the ray", "Spherical");
  fixed("Scan3dOutputMode", "What the range picture has", "CalibratedC");
  fixed("Scan3dCoordinateSelector", "The coordinate that scale and offset mean", "CoordinateC");
  const auto value = [&w](const char* name, const char* tooltip, std::uint32_t address) {
    w.open("Float", name);
    w.about(tooltip, name, "Expert");
    w.leaf("pValue", std::string(name) + "Reg");
    w.close("Float");
    w.float_register(std::string(name) + "Reg", address, "RO");
  };
  value("Scan3dCoordinateScale", "Millimetres for a count", reg::kScan3dScale);
  value("Scan3dCoordinateOffset", "Millimetres at 0 counts", reg::kScan3dOffset);
  w.feature("Boolean", "Scan3dInvalidDataFlag");
  w.about("Whether one value of the range picture says that there is none", "Scan3dInvalidDataFlag",
          "Expert");
  w.leaf("Value", "1");
  w.leaf("OnValue", "1");
  w.leaf("OffValue", "0");
  w.close("Boolean");
  value("Scan3dInvalidDataValue", "That value", reg::kScan3dInvalidValue);
}

}  // namespace

std::string make_genicam_xml(const GigeCameraConfig& config) {
  Writer w;
  w.text =
      "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n"
      "<RegisterDescription ModelName=\"" +
      identifier(config.model) + "\" VendorName=\"" + identifier(config.vendor) + "\" ToolTip=\"" +
      escaped(config.model) +
      "\" StandardNameSpace=\"GEV\" SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" "
      "SchemaSubMinorVersion=\"0\" "
      "MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" "
      "ProductGuid=\"5D7A5C1E-8A7B-4B0F-9C1D-6E3F2A8B4C71\" "
      "VersionGuid=\"E2C94B36-17D5-4F7A-8E90-3B5D1C6A7F28\" "
      "xmlns=\"http://www.genicam.org/GenApi/Version_1_1\" "
      "xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" "
      "xsi:schemaLocation=\"http://www.genicam.org/GenApi/Version_1_1 "
      "http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd\">\n";
  w.category("Root", {"DeviceControl", "ImageFormatControl", "AcquisitionControl", "AnalogControl",
                      "DigitalIOControl", "ChunkDataControl", "TransportLayerControl"});
  if (config.ptp.present) {
    // Into Root's list, behind the last one.
    const std::string last = "<pFeature>TransportLayerControl</pFeature>\n";
    w.text.insert(w.text.find(last) + last.size(), "    <pFeature>PtpControl</pFeature>\n");
    write_ptp(w);
  }
  if (config.range.present) {
    const std::string last = "<pFeature>TransportLayerControl</pFeature>\n";
    w.text.insert(w.text.find(last) + last.size(), "    <pFeature>Scan3dControl</pFeature>\n");
    write_range(w);
  }
  write_device_control(w);
  write_image_format(w, config);
  write_acquisition(w, config);
  write_chunks(w);
  write_transport(w, config);
  w.text += "  <Port Name=\"Device\" NameSpace=\"Standard\">\n  </Port>\n</RegisterDescription>\n";
  while (w.text.size() % 4 != 0) w.text += '\n';
  return w.text;
}

}  // namespace rigor::gige
