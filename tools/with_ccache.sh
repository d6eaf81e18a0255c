#!/bin/sh
# Runs a compiler through ccache where that is installed. The build's commands are the same with and without it, so
# that ./dev test, which installs ccache, does not compile again what ./dev run compiled. The settings let checkouts in
# different folders share results, allow for precompiled headers, and take from the compiler which files were included
# in place of preprocessing each file twice.
if command -v ccache >/dev/null; then
  CCACHE_BASEDIR=$(cd "$(dirname "$0")/.." && pwd) CCACHE_NOHASHDIR=1 CCACHE_DEPEND=1 CCACHE_SLOPPINESS=pch_defines,time_macros \
    exec ccache "$@"
fi
exec "$@"
