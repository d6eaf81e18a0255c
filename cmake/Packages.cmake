# Debian packages: rigor, librigor0.1, librigor-dev and, where the Python module is built, python3-rigor. `./dev package` builds what they
# hold, then `cpack` puts it together below /usr; package/stage.cmake adds what only packages have.
set(RIGOR_SOVERSION ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME rigor)
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_PACKAGE_CONTACT "Rigor maintainers <maintainers@rigor.invalid>" CACHE STRING "Maintainer, as packages name him")
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_STRIP_FILES ON)
set(CPACK_SET_DESTDIR ON)  # with the prefix /usr, so that the component machine goes where the system looks
set(CPACK_INSTALL_PREFIX /usr)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_PROJECT_CONFIG_FILE ${rigor_SOURCE_DIR}/cmake/package/at_cpack.cmake)
set(CPACK_PRE_BUILD_SCRIPTS ${rigor_SOURCE_DIR}/cmake/package/stage.cmake)
set(CPACK_RIGOR_SOURCE_DIR ${rigor_SOURCE_DIR})
set(CPACK_RIGOR_BINARY_DIR ${rigor_BINARY_DIR})
set(CPACK_RIGOR_SOVERSION ${RIGOR_SOVERSION})
# Whose package that depends on a library of Rigor's depends on comes from the libraries that its files need.
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS ${rigor_BINARY_DIR}/lib)

get_cmake_property(RIGOR_COMPONENTS COMPONENTS)
set(CPACK_COMPONENTS_ALL command machine libraries sdk)
if(python IN_LIST RIGOR_COMPONENTS)
  list(APPEND CPACK_COMPONENTS_ALL python)
endif()

set(SAME "(= ${PROJECT_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE})")
set(ABOUT "Rigor runs a rig of real, simulated and replayed sensors and actuators around
one deterministic loop. The software under test cannot tell which are real.")
# rigor_package(GROUP NAME SECTION DESCRIPTION): the package of a group of components.
macro(rigor_package GROUP NAME SECTION DESCRIPTION)
  set(CPACK_DEBIAN_${GROUP}_PACKAGE_NAME ${NAME})
  set(CPACK_DEBIAN_${GROUP}_PACKAGE_SECTION ${SECTION})
  set(CPACK_DEBIAN_${GROUP}_DESCRIPTION "${DESCRIPTION}")
endmacro()
rigor_package(COMMAND rigor science "hardware-in-the-loop test bench for sensors
${ABOUT}
.
This package has the command, rigs, worlds and sensor models to begin with, and
the client for applications in Python.")
# Sensors with `renderer: raster`, which is what cameras have outside of small scenes, need a Vulkan driver: Mesa's draws on
# the CPU where there is no GPU.
set(CPACK_DEBIAN_COMMAND_PACKAGE_DEPENDS "librigor${RIGOR_SOVERSION} ${SAME}, mesa-vulkan-drivers | vulkan-icd")
set(CPACK_DEBIAN_COMMAND_PACKAGE_RECOMMENDS "python3")
set(CPACK_DEBIAN_COMMAND_PACKAGE_SUGGESTS "librigor-dev, python3-rigor")

rigor_package(LIBRARIES librigor${RIGOR_SOVERSION} libs "hardware-in-the-loop test bench for sensors - shared libraries
${ABOUT}
.
This package has the libraries of the bench, of its hardware abstraction layer
and of its world database.")
set(CPACK_DEBIAN_LIBRARIES_PACKAGE_SUGGESTS "rigor")

rigor_package(SDK librigor-dev libdevel "hardware-in-the-loop test bench for sensors - development files
${ABOUT}
.
This package has headers, the package file of CMake, the conformance suite of
drivers, and examples: plugins with drivers, applications and types of the
world, and rigs in one's own programs and tests.")
set(CPACK_DEBIAN_SDK_PACKAGE_DEPENDS
    "librigor${RIGOR_SOVERSION} ${SAME}, libexpected-dev, libreaderwriterqueue-dev, libeigen3-dev, nlohmann-json3-dev")
set(CPACK_DEBIAN_SDK_PACKAGE_RECOMMENDS "cmake, g++, rigor")
set(CPACK_DEBIAN_SDK_PACKAGE_SUGGESTS "libgtest-dev, libgmock-dev")
set(CPACK_DEBIAN_SDK_PACKAGE_SHLIBDEPS OFF)  # it has no programs

rigor_package(PYTHON python3-rigor python "hardware-in-the-loop test bench for sensors - Python 3 module
${ABOUT}
.
This package has the module rigor: rigs, recordings, sensors, calibration and
worlds from Python, with NumPy arrays.")
set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "rigor ${SAME}, librigor${RIGOR_SOVERSION} ${SAME}, python3 (>= 3.11), python3 (<< 3.12), python3-numpy")

# What dpkg runs, and what others' packages depend on that need the libraries.
set(CPACK_DEBIAN_COMMAND_PACKAGE_CONTROL_EXTRA ${rigor_SOURCE_DIR}/cmake/package/command/prerm)
set(CPACK_DEBIAN_PYTHON_PACKAGE_CONTROL_EXTRA ${rigor_SOURCE_DIR}/cmake/package/python/postinst
                                              ${rigor_SOURCE_DIR}/cmake/package/python/prerm)
set(SHLIBS "")
foreach(LIBRARY hal world bench)
  string(APPEND SHLIBS "librigor_${LIBRARY} ${RIGOR_SOVERSION} librigor${RIGOR_SOVERSION} (>= ${PROJECT_VERSION})\n")
endforeach()
file(CONFIGURE OUTPUT ${rigor_BINARY_DIR}/generated/package/shlibs CONTENT "${SHLIBS}" @ONLY)
set(CPACK_DEBIAN_LIBRARIES_PACKAGE_CONTROL_EXTRA ${rigor_BINARY_DIR}/generated/package/shlibs
                                                 ${rigor_SOURCE_DIR}/cmake/package/libraries/triggers)

# What they hold.
add_custom_target(rigor_packaged DEPENDS rigor rigor_manual rigor_hal_library rigor_graph rigor_bench_library)
if(TARGET rigor_python)
  add_dependencies(rigor_packaged rigor_python)
endif()

include(CPack)
cpack_add_component_group(command)
cpack_add_component(command GROUP command)
cpack_add_component(machine GROUP command)
foreach(GROUP libraries sdk python)
  cpack_add_component_group(${GROUP})
  cpack_add_component(${GROUP} GROUP ${GROUP})
endforeach()
