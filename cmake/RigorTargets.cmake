# How every target of the project is made: one include root, one set of warnings, one set of sanitizers.
find_package(Threads REQUIRED)
find_package(tl-expected REQUIRED)
find_package(fmt REQUIRED)
find_package(Eigen3 REQUIRED)
find_package(nlohmann_json REQUIRED)
set(CMAKE_CXX_COMPILER_LAUNCHER ${rigor_SOURCE_DIR}/tools/with_ccache.sh)

if(PROJECT_IS_TOP_LEVEL AND NOT DEFINED CMAKE_INSTALL_LIBDIR AND CMAKE_LIBRARY_ARCHITECTURE AND EXISTS /etc/debian_version)
  # Debian's folder below any prefix, so that packages come from the same build.
  set(CMAKE_INSTALL_LIBDIR lib/${CMAKE_LIBRARY_ARCHITECTURE} CACHE PATH "Object code libraries")
endif()
include(GNUInstallDirs)

# Both are on unless a preset says otherwise, for builds from nothing. The preset dev compiles file by file, so that a change
# of one file compiles that file alone.
option(RIGOR_UNITY "Compile the files of a library, or of a test, several at a time" ON)
option(RIGOR_PRECOMPILED "Precompile the headers that most files include" ON)

add_library(rigor_options INTERFACE)
target_include_directories(rigor_options INTERFACE ${rigor_SOURCE_DIR})
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
# GCC compiles the whole JSON parser for each file that includes nlohmann/json.hpp, though the file may not parse: the header's
# literal "…"_json, which nothing here uses, calls it. A copy of the header that only declares the literal saves about 0.7 s
# a file. Where the header's text is another one, it is used as it is.
find_path(RIGOR_JSON_FOLDER nlohmann/json.hpp)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND RIGOR_JSON_FOLDER)
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${RIGOR_JSON_FOLDER}/nlohmann/json.hpp)
  file(READ ${RIGOR_JSON_FOLDER}/nlohmann/json.hpp TEXT)
  string(REPLACE "inline nlohmann::json operator \"\" _json(const char* s, std::size_t n)\n{\n    return nlohmann::json::parse(s, s + n);\n}"
                 "nlohmann::json operator \"\" _json(const char* s, std::size_t n);" DECLARED "${TEXT}")
  set(COPY ${rigor_BINARY_DIR}/generated/system/nlohmann/json.hpp)
  set(THERE)
  if(EXISTS ${COPY})
    file(READ ${COPY} THERE)
  endif()
  if(NOT DECLARED STREQUAL THERE)
    file(WRITE ${COPY} "${DECLARED}")  # where it changed: everything is compiled again
  endif()
  target_include_directories(rigor_options SYSTEM INTERFACE ${rigor_BINARY_DIR}/generated/system)
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
  # Written where it is not there yet: a newer one has everything compiled again, after each change of a CMakeLists.txt.
  file(CONFIGURE OUTPUT ${rigor_BINARY_DIR}/generated/${NAME}.cpp CONTENT "")
  add_library(${NAME} OBJECT ${rigor_BINARY_DIR}/generated/${NAME}.cpp)
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

# rigor_wide_loops(NAME): the library's loops may become vector instructions (see sensor-hal/models/wide.h). Results stay those of IEEE 754;
# what goes is errno of square roots, traps, and jumps in place of selections. Precompiled headers are made without such options.
function(rigor_wide_loops NAME)
  target_compile_options(${NAME} PRIVATE -fno-math-errno -fno-trapping-math)
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    target_compile_options(${NAME} PRIVATE -fno-thread-jumps)
  endif()
  set_target_properties(${NAME} PROPERTIES DISABLE_PRECOMPILE_HEADERS ON)
endfunction()

# rigor_unity(NAME SIZE): has the target NAME compile its sources SIZE at a time: in place of them it gets files that include them,
# as many as that takes and of about the same length. Sources with the property SKIP_UNITY_BUILD_INCLUSION stay as they are. CMake's
# own UNITY_BUILD writes absolute paths into such files, so that ccache would find nothing of what another checkout compiled.
function(rigor_unity NAME SIZE)
  if(RIGOR_UNITY)
    # When all sources are known, those that other folders add among them.
    cmake_language(EVAL CODE "cmake_language(DEFER DIRECTORY ${rigor_SOURCE_DIR} CALL rigor_unity_now ${NAME} ${SIZE})")
  endif()
