# shellcheck shell=bash
# One line that says how far a long step is: rewritten in place on a terminal, a line every tenth elsewhere. The full
# output goes to a log. Each filter reads a command's output on its standard input.

# show_progress LABEL DONE TOTAL [REST]
show_progress() {
  local label=$1 done=$2 total=$3 rest=${4:-}
  [[ $total -gt 0 ]] || return 0
  if [[ -t 1 ]]; then
    printf '\r\033[K%s %d/%d%s' "$label" "$done" "$total" "$rest"
    return
  fi
  local tenth=$((done * 10 / total))
  if [[ $tenth -ne ${PROGRESS_TENTH:-0} ]]; then
    PROGRESS_TENTH=$tenth
    echo "$label $done/$total$rest"
  fi
}

# Clears the line, so that what follows starts on an empty one.
end_progress() {
  PROGRESS_TENTH=0
  [[ ! -t 1 ]] || printf '\r\033[K'
}

# apt_progress LOG: what apt-get writes to APT::Status-Fd, while its output goes to LOG.
apt_progress() {
  local log=$1 line total=0 percent pattern='^(dl|pm)status:[^:]*:([0-9]+)'
  PROGRESS_TENTH=0
  while IFS= read -r line; do
    [[ $line =~ $pattern ]] || continue
    percent=${BASH_REMATCH[2]}
    if [[ ${BASH_REMATCH[1]} == dl ]]; then
      show_progress "downloading packages, percent:" "$percent" 100
      continue
    fi
    [[ $total -gt 0 ]] || total=$(sed -nE 's/.* ([0-9]+) newly installed.*/\1/p' "$log" | head -n 1)
    show_progress packages $((percent * ${total:-0} / 100)) "${total:-0}"
  done
  end_progress
}

# ninja_progress LOG LABEL: ninja's output with NINJA_STATUS='[%f/%t %e] '. Warnings and errors are passed on.
ninja_progress() {
  local log=$1 label=$2 line finished total elapsed left rest
  local step='^\[([0-9]+)/([0-9]+) ([0-9]+)\.[0-9]+\] ' quiet='^(ninja: (Entering|no work)|-- |\[0/)'
  PROGRESS_TENTH=0
  while IFS= read -r line; do
    printf '%s\n' "$line" >>"$log"
    if [[ $line =~ $step ]]; then
      finished=${BASH_REMATCH[1]} total=${BASH_REMATCH[2]} elapsed=${BASH_REMATCH[3]} rest=
      if [[ $elapsed -ge 15 && $finished -gt 0 ]]; then
        left=$((elapsed * (total - finished) / finished))
        rest=", about $(((left + 59) / 60)) min left"
      fi
      show_progress "$label" "$finished" "$total" "$rest"
    elif [[ -n $line && ! $line =~ $quiet ]]; then
      [[ ! -t 1 ]] || printf '\r\033[K'
      printf '%s\n' "$line"
    fi
  done
  end_progress
}
