#!/usr/bin/env bash
# fuzz_one.sh SECONDS RESULTS HARNESS: runs one harness of build/asan-ubsan on its corpus in tests/fuzz/corpus/NAME, prints the
# end of its log, and leaves RESULTS/fuzz-NAME.ok when it found nothing, else a line in RESULTS/fuzz.failed. New inputs are kept in build/fuzz-corpus. Inputs are as
# long as tests/fuzz/max_len.txt says.
set -euo pipefail

seconds=$1 results=$2 harness=$3
name=$(basename "$harness")
log=$results/fuzz-$name.log
found=build/fuzz-corpus/$name
mkdir -p "$found" build/fuzz-artifacts
folders=("$found")
seeds=tests/fuzz/corpus/$name
[[ ! -d $seeds ]] || folders+=("$seeds")
longest=$(awk -v name="$name" '$1 == name { print $2 }' tests/fuzz/max_len.txt)
[[ $longest =~ ^[0-9]+$ ]] || {
  echo "$name: expected the length of its longest input in tests/fuzz/max_len.txt, found none" | tee -a "$results/fuzz.failed"
  exit 1
}

# With vm.mmap_rnd_bits above 28 the address sanitizer of clang 16 aborts at random.
runner=()
! setarch -R true 2>/dev/null || runner=(setarch -R)
# Fake stacks and deep stacks of allocations take up to half of an input's time where exceptions are thrown and much is allocated. The
# unit tests under the sanitizers keep them; so does a harness that is run by hand on what was found.
export ASAN_OPTIONS=detect_stack_use_after_return=0:malloc_context_size=4:quarantine_size_mb=32${ASAN_OPTIONS:+:$ASAN_OPTIONS}
if "${runner[@]}" "build/asan-ubsan/$harness" -max_total_time="$seconds" -max_len="$longest" -timeout=10 -rss_limit_mb=2048 -print_final_stats=1 \
  -artifact_prefix="build/fuzz-artifacts/$name-" "${folders[@]}" >"$log" 2>&1; then
  runs=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")
  [[ ${runs:-0} -gt 0 ]] || {
    echo "$name: no input was run, see $log" | tee -a "$results/fuzz.failed"
    exit 1
  }
  echo "$name: $runs inputs, nothing found"
  touch "$results/fuzz-$name.ok"
else
  echo "$name: FAILED, see $log"
  tail -n 60 "$log"
  # A line of the summary: the error, and the first place in the harness or in Rigor.
  echo "$name: $(grep -a -m 1 -oE 'ERROR: .*|runtime error: .*' "$log" || echo 'no message'), $(
    grep -a -m 1 -oE "$PWD/[^ ]+:[0-9]+" "$log" | sed "s#^$PWD/##" || echo 'no place')" >>"$results/fuzz.failed"
  exit 1
fi
