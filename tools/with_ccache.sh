#!/bin/sh
# Runs a compiler through ccache where that is installed. The build's commands are the same with and without it, so
# that ./dev test, which installs ccache, does not compile again what ./dev run compiled. The settings let checkouts in
# different folders share results, allow for precompiled headers, and take from the compiler which files were included
# in place of preprocessing each file twice.
command -v ccache >/dev/null || exec "$@"

output='' dependencies='' previous=''
for word; do
  case $previous in
    -o) output=$word ;;
    -MF) dependencies=$word ;;
  esac
  previous=$word
done
case $output in
  *.gch | *.pch)
    # Precompiled headers hold the path that they were made at, and are made afresh in each folder. What they were made of is
    # the same everywhere: ccache knows them by the digest of that, which lies beside them.
    "$@" || exit
    # Without that file, ccache takes the precompiled header itself.
    rm -f "$output.sum"
    sums=$(sed -e 's/\\$//' -e '1s/^[^:]*://' "$dependencies" | tr ' ' '\n' | grep . | sort -u | xargs sha256sum) &&
      echo "$sums" | cut -d ' ' -f 1 | sort | sha256sum >"$output.sum"
    exit 0
    ;;
esac
# CMake hands clang the path of the precompiled header's source behind -Xclang, where ccache leaves it as it is: from here it is
# the same in each checkout.
previous=''
for word; do
  shift
  if [ "$previous" = -Xclang ]; then set -- "$@" "${word#"$PWD"/}"; else set -- "$@" "$word"; fi
  previous=$word
done
CCACHE_BASEDIR=$(cd "$(dirname "$0")/.." && pwd) CCACHE_NOHASHDIR=1 CCACHE_DEPEND=1 CCACHE_PCH_EXTSUM=1 \
  CCACHE_SLOPPINESS=pch_defines,time_macros exec ccache "$@"