endfunction()
function(rigor_unity_now NAME SIZE)
  get_target_property(FILES ${NAME} SOURCES)
  get_target_property(SOURCE_DIR ${NAME} SOURCE_DIR)
  get_target_property(BINARY_DIR ${NAME} BINARY_DIR)
  set(APART)
  set(TOGETHER)
  foreach(FILE IN LISTS FILES)
    cmake_path(ABSOLUTE_PATH FILE BASE_DIRECTORY ${SOURCE_DIR} NORMALIZE OUTPUT_VARIABLE PATH)
    get_source_file_property(SKIP ${PATH} TARGET_DIRECTORY ${NAME} SKIP_UNITY_BUILD_INCLUSION)
    cmake_path(IS_PREFIX rigor_SOURCE_DIR ${PATH} INSIDE)
    if(SKIP OR NOT INSIDE OR NOT PATH MATCHES "\\.cpp$")
      list(APPEND APART ${FILE})
    else()
      file(RELATIVE_PATH PATH ${rigor_SOURCE_DIR} ${PATH})
      list(APPEND TOGETHER ${PATH})
    endif()
  endforeach()
  list(LENGTH TOGETHER COUNT)
  if(COUNT LESS 2)
    return()
  endif()
  math(EXPR GROUPS "(${COUNT} + ${SIZE} - 1) / ${SIZE}")
  math(EXPR EACH "(${COUNT} + ${GROUPS} - 1) / ${GROUPS}")
  set(INDEX 0)
  while(TOGETHER)
    list(SUBLIST TOGETHER 0 ${EACH} GROUP)
    list(REMOVE_ITEM TOGETHER ${GROUP})
    list(TRANSFORM GROUP REPLACE "(.+)" "#include \"\\1\"\n")
    list(JOIN GROUP "" CONTENT)
    set(FILE ${BINARY_DIR}/unity/${NAME}_${INDEX}.cpp)
    file(CONFIGURE OUTPUT ${FILE} CONTENT "${CONTENT}" @ONLY)
    list(APPEND APART ${FILE})
    math(EXPR INDEX "${INDEX} + 1")
  endwhile()
  set_target_properties(${NAME} PROPERTIES SOURCES "${APART}")
endfunction()

# rigor_library(NAME SOURCES... [APART sources...] [LINKS targets...] [PRIVATE_LINKS targets...] [PART_OF shared])
# APART: sources that have names of their own in common with others of the library. PART_OF: its objects become part of that
# shared library, and who links NAME links the shared library; LINKS and PRIVATE_LINKS then name what is from outside.
function(rigor_library NAME)
  cmake_parse_arguments(ARG "" "PART_OF" "SOURCES;APART;LINKS;PRIVATE_LINKS" ${ARGN})
  if(ARG_PART_OF)
    set(OBJECTS ${NAME}_objects)
    add_library(${OBJECTS} OBJECT ${ARG_SOURCES} ${ARG_APART})
    target_sources(${ARG_PART_OF} PRIVATE $<TARGET_OBJECTS:${OBJECTS}>)
    target_link_libraries(${ARG_PART_OF} PUBLIC ${ARG_LINKS} PRIVATE ${ARG_PRIVATE_LINKS})
    add_library(${NAME} INTERFACE)
    target_link_libraries(${NAME} INTERFACE ${ARG_PART_OF})
    target_include_directories(${OBJECTS} PRIVATE ${rigor_BINARY_DIR}/generated)
  else()
    set(OBJECTS ${NAME})
    add_library(${NAME} STATIC ${ARG_SOURCES} ${ARG_APART})
  endif()
  target_link_libraries(${OBJECTS} PUBLIC rigor_options ${ARG_LINKS} PRIVATE ${ARG_PRIVATE_LINKS})
  set_target_properties(${OBJECTS} PROPERTIES POSITION_INDEPENDENT_CODE ON)
  set_source_files_properties(${ARG_APART} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  rigor_compile_options(${OBJECTS})
endfunction()

# Functions of other libraries are looked up when the program starts and the tables of them are read-only from then on: no loop is the
# first to call one, and nothing that is written out of bounds redirects a call.
set(RIGOR_BOUND_AT_START -Wl,-z,relro,-z,now)

# rigor_shared_library(NAME FILE): build/<preset>/lib/librigor_<FILE>.so, of which other libraries are parts. It exports what is
# in the namespace rigor and nothing else: what it holds of other libraries is its own business.
function(rigor_shared_library NAME FILE)
  add_library(${NAME} SHARED)
  set_target_properties(${NAME} PROPERTIES
    OUTPUT_NAME rigor_${FILE} VERSION ${PROJECT_VERSION} SOVERSION ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR}
    LIBRARY_OUTPUT_DIRECTORY ${rigor_BINARY_DIR}/lib LINKER_LANGUAGE CXX
    LINK_DEPENDS ${rigor_SOURCE_DIR}/cmake/exported.map)
  # Who links it gets no flag of ours.
  target_link_libraries(${NAME} PRIVATE rigor_options INTERFACE tl::expected Threads::Threads)
  target_include_directories(${NAME} PUBLIC ${rigor_BINARY_DIR}/generated INTERFACE ${rigor_SOURCE_DIR})
  set_target_properties(${NAME} PROPERTIES INSTALL_RPATH "$ORIGIN")
  target_compile_features(${NAME} INTERFACE cxx_std_20)
  target_link_options(${NAME} PRIVATE -Wl,--version-script=${rigor_SOURCE_DIR}/cmake/exported.map ${RIGOR_BOUND_AT_START})
  if(NOT RIGOR_SANITIZE)
    target_link_options(${NAME} PRIVATE -Wl,--no-undefined)
  endif()
