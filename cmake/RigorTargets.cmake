# How every target of the project is made: one include root, one set of warnings, one set of sanitizers.
find_package(Threads REQUIRED)
find_package(tl-expected REQUIRED)
find_program(CCACHE ccache)
if(CCACHE)
  set(CMAKE_CXX_COMPILER_LAUNCHER ${CCACHE})
endif()

add_library(rigor_options INTERFACE)
target_include_directories(rigor_options INTERFACE ${CMAKE_SOURCE_DIR})
target_compile_options(rigor_options INTERFACE -Wall -Wextra -Wshadow -Wnon-virtual-dtor -Wconversion
                                               -Wno-sign-conversion $<$<CXX_COMPILER_ID:GNU>:-Wno-restrict> -fno-omit-frame-pointer)
target_link_libraries(rigor_options INTERFACE tl::expected Threads::Threads)
# -Wrestrict of GCC 12 misfires on std::string + const char* (gcc.gnu.org/PR105651).
# No fused multiply-add behind our back: derived floats agree between builds of one architecture.
target_compile_options(rigor_options INTERFACE -ffp-contract=off)
if(RIGOR_SANITIZE STREQUAL "thread" AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  target_compile_options(rigor_options INTERFACE -Wno-tsan)  # fences: rt-core/spsc_ring.h tells the sanitizer itself
endif()
if(RIGOR_SANITIZE)
  target_compile_options(rigor_options INTERFACE -fsanitize=${RIGOR_SANITIZE} -fno-sanitize-recover=all)
  target_link_options(rigor_options INTERFACE -fsanitize=${RIGOR_SANITIZE})
endif()

# rigor_library(NAME SOURCES... [APART sources...] [LINKS targets...] [PRIVATE_LINKS targets...])
# APART: sources that have names of their own in common with others of the library.
function(rigor_library NAME)
  cmake_parse_arguments(ARG "" "" "SOURCES;APART;LINKS;PRIVATE_LINKS" ${ARGN})
  add_library(${NAME} STATIC ${ARG_SOURCES} ${ARG_APART})
  set_source_files_properties(${ARG_APART} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  target_link_libraries(${NAME} PUBLIC rigor_options ${ARG_LINKS} PRIVATE ${ARG_PRIVATE_LINKS})
  set_target_properties(${NAME} PROPERTIES POSITION_INDEPENDENT_CODE ON)
  if(RIGOR_QUICK_BUILD)
    set_target_properties(${NAME} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 6)
  endif()
endfunction()

# Continuous integration builds from nothing: there libraries are compiled some files at a time, and tests include precompiled
# headers and are optimised lightly. What they test is optimised as ever. Elsewhere ccache does more, and it cannot share what
# precompiled headers went into between folders.
option(RIGOR_QUICK_BUILD "Compile libraries some files at a time, tests with precompiled headers and at -O1" OFF)
if(RIGOR_QUICK_BUILD AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  set(CMAKE_PCH_WARN_INVALID OFF)  # a test with other flags reads the headers as they are
  if(CCACHE)
    set(CMAKE_CXX_COMPILER_LAUNCHER env CCACHE_SLOPPINESS=pch_defines,time_macros ${CCACHE})
  endif()
  file(WRITE ${CMAKE_BINARY_DIR}/generated/test_headers.cpp "")
  add_library(rigor_test_headers STATIC ${CMAKE_BINARY_DIR}/generated/test_headers.cpp)
  find_package(GTest REQUIRED)
  target_link_libraries(rigor_test_headers PRIVATE rigor_options GTest::gtest_main GTest::gmock)
  target_compile_options(rigor_test_headers PRIVATE $<$<CONFIG:Release>:-O1>)
  target_precompile_headers(rigor_test_headers PRIVATE <algorithm> <array> <atomic> <chrono> <cmath> <cstdint> <cstring>
    <filesystem> <fstream> <functional> <map> <memory> <mutex> <optional> <set> <span> <sstream> <string> <string_view> <thread>
    <tuple> <unordered_map> <utility> <variant> <vector> <tl/expected.hpp> <gmock/gmock.h> <gtest/gtest.h>)
endif()

# rigor_test(NAME SOURCES... LINKS... [SERIAL] [WALL_CLOCK cases...]): a GoogleTest binary whose cases ctest knows one by one.
# WALL_CLOCK: those cases (patterns of --gtest_filter) whose verdict depends on how promptly this machine runs threads and passes
# on packets; tools/run_tests.py runs them again where they fail. SERIAL: these cases, or all where none are named, run alone, for
# they measure time or hold a fixed port. DATA_DIR finds recordings where they are present.
function(rigor_test NAME)
  cmake_parse_arguments(ARG "SERIAL" "TIMEOUT" "SOURCES;LINKS;LABELS;WALL_CLOCK" ${ARGN})
  find_package(GTest REQUIRED)
  include(GoogleTest)
  add_executable(${NAME} ${ARG_SOURCES})
  target_link_libraries(${NAME} PRIVATE rigor_options ${ARG_LINKS} GTest::gtest_main GTest::gmock)
  target_compile_definitions(${NAME} PRIVATE RIGOR_SOURCE_DIR="${CMAKE_SOURCE_DIR}"
                                             RIGOR_BINARY_DIR="${CMAKE_BINARY_DIR}")
  set_target_properties(${NAME} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
  if(TARGET rigor_test_headers)
    target_precompile_headers(${NAME} REUSE_FROM rigor_test_headers)
    target_compile_options(${NAME} PRIVATE $<$<CONFIG:Release>:-O1>)
  endif()
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 120)
  endif()
  set(PROPS TIMEOUT ${ARG_TIMEOUT})
  if(ARG_LABELS)
    list(APPEND PROPS LABELS "${ARG_LABELS}")
  endif()
  if(ARG_SERIAL AND NOT ARG_WALL_CLOCK)
    list(APPEND PROPS RUN_SERIAL TRUE)
  endif()
  if(RIGOR_SANITIZE MATCHES "thread")
    list(APPEND PROPS ENVIRONMENT "TSAN_OPTIONS=suppressions=${CMAKE_SOURCE_DIR}/tests/tsan.supp")
  endif()
  set(OTHERS)
  if(ARG_WALL_CLOCK)
    string(JOIN ":" CASES ${ARG_WALL_CLOCK})
    gtest_discover_tests(${NAME} DISCOVERY_MODE PRE_TEST TEST_FILTER "${CASES}"
                         PROPERTIES ${PROPS} RUN_SERIAL ${ARG_SERIAL} LABELS wall-clock)
    set(OTHERS TEST_FILTER "-${CASES}")
  endif()
  if(NOT ARG_WALL_CLOCK STREQUAL "*")
    gtest_discover_tests(${NAME} DISCOVERY_MODE PRE_TEST ${OTHERS} PROPERTIES ${PROPS})
  endif()
endfunction()

# rigor_bench(NAME SOURCES... LINKS...): build/<preset>/benches/NAME, each takes --json FILE.
function(rigor_bench NAME)
  cmake_parse_arguments(ARG "" "" "SOURCES;LINKS" ${ARGN})
  add_executable(${NAME} ${ARG_SOURCES})
  target_link_libraries(${NAME} PRIVATE rigor_options ${ARG_LINKS})
  set_target_properties(${NAME} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/benches)
endfunction()
