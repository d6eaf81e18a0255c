#!/bin/sh
# Runs a compiler through ccache where that is installed. The build's commands are the same with and without it, so
# that ./dev test, which installs ccache, does not compile again what ./dev run compiled.
if command -v ccache >/dev/null; then
  exec ccache "$@"
fi
exec "$@"
