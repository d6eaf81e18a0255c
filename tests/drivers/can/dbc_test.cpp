// DBC files: what is read, what is refused and where, and what is passed over.
#include "drivers/can/dbc.h"

#include "drivers/can/signal_codec.h"
#include "tests/paths.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

namespace rigor::can {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

Dbc good(std::string_view text) {
  auto dbc = parse_dbc(text, "t.dbc");
  EXPECT_TRUE(dbc) << (dbc ? "" : dbc.error().text());
  return dbc ? *dbc : Dbc{};
}
std::string bad(std::string_view text) {
  auto dbc = parse_dbc(text, "t.dbc");
  if (dbc) return "was accepted";
  EXPECT_EQ(dbc.error().code, ErrorCode::bad_input);
  return dbc.error().text();
}

constexpr std::string_view kHead = "VERSION \"\"\nNS_ :\n\tCM_\n\tBA_DEF_\n\tVAL_\n\nBS_:\nBU_: PCM1 FOO\n";

TEST(Dbc, MessagesHaveTheirSignals) {
  const auto dbc = good(std::string(kHead) + R"(
BO_ 496 ExampleMessage: 8 PCM1
 SG_ Temperature : 0|12@0- (0.01,250) [229.52|270.47] "degK"  PCM1,FOO
 SG_ AverageRadius : 6|6@0+ (0.1,0) [0|5] "m" Vector__XXX
 SG_ Enable : 7|1@0+ (1,0) [0|0] "-" Vector__XXX

BO_ 2147484160 Far: 4 Vector__XXX
 SG_ A : 0|32@1+ (1E-3,-40) [-1e6|1.5E+6] "" FOO

CM_ BO_ 496 "A comment; with a semicolon
 and BO_ 12 on a line of its own";
VAL_ 496 Enable 0 "Disabled" 1 "Enabled" ;
)");
  EXPECT_EQ(dbc.nodes, (std::vector<std::string>{"PCM1", "FOO"}));
  ASSERT_EQ(dbc.messages.size(), 2u);
  const Message& m = dbc.messages[0];
  EXPECT_EQ(m.name, "ExampleMessage");
  EXPECT_EQ(m.id, 496u);
  EXPECT_FALSE(m.extended);
  EXPECT_EQ(m.length, 8);
  EXPECT_EQ(m.senders, std::vector<std::string>{"PCM1"});
  ASSERT_EQ(m.signals.size(), 3u);
  const Signal& t = m.signals[0];
  EXPECT_EQ(t.order, BitOrder::motorola);
  EXPECT_TRUE(t.is_signed);
  EXPECT_EQ(t.start_bit, 0);
  EXPECT_EQ(t.length_bits, 12);
  EXPECT_EQ(t.factor, 0.01);
  EXPECT_EQ(t.offset, 250);
  EXPECT_EQ(t.minimum, 229.52);
  EXPECT_EQ(t.unit, "degK");
  EXPECT_FALSE(m.signals[2].has_range());
  ASSERT_EQ(m.signals[2].values.size(), 2u);
  EXPECT_EQ(m.signals[2].values[1].text, "Enabled");
  const Message* far = dbc.message(0x200, true);
  ASSERT_NE(far, nullptr);
  EXPECT_EQ(far->signals[0].factor, 1e-3);
  EXPECT_EQ(far->signals[0].offset, -40);
  EXPECT_EQ(far->signals[0].maximum, 1.5e6);
  EXPECT_TRUE(far->senders.empty());
  EXPECT_EQ(dbc.message(0x200, false), nullptr);
}

TEST(Dbc, AttributesGiveCyclesFormatsAndStartValues) {
  const auto dbc = good(std::string(kHead) + R"(
BO_ 1 Cyclic: 8 PCM1
 SG_ A : 0|8@1+ (1,0) [0|0] "" FOO
BO_ 2 Event: 8 PCM1
 SG_ B : 0|8@1+ (1,0) [0|0] "" FOO
BO_ 3 Wide: 8 PCM1
 SG_ C : 0|8@1+ (1,0) [0|0] "" FOO
BO_ 4 Long: 64 PCM1
 SG_ D : 504|8@1+ (1,0) [0|0] "" FOO
BO_TX_BU_ 2 : PCM1,FOO;
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","StandardCAN_FD";
BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";
BA_DEF_ SG_ "GenSigStartValue" INT 0 100;
BA_DEF_ "Elsewhere" STRING ;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "CANFD_BRS" "1";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "Elsewhere" "x";
BA_ "GenMsgCycleTime" BO_ 1 20;
BA_ "VFrameFormat" BO_ 3 2;
BA_ "GenSigStartValue" SG_ 2 B 7;
)");
  EXPECT_EQ(dbc.message("Cyclic")->cycle, milliseconds(20));
  EXPECT_FALSE(dbc.message("Cyclic")->fd);
  EXPECT_EQ(dbc.message("Event")->cycle, Duration(0));
  EXPECT_EQ(dbc.message("Event")->senders, (std::vector<std::string>{"PCM1", "FOO"}));
  EXPECT_EQ(dbc.message("Event")->signals[0].start_raw, 7);
  EXPECT_TRUE(dbc.message("Wide")->fd);
  EXPECT_TRUE(dbc.message("Wide")->bit_rate_switch);
  EXPECT_TRUE(dbc.message("Long")->fd);
}

TEST(Dbc, MultiplexedSignalsKnowTheirMultiplexor) {
  const auto dbc = good(std::string(kHead) + R"(
BO_ 1 Simple: 8 PCM1
 SG_ Mux M : 0|8@1+ (1,0) [0|0] "" FOO
 SG_ A m0 : 8|8@1+ (1,0) [0|0] "" FOO
 SG_ B m1 : 8|8@1+ (1,0) [0|0] "" FOO
 SG_ Always : 16|8@1+ (1,0) [0|0] "" FOO
BO_ 2 Extended: 8 PCM1
 SG_ S1 m0M : 8|8@1+ (1,0) [0|0] "" FOO
 SG_ S0 M : 0|8@1+ (1,0) [0|0] "" FOO
 SG_ S2 m3 : 16|8@1+ (1,0) [0|0] "" FOO
SG_MUL_VAL_ 2 S1 S0 0-0, 3-5;
SG_MUL_VAL_ 2 S2 S1 3-3;
)");
  const Message& m = dbc.messages[0];
  EXPECT_TRUE(m.signals[0].multiplexor);
  EXPECT_EQ(m.signals[1].multiplexed_by, 0);
  EXPECT_TRUE(m.signals[2].shown_by(1));
  EXPECT_FALSE(m.signals[2].shown_by(0));
  EXPECT_EQ(m.signals[3].multiplexed_by, -1);
  const Message& x = dbc.messages[1];
  EXPECT_EQ(x.signals[0].multiplexed_by, 1);
  EXPECT_TRUE(x.signals[0].shown_by(4));
  EXPECT_FALSE(x.signals[0].shown_by(2));
  EXPECT_EQ(x.signals[2].multiplexed_by, 0);
}

/// `levels` multiplexors of 4 bits, each selected by value 1 of the one before, and `Last` below them.
std::string chain(int levels) {
  std::string text = "BO_ 1 M: 8 N\n";
  for (int i = 0; i <= levels; ++i)
    text += " SG_ " + (i == levels ? std::string("Last") : "S" + std::to_string(i)) +
            (i == 0        ? " M"
             : i == levels ? " m1"
                           : " m1M") +
            " : " + std::to_string(4 * i) + "|4@1+ (1,0) [0|0] \"\" N\n";
  for (int i = 1; i <= levels; ++i)
    text += "SG_MUL_VAL_ 1 " + (i == levels ? std::string("Last") : "S" + std::to_string(i)) + " S" +
            std::to_string(i - 1) + " 1-1;\n";
  return text;
}

TEST(Dbc, ChainsOfMultiplexorsAreEncodedDownToTheirLimitAndRefusedBeyond) {
  const auto dbc = good(chain(8));
  const Message& m = dbc.messages[0];
  CanFrame f = blank_frame(m);
  std::vector<double> values(9, 1);
  values[8] = 9;
  std::size_t wrong = 0;
  ASSERT_EQ(encode(m, values, f, wrong), EncodeStatus::good);
  EXPECT_EQ(decode(m, 8, std::span(f.data).first(8)), 9) << "the signal below eight multiplexors";
  values[3] = 2;  // selects another branch
  ASSERT_EQ(encode(m, values, f, wrong), EncodeStatus::good);
  EXPECT_TRUE(std::isnan(decode(m, 8, std::span(f.data).first(8))));
  EXPECT_EQ(bad(chain(9)),
            "t.dbc:20:20: expected at most 8 multiplexors above a signal of M, got 9 above Last");
}

TEST(Dbc, FloatsTablesAndForeignSectionsAreRead) {
  const auto dbc = good(R"(VERSION "1"
BU_: N
VAL_TABLE_ OnOff 1 "on" 0 "off" ;
BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX
 SG_ Loose : 0|16@1+ (1,0) [0|0] "" Vector__XXX
BO_ 1024 M: 8 N
 SG_ D : 0|64@1- (1,0) [0|0] "" N
BO_ 1025 F: 8 N
 SG_ X : 0|32@1- (1,0) [0|0] "" N
 SG_ Y : 32|8@1+ (1,0) [0|0] "" N
EV_ Env: 0 [0|1] "" 0 2 DUMMY_NODE_VECTOR0 Vector__XXX;
FUTURE_SECTION_ 12 {anything "goes; here"} 5;
SIG_GROUP_ 1025 Group 1 : X Y;
VAL_ Env 1 "a" ;
VAL_ 1025 Y OnOff ;
SIG_VALTYPE_ 1024 D : 2;
SIG_VALTYPE_ 1025 X : 1;
)");
  ASSERT_EQ(dbc.messages.size(), 2u);
  EXPECT_EQ(dbc.messages[0].signals[0].type, RawType::float64);
  EXPECT_EQ(dbc.messages[1].signals[0].type, RawType::float32);
  ASSERT_EQ(dbc.messages[1].signals[1].values.size(), 2u);
  EXPECT_EQ(dbc.messages[1].signals[1].values[0].text, "on");
}

TEST(Dbc, UnitsOfWindows1252BecomeUtf8) {
  const auto dbc = good(
      "BU_: N\nBO_ 1 M: 1 N\n SG_ T : 0|8@1+ (1,0) [0|0] \"\xb0"
      "C\" N\n SG_ U : 0|8@1+ (1,0) [0|0] \"\xc2\xb5s\" N\n");
  EXPECT_EQ(dbc.messages[0].signals[0].unit,
            "\xc2\xb0"
            "C");
  EXPECT_EQ(dbc.messages[0].signals[1].unit, "\xc2\xb5s");
}

TEST(Dbc, ErrorsGiveThePlace) {
  EXPECT_THAT(bad("BU_: N\nBO_ 1 M: 8 N\n SG_ A : 0|8@2+ (1,0) [0|0] \"\" N\n"),
              StartsWith("t.dbc:3:14: expected a bit order, 0 (Motorola) or 1 (Intel)"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A : 60|8@1+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("t.dbc:2:10: expected a signal of at most 64 bits within the 8 bytes of M, got A of "
                        "8 bits from bit 60"));
  // Motorola: 8 bits from bit 60 run down to bit 56 and on into byte 8, which is not there; from 63 they fit.
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A : 60|8@0+ (1,0) [0|0] \"\" N\n"), HasSubstr("within the 8 bytes"));
  EXPECT_EQ(bad("BO_ 1 M: 8 N\n SG_ A : 63|8@0+ (1,0) [0|0] \"\" N\n"), "was accepted");
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A : 0|8@1+ (1;0) [0|0] \"\" N\n"),
              HasSubstr("t.dbc:2:19: expected `,`, got `;`"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A : 0|8@1+ (0,0) [0|0] \"\" N\n"), HasSubstr("a factor other than 0"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\nBO_ 1 O: 8 N\n"),
              StartsWith("t.dbc:2:5: expected an identifier that no message before has"));
  EXPECT_THAT(bad("BO_ 2048 M: 8 N\n"), HasSubstr("expected an identifier up to 2047"));
  EXPECT_THAT(bad(" SG_ A : 0|8@1+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("expected a message (`BO_`) in front of its signals"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A m : 0|8@1+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("how the signal is multiplexed"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A m1 : 0|8@1+ (1,0) [0|0] \"\" N\n"),
              HasSubstr("multiplexed signal A of M"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A : 0|8@1+ (1,0) [0|0] \"deg"),
              HasSubstr("t.dbc:2:29: expected a closing"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\nVAL_ 2 A 1 \"x\" ;\n"),
              HasSubstr("t.dbc:2:6: expected the identifier of a message"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A : 0|8@1+ (1,0) [0|0] \"\" N\nSIG_VALTYPE_ 1 A : 1;\n"),
              HasSubstr("expected a signal of 32 bits"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A M : 0|8@1+ (1,0) [0|0] \"\" N\n SG_ B M : 8|8@1+ (1,0) [0|0] \"\" N\n"
                  "SG_MUL_VAL_ 1 A B 1-1;\nSG_MUL_VAL_ 1 B A 1-1;\n"),
              StartsWith("t.dbc:4:17: expected multiplexors of M that do not select each other in a circle"));
  EXPECT_THAT(
      bad("BO_ 1 M: 8 N\n SG_ A m1M : 0|8@1+ (1,0) [0|0] \"\" N\nSG_MUL_VAL_ 1 A A 1-1;\n"),
      StartsWith("t.dbc:3:17: expected multiplexors of M that do not select each other in a circle, nor "
                 "themselves, got A"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A m1M : 0|8@1+ (1,0) [0|0] \"\" N\n"),
              StartsWith("t.dbc:2:6: expected a line SG_MUL_VAL_ or one multiplexor"));
  EXPECT_THAT(bad("BO_ 1 M: 8 N\n SG_ A M : 0|8@1+ (1,0) [0|0] \"\" N\n SG_ B M : 8|8@1+ (1,0) [0|0] \"\" N\n"
                  " SG_ C m1 : 16|8@1+ (1,0) [0|0] \"\" N\nSG_MUL_VAL_ 1 A B 1-1;\nSG_MUL_VAL_ 1 B A 1-1;\n"
                  "SG_MUL_VAL_ 1 C A 1-1;\n"),
              HasSubstr("circle"));
  EXPECT_THAT(bad("BO_ 1 M: 99999999999 N\n"), HasSubstr("a whole number from 0 to 65535"));
}

TEST(Dbc, AFileThatIsNotThereIsNamed) {
  const auto dbc = load_dbc("/nowhere/at/all.dbc");
  ASSERT_FALSE(dbc);
  EXPECT_EQ(dbc.error().code, ErrorCode::not_found);
  EXPECT_THAT(dbc.error().text(), HasSubstr("/nowhere/at/all.dbc"));
}

TEST(Dbc, TheFilesThatComeAlongAreRead) {
  int files = 0;
  for (const auto& entry :
       std::filesystem::directory_iterator(rigor::test::source_dir() + "/configs/buses")) {
    if (entry.path().extension() != ".dbc") continue;
    const auto dbc = load_dbc(entry.path());
    EXPECT_TRUE(dbc) << (dbc ? "" : dbc.error().text());
    ++files;
  }
  EXPECT_GT(files, 0);
}

}  // namespace
}  // namespace rigor::can
