// The register map of the emulated USB3 Vision camera: bootstrap registers as GenCP 1.2 (ABRM) and USB3
// Vision 1.0.1 (SBRM, SIRM, EIRM) place them, its features behind them, the manifest and the GenICam
// description. All registers are little-endian.
#pragma once

#include <cstddef>
#include <cstdint>

namespace rigor::u3v::reg {

using Address = std::uint64_t;

// Technology-agnostic bootstrap registers.
inline constexpr Address kGenCpVersion = 0x0000;
inline constexpr Address kManufacturerName = 0x0004;
inline constexpr Address kModelName = 0x0044;
inline constexpr Address kFamilyName = 0x0084;
inline constexpr Address kDeviceVersion = 0x00C4;
inline constexpr Address kManufacturerInfo = 0x0104;
inline constexpr Address kSerialNumber = 0x0144;
inline constexpr Address kUserName = 0x0184;
inline constexpr std::size_t kTextBytes = 64;
inline constexpr Address kDeviceCapability = 0x01C4;
inline constexpr Address kMaxResponseTime = 0x01CC;  // ms
inline constexpr Address kManifestAddress = 0x01D0;
inline constexpr Address kSbrmAddress = 0x01D8;
inline constexpr Address kDeviceConfiguration = 0x01E0;
inline constexpr Address kHeartbeatTimeout = 0x01E8;
inline constexpr Address kMessageChannel = 0x01EC;
inline constexpr Address kTimestamp = 0x01F0;  // as it was at the last latch
inline constexpr Address kTimestampLatch = 0x01F8;
inline constexpr Address kTimestampIncrement = 0x01FC;  // ns for a tick
inline constexpr Address kAccessPrivilege = 0x0204;
inline constexpr Address kProtocolEndianness = 0x0208;
inline constexpr Address kImplementationEndianness = 0x020C;

// Technology-specific bootstrap registers.
inline constexpr Address kSbrm = 0x00010000;
inline constexpr Address kU3vVersion = kSbrm + 0x00;
inline constexpr Address kU3vCapability = kSbrm + 0x04;
inline constexpr Address kU3vConfiguration = kSbrm + 0x0C;
inline constexpr Address kMaxCommandTransfer = kSbrm + 0x14;
inline constexpr Address kMaxAckTransfer = kSbrm + 0x18;
inline constexpr Address kStreamChannelCount = kSbrm + 0x1C;
inline constexpr Address kSirmAddress = kSbrm + 0x20;
inline constexpr Address kSirmLength = kSbrm + 0x28;
inline constexpr Address kEirmAddress = kSbrm + 0x2C;
inline constexpr Address kEirmLength = kSbrm + 0x34;
inline constexpr Address kIidc2Address = kSbrm + 0x38;
inline constexpr Address kCurrentSpeed = kSbrm + 0x40;

// Streaming interface.
inline constexpr Address kSirm = 0x00020000;
inline constexpr Address kStreamInfo =
    kSirm + 0x00;  // bits 24 … 31: alignment of transfers as a power of two
inline constexpr Address kStreamControl = kSirm + 0x04;
inline constexpr Address kRequiredPayload = kSirm + 0x08;
inline constexpr Address kRequiredLeader = kSirm + 0x10;
inline constexpr Address kRequiredTrailer = kSirm + 0x14;
inline constexpr Address kMaxLeader = kSirm + 0x18;
inline constexpr Address kTransferSize = kSirm + 0x1C;
inline constexpr Address kTransferCount = kSirm + 0x20;
inline constexpr Address kFinalTransfer1 = kSirm + 0x24;
inline constexpr Address kFinalTransfer2 = kSirm + 0x28;
inline constexpr Address kMaxTrailer = kSirm + 0x2C;
inline constexpr Address kSirmEnd = kSirm + 0x30;

// Event interface.
inline constexpr Address kEirm = 0x00030000;
inline constexpr Address kEventControl = kEirm + 0x00;
inline constexpr Address kMaxEventTransfer = kEirm + 0x04;
inline constexpr Address kEventTest = kEirm + 0x08;
inline constexpr Address kEirmEnd = kEirm + 0x0C;

// Features.
inline constexpr Address kFeatures = 0x00100000;
inline constexpr Address kSensorWidth = kFeatures + 0x00;
inline constexpr Address kSensorHeight = kFeatures + 0x04;
inline constexpr Address kWidth = kFeatures + 0x08;
inline constexpr Address kHeight = kFeatures + 0x0C;
inline constexpr Address kOffsetX = kFeatures + 0x10;
inline constexpr Address kOffsetY = kFeatures + 0x14;
inline constexpr Address kPixelFormat = kFeatures + 0x18;
inline constexpr Address kPayloadSize = kFeatures + 0x1C;
inline constexpr Address kTlParamsLocked = kFeatures + 0x20;
inline constexpr Address kAcquisitionMode = kFeatures + 0x100;
inline constexpr Address kAcquisitionFrameCount = kFeatures + 0x104;
inline constexpr Address kAcquisitionStart = kFeatures + 0x108;
inline constexpr Address kAcquisitionStop = kFeatures + 0x10C;
inline constexpr Address kAcquisitionStatus = kFeatures + 0x110;
inline constexpr Address kFrameRateEnable = kFeatures + 0x114;
inline constexpr Address kFrameRate = kFeatures + 0x118;           // double, Hz
inline constexpr Address kResultingFrameRate = kFeatures + 0x120;  // double, Hz
inline constexpr Address kExposureTime = kFeatures + 0x128;        // double, µs
inline constexpr Address kGain = kFeatures + 0x130;                // double, dB
inline constexpr Address kTriggerMode = kFeatures + 0x140;
inline constexpr Address kTriggerSource = kFeatures + 0x144;
inline constexpr Address kTriggerActivation = kFeatures + 0x148;
inline constexpr Address kTriggerSoftware = kFeatures + 0x14C;
inline constexpr Address kTriggerDelay = kFeatures + 0x150;  // double, µs
inline constexpr Address kLineStatus = kFeatures + 0x158;
inline constexpr Address kEventNotification = kFeatures + 0x15C;  // of ExposureStart
inline constexpr Address kFeaturesEnd = kFeatures + 0x160;

// The manifest: a count, then an entry of 64 bytes for each file (GenCP 1.2, table 5-3).
inline constexpr Address kManifest = 0x00200000;
inline constexpr std::size_t kManifestBytes = 8 + 64;
inline constexpr Address kXml = 0x00300000;

// Values.
inline constexpr std::uint32_t kStreamEnable = 1, kEventEnable = 1;
inline constexpr std::uint32_t kSirmAvailable = 1, kEirmAvailable = 2;
inline constexpr std::uint32_t kSuperSpeed = 8;
inline constexpr std::uint32_t kLittleEndian = 0xFFFFFFFF;
inline constexpr std::uint32_t kModeContinuous = 0, kModeSingleFrame = 1, kModeMultiFrame = 2;
inline constexpr std::uint32_t kTriggerSourceSoftware = 0, kTriggerSourceLine1 = 1;
inline constexpr std::uint32_t kRisingEdge = 0, kFallingEdge = 1;
inline constexpr std::uint32_t kAlignmentLog2 = 10, kAlignment = 1u << kAlignmentLog2;  // a SuperSpeed packet
inline constexpr std::uint32_t kMaxTransfer = 16384;  // of the control interface

}  // namespace rigor::u3v::reg
