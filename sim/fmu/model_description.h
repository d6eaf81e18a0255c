// modelDescription.xml of an FMU as plain values, for FMI 2.0 and 3.0 alike, and the terminals of
// terminalsAndIcons.xml.
//
// Sources: FMI Specification 2.0.4, section 2.2; 3.0.2, section 2.4. What Rigor does not use (model
// structure, derivatives, build configuration) is not read.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"

namespace rigor::fmu {

enum class FmiVersion : std::uint8_t { v2, v3 };

enum class VariableType : std::uint8_t {
  float32,
  float64,
  int8,
  uint8,
  int16,
  uint16,
  int32,
  uint32,
  int64,
  uint64,
  boolean,
  enumeration,
  string,
  binary,
  clock
};
enum class Causality : std::uint8_t {
  parameter,
  calculated_parameter,
  structural_parameter,
  input,
  output,
  local,
  independent,
  dependent
};
enum class Variability : std::uint8_t { constant, fixed, tunable, discrete, continuous };

/// As FMI 3.0 writes them ("Float64", "calculatedParameter", "continuous"); Real, Integer of FMI 2.0 are
/// Float64 and Int32.
[[nodiscard]] std::string_view name_of(VariableType type);
[[nodiscard]] std::string_view name_of(Causality causality);
[[nodiscard]] std::string_view name_of(Variability variability);
/// Whether a double can stand for its value.
[[nodiscard]] bool is_number(VariableType type);

/// value in base units = factor · value + offset
struct Unit {
  std::string name;
  std::array<int, 8> exponents{};  ///< of kg, m, s, A, K, mol, cd, rad
  double factor = 1, offset = 0;
  bool has_base = false;  ///< false: the FMU names the unit and says nothing of it
};

struct Variable {
  std::string name, description, unit;  ///< unit empty: none
  std::uint32_t value_reference = 0;
  VariableType type = VariableType::float64;
  Causality causality = Causality::local;
  Variability variability = Variability::continuous;
  std::string start;                    ///< as it is written; of an array with spaces between; empty: none
  std::vector<std::size_t> dimensions;  ///< empty: a scalar
  std::size_t elements = 1;             ///< product of the dimensions

  /// FMI 3.0: the variable that gives each dimension, by value reference; nothing: a constant.
  std::vector<std::optional<std::uint32_t>> dimension_references;
};

struct CoSimulation {
  std::string model_identifier;
  bool variable_step = false;
  bool event_mode = false;          ///< FMI 3.0: hasEventMode
  bool might_return_early = false;  ///< FMI 3.0
  bool once_per_process = false;
  bool needs_execution_tool = false;
  std::optional<double> fixed_internal_step_s;
};

struct Terminal {
  std::string name, matching_rule, kind;
  struct Member {
    std::string name, variable;
  };
  std::vector<Member> members;
};

struct ModelDescription {
  FmiVersion version = FmiVersion::v3;
  std::string fmi_version, model_name, token, description, generation_tool;  ///< token: guid of FMI 2.0
  std::optional<CoSimulation> co_simulation;
  bool model_exchange = false, scheduled_execution = false;
  std::optional<double> start_time_s, stop_time_s, step_s;  ///< of DefaultExperiment
  std::vector<Unit> units;
  std::vector<Variable> variables;
  std::vector<Terminal> terminals;

  /// nullptr: none.
  [[nodiscard]] const Unit* unit(std::string_view name) const;

  /// A scalar, or an element of an array: `T`, `u[2]`, `A[1,3]` (from 1 on, row by row), or
  /// `TERMINAL.MEMBER`.
  struct Element {
    std::size_t variable = 0;  ///< index in `variables`
    std::size_t element = 0;
    bool whole = false;  ///< an array without index
  };
  /// Empty: there is none of this name.
  [[nodiscard]] std::optional<Element> find(std::string_view name) const;
  /// Names for messages: those of `causalities`, or all where it is empty.
  [[nodiscard]] std::vector<std::string> names_of(std::initializer_list<Causality> causalities) const;
};

/// Limits on what comes from a file.
inline constexpr std::size_t kMaxDescriptionBytes = std::size_t{64} << 20;
inline constexpr std::size_t kMaxVariables = 1'000'000;
inline constexpr std::size_t kMaxElements = 65'536;  ///< of one array
inline constexpr std::size_t kMaxTotalElements = 4'000'000;

/// bad_input with `where` and the line. Any thread; allocates.
[[nodiscard]] Result<ModelDescription> parse_model_description(std::string_view xml,
                                                               const std::string& where);
/// Adds the terminals of terminalsAndIcons.xml.
[[nodiscard]] Status parse_terminals(std::string_view xml, const std::string& where,
                                     ModelDescription& description);
/// FMI 3.0: with a structural parameter (value reference, value) in place of its start value the arrays have
/// other sizes. bad_input: too many elements.
[[nodiscard]] Status set_structural_parameter(ModelDescription& description, std::uint32_t value_reference,
                                              std::uint64_t value, const std::string& where);

}  // namespace rigor::fmu
