# Puts files into the program: a source file that includes their bytes as the assembler reads them.
# rigor_embed_page(TARGET FILES PATH=FILE...): PATH is what the server knows it by.
function(rigor_embed_page TARGET)
  set(SOURCE ${CMAKE_CURRENT_BINARY_DIR}/page_files.cpp)
  set(CODE "// Made by embed_page.cmake.\n#include \"bench/live/page_files.h\"\n\n")
  set(TABLE "")
  set(N 0)
  foreach(ENTRY ${ARGN})
    string(FIND ${ENTRY} "=" AT)
    string(SUBSTRING ${ENTRY} 0 ${AT} PATH)
    math(EXPR AFTER "${AT} + 1")
    string(SUBSTRING ${ENTRY} ${AFTER} -1 FILE)
    file(REAL_PATH ${FILE} FILE)
    # In the source, so that ccache, which does not see what the assembler includes, knows another file.
    file(SHA256 ${FILE} HASH)
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${FILE})
    string(APPEND CODE "__asm__(\".section .rodata /* ${HASH} */\\n\"\n"
      "        \".global rigor_page_${N}, rigor_page_end_${N}\\n\"\n"
      "        \"rigor_page_${N}: .incbin \\\"${FILE}\\\"\\n\"\n"
      "        \"rigor_page_end_${N}: .byte 0\\n\"\n        \".previous\\n\");\n"
      "extern \"C\" const char rigor_page_${N}[], rigor_page_end_${N}[];\n")
    string(APPEND TABLE "      {\"${PATH}\", {rigor_page_${N}, static_cast<std::size_t>(rigor_page_end_${N} - rigor_page_${N})}},\n")
    list(APPEND FILES ${FILE})
    math(EXPR N "${N} + 1")
  endforeach()
  string(APPEND CODE "\nstd::span<const rigor::live::PageFile> rigor::live::page_files() {\n"
    "  static const rigor::live::PageFile files[] = {\n${TABLE}      {\"\", {}}};\n"
    "  return {files, sizeof files / sizeof files[0] - 1};\n}\n")
  file(CONFIGURE OUTPUT ${SOURCE} CONTENT "${CODE}" @ONLY)
  # By itself: what a source is made of is not looked at where it is compiled with others.
  set_source_files_properties(${SOURCE} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON OBJECT_DEPENDS "${FILES}")
  target_sources(${TARGET} PRIVATE ${SOURCE})
endfunction()
