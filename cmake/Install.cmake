# cmake --install build/release --prefix DIR: the command, and the rigs and worlds that it comes with.
include(GNUInstallDirs)

if(TARGET rigor)
  install(TARGETS rigor RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
endif()
install(DIRECTORY ${CMAKE_SOURCE_DIR}/configs/ DESTINATION ${CMAKE_INSTALL_DATADIR}/rigor/configs
        FILES_MATCHING PATTERN "*.yaml" PATTERN "*.lock.yaml" EXCLUDE)
# Reserved for what a machine is given by hand: DATADIR/rigor/udev and DATADIR/rigor/sysctl.
