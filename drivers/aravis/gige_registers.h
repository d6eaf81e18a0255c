// The register map of the emulated camera: bootstrap registers as GigE Vision 1.2 places them, and our own
// features behind them. The device model, its GenICam XML and the in-process client all read addresses from
// here. All registers are big-endian; `double` features are 8 bytes and are accessed by READMEM and WRITEMEM.
#pragma once

#include <cstdint>

namespace rigor::gige::reg {

using Address = std::uint32_t;

// Bootstrap.
inline constexpr Address kVersion = 0x0000;
inline constexpr Address kDeviceMode = 0x0004;
inline constexpr Address kMacHigh = 0x0008;
inline constexpr Address kMacLow = 0x000C;
inline constexpr Address kSupportedIpConfiguration = 0x0010;
inline constexpr Address kCurrentIpConfiguration = 0x0014;
inline constexpr Address kCurrentIp = 0x0024;
inline constexpr Address kCurrentMask = 0x0034;
inline constexpr Address kCurrentGateway = 0x0044;
inline constexpr Address kManufacturerName = 0x0048;
inline constexpr Address kModelName = 0x0068;
inline constexpr Address kDeviceVersion = 0x0088;
inline constexpr Address kManufacturerInfo = 0x00A8;
inline constexpr Address kSerialNumber = 0x00D8;
inline constexpr Address kUserName = 0x00E8;
inline constexpr Address kFirstUrl = 0x0200;
inline constexpr Address kSecondUrl = 0x0400;
inline constexpr Address kInterfaceCount = 0x0600;
inline constexpr Address kMessageChannelCount = 0x0900;
inline constexpr Address kStreamChannelCount = 0x0904;
inline constexpr Address kActionSignalCount = 0x0908;
inline constexpr Address kActionDeviceKey = 0x090C;
inline constexpr Address kGvcpCapability = 0x0934;
inline constexpr Address kHeartbeatTimeout = 0x0938;
inline constexpr Address kTickFrequencyHigh = 0x093C;
inline constexpr Address kTickFrequencyLow = 0x0940;
inline constexpr Address kTimestampControl = 0x0944;
inline constexpr Address kTimestampHigh = 0x0948;
inline constexpr Address kTimestampLow = 0x094C;
inline constexpr Address kGvcpConfiguration = 0x0954;
inline constexpr Address kIeee1588Status = 0x096C;
inline constexpr Address kActionQueueSize = 0x0970;
inline constexpr Address kControlPrivilege = 0x0A00;
inline constexpr Address kPrimaryPort = 0x0A04;
inline constexpr Address kPrimaryIp = 0x0A14;
inline constexpr Address kStreamPort = 0x0D00;
inline constexpr Address kStreamPacketSize = 0x0D04;
inline constexpr Address kStreamPacketDelay = 0x0D08;
inline constexpr Address kStreamDestination = 0x0D18;
inline constexpr Address kStreamSourcePort = 0x0D1C;
inline constexpr Address kStreamCapability = 0x0D20;
inline constexpr Address kStreamConfiguration = 0x0D24;
inline constexpr Address kBootstrapEnd = 0x0E00;
inline constexpr Address kActionGroupKey = 0x9800;  // of signal 0
inline constexpr Address kActionGroupMask = 0x9804;

inline constexpr std::uint32_t kPrivilegeExclusive = 0x1;
inline constexpr std::uint32_t kPrivilegeControl = 0x2;
// Of GVCP capability and configuration.
inline constexpr std::uint32_t kIeee1588 = 0x80000;
inline constexpr std::uint32_t kExtendedStatus = 0x40000;   // codes of version 2.0
inline constexpr std::uint32_t kScheduledAction = 0x20000;  // of the capability alone
inline constexpr std::uint32_t kUnconditionalCapability = 0x100000, kActionCapability = 0x40;
inline constexpr std::uint32_t kUnconditionalAction = 0x8;  // of the configuration alone
inline constexpr std::uint32_t kTimestampReset = 0x1;
inline constexpr std::uint32_t kTimestampLatch = 0x2;
inline constexpr std::uint32_t kFireTestPacket = 0x80000000;
inline constexpr std::uint32_t kDoNotFragment = 0x40000000;
/// Of stream capability and configuration: multi-part frames (bit 25 as the specification counts).
inline constexpr std::uint32_t kMultipart = 0x40;

// Features.
inline constexpr Address kFeatureBegin = 0x00010000;
inline constexpr Address kWidthMax = 0x00010000;
inline constexpr Address kHeightMax = 0x00010004;
inline constexpr Address kWidth = 0x00010008;
inline constexpr Address kHeight = 0x0001000C;
inline constexpr Address kOffsetX = 0x00010010;
inline constexpr Address kOffsetY = 0x00010014;
inline constexpr Address kPixelFormat = 0x00010018;
inline constexpr Address kPayloadSize = 0x0001001C;
inline constexpr Address kAcquisitionMode = 0x00010100;
inline constexpr Address kAcquisitionFrameCount = 0x00010104;
inline constexpr Address kAcquisitionStart = 0x00010108;
inline constexpr Address kAcquisitionStop = 0x0001010C;
inline constexpr Address kAcquisitionAbort = 0x00010110;
inline constexpr Address kFrameRateEnable = 0x00010114;
inline constexpr Address kFrameRate = 0x00010118;           // double, Hz
inline constexpr Address kResultingFrameRate = 0x00010120;  // double, Hz
inline constexpr Address kAcquisitionActive = 0x00010128;
inline constexpr Address kTlParamsLocked = 0x0001012C;
inline constexpr Address kExposureTime = 0x00010200;  // double, µs
inline constexpr Address kGain = 0x00010300;          // double, dB
inline constexpr Address kTriggerMode = 0x00010400;
inline constexpr Address kTriggerSource = 0x00010404;
inline constexpr Address kTriggerSoftware = 0x00010408;
inline constexpr Address kTriggerActivation = 0x0001040C;
inline constexpr Address kTriggerDelay = 0x00010410;  // double, µs
inline constexpr Address kLineStatus = 0x00010418;
inline constexpr Address kChunkModeActive = 0x00010500;
inline constexpr Address kChunkSelector = 0x00010504;
inline constexpr Address kChunkEnable = 0x00010508;  // of the chunk that is selected
inline constexpr Address kPtpEnable = 0x00010600;    // these only where the camera has a PTP clock
inline constexpr Address kPtpStatus = 0x00010604;
inline constexpr Address kPtpOffsetHigh = 0x00010608;  // ns, signed, as it was at the last latch
inline constexpr Address kPtpOffsetLow = 0x0001060C;
inline constexpr Address kPtpLatch = 0x00010610;
// These only where the camera is a 3D camera.
inline constexpr Address kComponentSelector = 0x00010700;   // the SFNC's ComponentIDValue
inline constexpr Address kComponentEnable = 0x00010704;     // of the component that is selected
inline constexpr Address kScan3dScale = 0x00010708;         // double, mm for a count
inline constexpr Address kScan3dOffset = 0x00010710;        // double, mm
inline constexpr Address kScan3dInvalidValue = 0x00010718;  // double, counts
inline constexpr Address kFeatureEnd = 0x00010720;

// The GenICam description.
inline constexpr Address kXml = 0x00100000;

// Values of the enumerated features.
inline constexpr std::uint32_t kModeContinuous = 0, kModeSingleFrame = 1, kModeMultiFrame = 2;
inline constexpr std::uint32_t kTriggerSourceSoftware = 0, kTriggerSourceLine1 = 1, kTriggerSourceAction0 = 2;
inline constexpr std::uint32_t kRisingEdge = 0, kFallingEdge = 1;

// Chunks, by the ids that they carry behind the picture. Each is its data, then its id and its length,
// big-endian 32 bits each; they are read from the end of the payload (GigE Vision 2.0, extended chunk mode;
// Aravis arvbuffer.c). Values are big-endian.
inline constexpr std::uint32_t kChunkImage = 1;
inline constexpr std::uint32_t kChunkTimestamp = 2;     // u64, ticks
inline constexpr std::uint32_t kChunkExposureTime = 3;  // double, µs
inline constexpr std::uint32_t kChunkGain = 4;          // double, dB
inline constexpr std::uint32_t kChunkFrameId = 5;       // u64, exposures since AcquisitionStart
inline constexpr std::uint32_t kChunkOffsetX = 6, kChunkOffsetY = 7, kChunkWidth = 8,
                               kChunkHeight = 9;        // u64, px
inline constexpr std::uint32_t kChunkPixelFormat = 10;  // u64, PFNC
inline constexpr std::uint32_t kChunkLast = 10;
inline constexpr std::size_t kChunkTrailer = 8, kChunkValue = 8;

// IEEE 1588, states of a port as PtpStatus of the SFNC names them.
inline constexpr std::uint32_t kPtpDisabled = 0, kPtpListening = 1, kPtpUncalibrated = 2, kPtpSlave = 3;

}  // namespace rigor::gige::reg
