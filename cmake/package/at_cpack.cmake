# What packages say that only the finished build knows; cpack reads this before it makes them. A package with a plugin depends on
# the digest of the headers that it was built against, so that no upgrade of the libraries leaves it behind: librigor0.1 provides
# rigor-hal-DIGEST and rigor-world-DIGEST.
set(PROVIDES "")
foreach(LIBRARY hal world)
  file(READ ${CPACK_RIGOR_BINARY_DIR}/generated/rigor/${LIBRARY}_abi.h TEXT)
  if(NOT TEXT MATCHES "_HEADERS_DIGEST \"([0-9a-f]+)\"")
    message(FATAL_ERROR "${CPACK_RIGOR_BINARY_DIR}/generated/rigor/${LIBRARY}_abi.h: expected the digest of the headers, found none")
  endif()
  list(APPEND PROVIDES "rigor-${LIBRARY}-${CMAKE_MATCH_1}")
endforeach()
list(JOIN PROVIDES ", " CPACK_DEBIAN_LIBRARIES_PACKAGE_PROVIDES)
