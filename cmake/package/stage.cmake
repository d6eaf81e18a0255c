# cpack runs this between installing the components into CPACK_TEMPORARY_DIRECTORY/GROUP and packing them. It takes out what a prefix
# of one's own needs and /usr does not (run paths), and puts in what Debian's policy asks of each package.
set(HERE ${CMAKE_CURRENT_LIST_DIR})
set(ENV{LC_ALL} C)

function(rigor_gzip FILE)
  execute_process(COMMAND gzip -9nf ${FILE} COMMAND_ERROR_IS_FATAL ANY)
endfunction()

# The newest release of CHANGELOG.md, which must be the one that is packed.
file(READ ${CPACK_RIGOR_SOURCE_DIR}/CHANGELOG.md CHANGES)
if(NOT CHANGES MATCHES "\n## ([0-9.]+) \\(([0-9-]+)\\)\n" OR NOT CMAKE_MATCH_1 STREQUAL CPACK_PACKAGE_VERSION)
  message(FATAL_ERROR "CHANGELOG.md: expected the newest release to be `## ${CPACK_PACKAGE_VERSION} (YYYY-MM-DD)`, as CMakeLists.txt "
                      "has it in project(VERSION), got ${CMAKE_MATCH_1}")
endif()
execute_process(COMMAND date --utc -R -d ${CMAKE_MATCH_2} OUTPUT_VARIABLE RELEASED OUTPUT_STRIP_TRAILING_WHITESPACE
                COMMAND_ERROR_IS_FATAL ANY)
set(DEBIAN_CHANGES "rigor (${CPACK_PACKAGE_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE}) UNRELEASED; urgency=medium

  * Release ${CPACK_PACKAGE_VERSION}; changelog.gz says what is in it.

 -- ${CPACK_PACKAGE_CONTACT}  ${RELEASED}
")

foreach(GROUP command libraries sdk python)
  set(ROOT ${CPACK_TEMPORARY_DIRECTORY}/${GROUP})
  if(NOT IS_DIRECTORY ${ROOT})
    continue()
  endif()
  string(TOUPPER ${GROUP} KEY)
  set(NAME ${CPACK_DEBIAN_${KEY}_PACKAGE_NAME})
  set(DOC ${ROOT}/usr/share/doc/${NAME})
  file(COPY ${HERE}/copyright ${CPACK_RIGOR_SOURCE_DIR}/CHANGELOG.md DESTINATION ${DOC})
  file(RENAME ${DOC}/CHANGELOG.md ${DOC}/changelog)
  file(WRITE ${DOC}/changelog.Debian "${DEBIAN_CHANGES}")
  rigor_gzip(${DOC}/changelog)
  rigor_gzip(${DOC}/changelog.Debian)
  set(OVERRIDES "# Nobody uploads these packages to Debian: there is no bug that asks for them.\ninitial-upload-closes-no-bugs *\n")
  if(EXISTS ${HERE}/${GROUP}/lintian-overrides)
    file(READ ${HERE}/${GROUP}/lintian-overrides MORE)
    string(CONFIGURE "${MORE}" MORE @ONLY)
    string(APPEND OVERRIDES "${MORE}")
  endif()
  file(WRITE ${ROOT}/usr/share/lintian/overrides/${NAME} "${OVERRIDES}")
  file(GLOB MANUAL ${ROOT}/usr/share/man/man1/*.1)
  foreach(PAGE IN LISTS MANUAL)
    rigor_gzip(${PAGE})
  endforeach()
  file(GLOB_RECURSE FILES LIST_DIRECTORIES false ${ROOT}/usr/bin/* ${ROOT}/usr/lib/*.so ${ROOT}/usr/lib/*.so.*)
  foreach(FILE IN LISTS FILES)
    if(NOT IS_SYMLINK ${FILE})
      file(RPATH_REMOVE FILE ${FILE})
    endif()
  endforeach()
endforeach()
