# How every target of the project is made: one include root, one set of warnings, one set of sanitizers.
find_package(Threads REQUIRED)
find_package(tl-expected REQUIRED)
find_package(fmt REQUIRED)
find_package(Eigen3 REQUIRED)
find_package(nlohmann_json REQUIRED)
set(CMAKE_CXX_COMPILER_LAUNCHER ${CMAKE_SOURCE_DIR}/tools/with_ccache.sh)

# Both are on unless a preset says otherwise, for builds from nothing. The preset dev compiles file by file, so that a change
# of one file compiles that file alone.
option(RIGOR_UNITY "Compile the files of a library, or of a test, several at a time" ON)
option(RIGOR_PRECOMPILED "Precompile the headers that most files include" ON)

add_library(rigor_options INTERFACE)
target_include_directories(rigor_options INTERFACE ${CMAKE_SOURCE_DIR})
target_compile_options(rigor_options INTERFACE -Wall -Wextra -Wshadow -Wnon-virtual-dtor -Wconversion
                                               -Wno-sign-conversion "$<$<CXX_COMPILER_ID:GNU>:-Wno-restrict;-Wno-stringop-overflow;-Wno-stringop-overread;-Wno-array-bounds;-Wno-maybe-uninitialized>"
                                               -fno-omit-frame-pointer)
# -pthread defines a macro, and precompiled headers want it alike everywhere; some dependencies ask for it.
target_compile_options(rigor_options INTERFACE -pthread)
target_link_libraries(rigor_options INTERFACE tl::expected fmt::fmt Eigen3::Eigen nlohmann_json::nlohmann_json Threads::Threads)
# These of GCC 12 misfire where std::string + const char* and Eigen are inlined (gcc.gnu.org/PR105651).
# No fused multiply-add behind our back: derived floats agree between builds of one architecture.
target_compile_options(rigor_options INTERFACE -ffp-contract=off)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # GCC collects its garbage far less often: a tenth less time, for 200 MB more memory in each compiler.
  target_compile_options(rigor_options INTERFACE "SHELL:--param ggc-min-expand=100" "SHELL:--param ggc-min-heapsize=1048576")
endif()
# gold links an executable of this size in 0.3 s, where ld.bfd takes 1 s; it comes with binutils.
include(CheckLinkerFlag)
check_linker_flag(CXX -fuse-ld=gold RIGOR_LINKER_GOLD)
if(RIGOR_LINKER_GOLD)
  target_link_options(rigor_options INTERFACE -fuse-ld=gold)
