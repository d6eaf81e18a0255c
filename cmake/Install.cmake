# cmake --install build/release --prefix DIR: the command, the rigs and worlds that it comes with, and what programs and plugins
# are built against. Components (--component NAME: that alone), of which Packages.cmake makes Debian packages:
#   command    the program, its configurations, the client for applications in Python, manual pages, completion
#   machine    udev rules and kernel limits
#   libraries  librigor_hal, librigor_world, librigor_bench
#   sdk        headers, package file of CMake, conformance suite, examples; needs libraries
set(CMAKE_INSTALL_DEFAULT_COMPONENT_NAME command)

if(TARGET rigor)
  set_target_properties(rigor PROPERTIES INSTALL_RPATH "$ORIGIN/../${CMAKE_INSTALL_LIBDIR}")
  install(TARGETS rigor RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
endif()
install(DIRECTORY ${rigor_SOURCE_DIR}/configs/ DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/configs
        FILES_MATCHING PATTERN "*.yaml" PATTERN "*.csv" PATTERN "*.dbc" PATTERN "*.asc" PATTERN "*.geojson"
        PATTERN "*.lock.yaml" EXCLUDE)
# The clients for applications as processes: Python's is found by a rig's program by itself, C++'s is one header.
install(FILES ${rigor_SOURCE_DIR}/clients/python/rigor_client.py DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/clients/python)
install(FILES ${rigor_SOURCE_DIR}/clients/cpp/rigor_client.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT sdk)
install(FILES ${rigor_SOURCE_DIR}/tools/install/completions/rigor DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions)
if(TARGET rigor)
  # Written from --help by help2man, which packages need (./dev package) and other builds do not.
  add_custom_command(OUTPUT ${rigor_BINARY_DIR}/manual/rigor.1
                     COMMAND ${rigor_SOURCE_DIR}/tools/make_manual.sh $<TARGET_FILE:rigor> ${rigor_BINARY_DIR}/manual
                     DEPENDS rigor ${rigor_SOURCE_DIR}/tools/make_manual.sh ${rigor_SOURCE_DIR}/CHANGELOG.md
                     COMMENT "Manual pages" VERBATIM)
  add_custom_target(rigor_manual DEPENDS ${rigor_BINARY_DIR}/manual/rigor.1)
  install(DIRECTORY ${rigor_BINARY_DIR}/manual/ DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 OPTIONAL FILES_MATCHING PATTERN "*.1")
endif()
# Who may open devices, and limits of the kernel: DATADIR/rigor/udev and DATADIR/rigor/sysctl, from where an administrator
# takes them (rigor doctor says how). With the prefix /usr, which is the distribution's, they go where the system looks.
# `--component machine` installs them alone.
install(FILES ${rigor_SOURCE_DIR}/tools/install/udev/60-rigor.rules DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/udev
        COMPONENT machine)
install(FILES ${rigor_SOURCE_DIR}/tools/install/sysctl/60-rigor-sysctl.conf DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/sysctl
        COMPONENT machine)
install(CODE "
  if(CMAKE_INSTALL_PREFIX STREQUAL \"/usr\")
    file(INSTALL \"${rigor_SOURCE_DIR}/tools/install/udev/60-rigor.rules\" DESTINATION /usr/lib/udev/rules.d)
    file(INSTALL \"${rigor_SOURCE_DIR}/tools/install/sysctl/60-rigor-sysctl.conf\" DESTINATION /usr/lib/sysctl.d)
  endif()" COMPONENT machine)

# What programs, plugins and tests of others are built against: libraries, public headers, the package file of CMake, the
# conformance suite and the examples. find_package(Rigor COMPONENTS Hal World Bench).
function(rigor_install_library TARGET NAME)
  install(TARGETS ${TARGET} LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT libraries NAMELINK_COMPONENT sdk)
  get_property(HEADERS GLOBAL PROPERTY RIGOR_${NAME}_HEADERS)
  foreach(HEADER IN LISTS HEADERS)
    cmake_path(GET HEADER PARENT_PATH FOLDER)
    install(FILES ${rigor_SOURCE_DIR}/${HEADER} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/rigor/${FOLDER} COMPONENT sdk)
  endforeach()
  string(TOLOWER ${NAME} LIBRARY)
  install(FILES ${rigor_BINARY_DIR}/generated/rigor/${LIBRARY}_abi.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/rigor/rigor
          COMPONENT sdk OPTIONAL)
endfunction()
rigor_install_library(rigor_hal_library HAL)
rigor_install_library(rigor_graph WORLD)
if(TARGET rigor_bench_library)
  rigor_install_library(rigor_bench_library BENCH)
endif()
install(DIRECTORY ${rigor_SOURCE_DIR}/sensor-hal/conformance/
        DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/rigor/sensor-hal/conformance COMPONENT sdk FILES_MATCHING PATTERN "*.h")
# Examples come with what they need: those in Python with the command and with the Python module.
install(DIRECTORY ${rigor_SOURCE_DIR}/examples DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor COMPONENT sdk
        PATTERN "python" EXCLUDE PATTERN "*.py" EXCLUDE PATTERN "__pycache__" EXCLUDE)
install(FILES ${rigor_SOURCE_DIR}/examples/application/detector.py DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/examples/application)
if(TARGET rigor_python)
  install(DIRECTORY ${rigor_SOURCE_DIR}/examples/python DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/examples COMPONENT python OPTIONAL
          PATTERN "__pycache__" EXCLUDE)
endif()
include(CMakePackageConfigHelpers)
set(INCLUDE_DIR ${CMAKE_INSTALL_INCLUDEDIR}/rigor)
set(LIBRARY_DIR ${CMAKE_INSTALL_LIBDIR})
configure_package_config_file(
  ${rigor_SOURCE_DIR}/cmake/RigorConfig.cmake.in ${rigor_BINARY_DIR}/generated/RigorConfig.cmake
  INSTALL_DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/Rigor PATH_VARS INCLUDE_DIR LIBRARY_DIR)
write_basic_package_version_file(${rigor_BINARY_DIR}/generated/RigorConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${rigor_BINARY_DIR}/generated/RigorConfig.cmake ${rigor_BINARY_DIR}/generated/RigorConfigVersion.cmake
        DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/Rigor COMPONENT sdk)
