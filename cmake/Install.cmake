# cmake --install build/release --prefix DIR: the command, the rigs and worlds that it comes with, and what plugins of the
# world are built against (--component world: that alone).
include(GNUInstallDirs)

if(TARGET rigor)
  set_target_properties(rigor PROPERTIES INSTALL_RPATH "$ORIGIN/../${CMAKE_INSTALL_LIBDIR}")
  install(TARGETS rigor RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
endif()
install(DIRECTORY ${CMAKE_SOURCE_DIR}/configs/ DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/configs
        FILES_MATCHING PATTERN "*.yaml" PATTERN "*.csv" PATTERN "*.dbc" PATTERN "*.asc" PATTERN "*.geojson"
        PATTERN "*.lock.yaml" EXCLUDE)
# The clients for applications as processes: Python's is found by a rig's program by itself, C++'s is one header.
install(FILES ${CMAKE_SOURCE_DIR}/clients/python/rigor_client.py DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/clients/python)
install(FILES ${CMAKE_SOURCE_DIR}/clients/cpp/rigor_client.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
# Who may open devices, and limits of the kernel: DATADIR/rigor/udev and DATADIR/rigor/sysctl, from where an administrator
# takes them (rigor doctor says how). With the prefix /usr, which is the distribution's, they go where the system looks.
# `--component machine` installs them alone.
install(FILES ${CMAKE_SOURCE_DIR}/tools/install/udev/60-rigor.rules DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/udev
        COMPONENT machine)
install(FILES ${CMAKE_SOURCE_DIR}/tools/install/sysctl/60-rigor-sysctl.conf DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/sysctl
        COMPONENT machine)
install(CODE "
  if(CMAKE_INSTALL_PREFIX STREQUAL \"/usr\")
    file(INSTALL \"${CMAKE_SOURCE_DIR}/tools/install/udev/60-rigor.rules\" DESTINATION /usr/lib/udev/rules.d)
    file(INSTALL \"${CMAKE_SOURCE_DIR}/tools/install/sysctl/60-rigor-sysctl.conf\" DESTINATION /usr/lib/sysctl.d)
  endif()" COMPONENT machine)

# librigor_world, its public headers and the package file of CMake: find_package(RigorWorld), target Rigor::World.
if(TARGET rigor_graph)
  install(TARGETS rigor_graph LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT world NAMELINK_COMPONENT world)
  get_property(HEADERS GLOBAL PROPERTY RIGOR_WORLD_HEADERS)
  foreach(HEADER IN LISTS HEADERS)
    cmake_path(GET HEADER PARENT_PATH FOLDER)
    install(FILES ${CMAKE_SOURCE_DIR}/${HEADER} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/rigor/${FOLDER} COMPONENT world)
  endforeach()
  install(FILES ${CMAKE_BINARY_DIR}/generated/rigor/world_abi.h DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/rigor/rigor
          COMPONENT world)
  include(CMakePackageConfigHelpers)
  set(INCLUDE_DIR ${CMAKE_INSTALL_INCLUDEDIR}/rigor)
  set(LIBRARY_FILE ${CMAKE_INSTALL_LIBDIR}/librigor_world.so)
  configure_package_config_file(
    ${CMAKE_SOURCE_DIR}/sim/world/plugin/RigorWorldConfig.cmake.in ${CMAKE_BINARY_DIR}/generated/RigorWorldConfig.cmake
    INSTALL_DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/RigorWorld PATH_VARS INCLUDE_DIR LIBRARY_FILE)
  write_basic_package_version_file(${CMAKE_BINARY_DIR}/generated/RigorWorldConfigVersion.cmake COMPATIBILITY SameMinorVersion)
  install(FILES ${CMAKE_BINARY_DIR}/generated/RigorWorldConfig.cmake ${CMAKE_BINARY_DIR}/generated/RigorWorldConfigVersion.cmake
          DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/RigorWorld COMPONENT world)
endif()