endif()
if(RIGOR_UNITY AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # A file that is included looks like a header: its types may use its own anonymous namespace all the same.
  target_compile_options(rigor_options INTERFACE -Wno-subobject-linkage)
endif()
if(RIGOR_SANITIZE)
  target_compile_options(rigor_options INTERFACE -fsanitize=${RIGOR_SANITIZE} -fno-sanitize-recover=all)
  target_link_options(rigor_options INTERFACE -fsanitize=${RIGOR_SANITIZE})
endif()
if(RIGOR_FUZZ)
  set(RIGOR_FUZZ_OPTION -fsanitize=fuzzer-no-link)
  target_link_options(rigor_options INTERFACE ${RIGOR_FUZZ_OPTION})
endif()

# The headers that most files include, precompiled once for libraries and once, with GoogleTest, for tests (whose flags differ).
set(RIGOR_COMMON_HEADERS <algorithm> <array> <atomic> <chrono> <cmath> <cstdint> <cstring> <filesystem> <fstream> <functional>
    <map> <memory> <mutex> <optional> <set> <span> <sstream> <string> <string_view> <thread> <tuple> <unordered_map> <utility>
    <variant> <vector> <tl/expected.hpp> <fmt/format.h> <Eigen/Geometry> <nlohmann/json.hpp>)
# rigor_precompiled(NAME HEADERS... LINKS targets...): a target whose precompiled headers others reuse.
function(rigor_precompiled NAME)
  cmake_parse_arguments(ARG "" "" "HEADERS;LINKS" ${ARGN})
  file(WRITE ${CMAKE_BINARY_DIR}/generated/${NAME}.cpp "")
  add_library(${NAME} OBJECT ${CMAKE_BINARY_DIR}/generated/${NAME}.cpp)
  target_link_libraries(${NAME} PRIVATE rigor_options ${ARG_LINKS})
  target_precompile_headers(${NAME} PRIVATE ${ARG_HEADERS})
endfunction()
if(RIGOR_PRECOMPILED)
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    target_compile_options(rigor_options INTERFACE -fpch-preprocess)  # what ccache reads
  endif()
  rigor_precompiled(rigor_headers HEADERS ${RIGOR_COMMON_HEADERS})
  set_target_properties(rigor_headers PROPERTIES POSITION_INDEPENDENT_CODE ON)
  if(RIGOR_FUZZ)
    target_compile_options(rigor_headers PRIVATE ${RIGOR_FUZZ_OPTION})  # as for libraries
  endif()
endif()

# rigor_library(NAME SOURCES... [APART sources...] [LINKS targets...] [PRIVATE_LINKS targets...])
# APART: sources that have names of their own in common with others of the library.
function(rigor_library NAME)
  cmake_parse_arguments(ARG "" "" "SOURCES;APART;LINKS;PRIVATE_LINKS" ${ARGN})
  add_library(${NAME} STATIC ${ARG_SOURCES} ${ARG_APART})
  target_link_libraries(${NAME} PUBLIC rigor_options ${ARG_LINKS} PRIVATE ${ARG_PRIVATE_LINKS})
  set_target_properties(${NAME} PROPERTIES POSITION_INDEPENDENT_CODE ON)
  set_source_files_properties(${ARG_APART} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  rigor_compile_options(${NAME})
endfunction()

# rigor_compile_options(NAME): how a library is compiled: several files at a time and with precompiled headers, where the
# build's options say so; beside fuzz harnesses so that these see which branches are taken.
function(rigor_compile_options NAME)
  if(RIGOR_FUZZ)
    target_compile_options(${NAME} PRIVATE ${RIGOR_FUZZ_OPTION})
  endif()
  set_target_properties(${NAME} PROPERTIES UNITY_BUILD ${RIGOR_UNITY} UNITY_BUILD_BATCH_SIZE 12)
  if(RIGOR_PRECOMPILED)
    target_precompile_headers(${NAME} REUSE_FROM rigor_headers)
  endif()
endfunction()

# rigor_program_options(NAME): how a program that is no test is compiled: as libraries are, whose precompiled headers it reads.
function(rigor_program_options NAME)
  rigor_compile_options(${NAME})
  target_compile_options(${NAME} PRIVATE -fPIC)
endfunction()

# What tests test is optimised as ever; the tests themselves need not be.
set(RIGOR_TEST_OPTIONS $<$<CONFIG:Release>:-O1>)

# rigor_test(NAME SOURCES... [APART sources...] LINKS... [IN_TURN what|ALONE] [WALL_CLOCK cases...] [TIMEOUT seconds]): a GoogleTest
# binary whose cases ctest knows one by one.
# WALL_CLOCK: those cases (patterns of --gtest_filter) whose verdict depends on how promptly this machine runs threads and passes
# on packets; tools/run_tests.py runs them again where they fail. IN_TURN: these cases, or all where none are named, run one after
# the other over all binaries that name the same thing (`gige`: the one port of GigE Vision; `loop`: a wall-clock run with all its
# threads), with other tests beside them. ALONE: they measure microseconds, and nothing runs beside them. APART: as for
# rigor_library.
function(rigor_test NAME)
  cmake_parse_arguments(ARG "ALONE" "TIMEOUT;IN_TURN" "SOURCES;APART;LINKS;LABELS;WALL_CLOCK" ${ARGN})
  find_package(GTest REQUIRED)
  include(GoogleTest)
  add_executable(${NAME} ${ARG_SOURCES} ${ARG_APART})
  set_target_properties(${NAME} PROPERTIES UNITY_BUILD ${RIGOR_UNITY} UNITY_BUILD_BATCH_SIZE 6)
  set_source_files_properties(${ARG_APART} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  target_link_libraries(${NAME} PRIVATE rigor_options ${ARG_LINKS} GTest::gtest_main GTest::gmock)
  target_compile_definitions(${NAME} PRIVATE RIGOR_SOURCE_DIR="${CMAKE_SOURCE_DIR}"
                                             RIGOR_BINARY_DIR="${CMAKE_BINARY_DIR}")
  set_target_properties(${NAME} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
  target_compile_options(${NAME} PRIVATE ${RIGOR_TEST_OPTIONS})
  if(RIGOR_PRECOMPILED)
    if(NOT TARGET rigor_test_headers)
      rigor_precompiled(rigor_test_headers HEADERS ${RIGOR_COMMON_HEADERS} <gmock/gmock.h> <gtest/gtest.h>
                        LINKS GTest::gtest_main GTest::gmock)
      target_compile_options(rigor_test_headers PRIVATE ${RIGOR_TEST_OPTIONS})
    endif()
    target_precompile_headers(${NAME} REUSE_FROM rigor_test_headers)
  endif()
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 120)
  endif()
  # The longest first, and those that take turns before all others.
  set(PROPS TIMEOUT ${ARG_TIMEOUT} COST ${ARG_TIMEOUT})
  set(TURNS)
  if(ARG_IN_TURN)
    set(TURNS RESOURCE_LOCK ${ARG_IN_TURN} COST 1000)
  elseif(ARG_ALONE)
    set(TURNS RUN_SERIAL TRUE)
  endif()
  if(ARG_LABELS)
    list(APPEND PROPS LABELS "${ARG_LABELS}")
  endif()
  if(RIGOR_SANITIZE MATCHES "thread")
    list(APPEND PROPS ENVIRONMENT "TSAN_OPTIONS=suppressions=${CMAKE_SOURCE_DIR}/tests/tsan.supp")
  endif()
  if(ARG_WALL_CLOCK)
    string(JOIN ":" CASES ${ARG_WALL_CLOCK})
    gtest_discover_tests(${NAME} DISCOVERY_MODE PRE_TEST TEST_FILTER "${CASES}" PROPERTIES ${PROPS} ${TURNS} LABELS wall-clock)
    if(NOT CASES STREQUAL "*")
      gtest_discover_tests(${NAME} DISCOVERY_MODE PRE_TEST TEST_FILTER "-${CASES}" PROPERTIES ${PROPS})
    endif()
  else()
    gtest_discover_tests(${NAME} DISCOVERY_MODE PRE_TEST PROPERTIES ${PROPS} ${TURNS})
  endif()
endfunction()

# rigor_benchmark(NAME SOURCES... LINKS...): build/<preset>/benches/NAME, each takes --json FILE.
function(rigor_benchmark NAME)
  cmake_parse_arguments(ARG "" "" "SOURCES;LINKS" ${ARGN})
  add_executable(${NAME} ${ARG_SOURCES})
  target_link_libraries(${NAME} PRIVATE rigor_options ${ARG_LINKS})
  set_target_properties(${NAME} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/benches)
  rigor_program_options(${NAME})
endfunction()