endfunction()

# rigor_public_headers(NAME HEADERS...): the headers of a library (HAL, WORLD, BENCH) that are installed, and rigor/<name>_abi.h,
# their digest, by which plugins are known that were built against others. The target rigor_<name>_abi makes it.
function(rigor_public_headers NAME)
  set_property(GLOBAL PROPERTY RIGOR_${NAME}_HEADERS "${ARGN}")
  string(TOLOWER ${NAME} LIBRARY)
  set(DIGEST ${rigor_BINARY_DIR}/generated/rigor/${LIBRARY}_abi.h)
  list(TRANSFORM ARGN PREPEND ${rigor_SOURCE_DIR}/ OUTPUT_VARIABLE FILES)
  string(REPLACE ";" "," LIST "${ARGN}")
  add_custom_command(
    OUTPUT ${DIGEST}.stamp
    COMMAND ${CMAKE_COMMAND} -DOUT=${DIGEST} -DROOT=${rigor_SOURCE_DIR} -DHEADERS=${LIST} -DNAME=${NAME}
            -P ${rigor_SOURCE_DIR}/cmake/headers_digest.cmake
    COMMAND ${CMAKE_COMMAND} -E touch ${DIGEST}.stamp
    BYPRODUCTS ${DIGEST}
    DEPENDS ${FILES} ${rigor_SOURCE_DIR}/cmake/headers_digest.cmake
    COMMENT "Digest of the public headers of librigor_${LIBRARY}" VERBATIM)
  add_custom_target(rigor_${LIBRARY}_abi DEPENDS ${DIGEST}.stamp)
endfunction()

# rigor_compile_options(NAME): how a library is compiled: several files at a time and with precompiled headers, where the
# build's options say so; beside fuzz harnesses so that these see which branches are taken.
function(rigor_compile_options NAME)
  if(RIGOR_FUZZ)
    target_compile_options(${NAME} PRIVATE ${RIGOR_FUZZ_OPTION})
  endif()
  rigor_unity(${NAME} 12)
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
# threads), with other tests beside them. ALONE: they measure microseconds, and nothing runs beside them. ONE_THREAD: what
# they call starts no thread, and the thread sanitizer, which has nothing to see, is built without them. APART: as for rigor_library.
function(rigor_test NAME)
  cmake_parse_arguments(ARG "ALONE;ONE_THREAD" "TIMEOUT;IN_TURN" "SOURCES;APART;LINKS;LABELS;WALL_CLOCK" ${ARGN})
  if(ARG_ONE_THREAD AND RIGOR_SANITIZE MATCHES "thread")
    return()
  endif()
  find_package(GTest REQUIRED)
  include(GoogleTest)
  add_executable(${NAME} ${ARG_SOURCES} ${ARG_APART})
  rigor_unity(${NAME} 12)
  set_source_files_properties(${ARG_APART} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  target_link_libraries(${NAME} PRIVATE rigor_options ${ARG_LINKS} rigor_test_paths GTest::gtest_main GTest::gmock)
  set_target_properties(${NAME} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${rigor_BINARY_DIR}/tests)
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
    list(APPEND PROPS ENVIRONMENT "TSAN_OPTIONS=suppressions=${rigor_SOURCE_DIR}/tests/tsan.supp")
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
  set_target_properties(${NAME} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${rigor_BINARY_DIR}/benches)
  rigor_program_options(${NAME})
endfunction()
