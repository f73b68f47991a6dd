#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The suite: message fields are checked, nothing leaves the machine. Four parts: what needs no ROS; what starts nodes or keeps the
# time of a device, and what sends every 4 ms, each on two processes; what answers within 4 ms, one after another. The first
# computes all the time, the others wait most of it: so it runs beside them, with what they leave of the processor. A test of nodes
# that fails is run once more, without other nodes: what passes then is told as unstable, what fails again is a failure.
# With arguments, which go to pytest, all in one process: tools/test.sh irec_sim/test -k contact
set -o pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. tools/env.sh
export ROS_PYTHON_CHECK_FIELDS=1
run=(python -m pytest -ra --durations="${DURATIONS:-15}" --timeout=300)
[ $# -eq 0 ] || exec "${run[@]}" -p no:cacheprovider "$@"
code=0
processes=${TEST_PROCESSES:-2}
failed=$(mktemp -d)
beside=
trap 'exit 130' INT TERM
trap '[ -z "$beside" ] || kill "$beside" 2>/dev/null; rm -rf "$failed"' EXIT
idle=(chrt --idle 0)
"${idle[@]}" true 2>/dev/null || idle=(nice -n 19)
echo "irec: the tests without ROS run beside those of nodes and are shown after them"
"${idle[@]}" "${run[@]}" -p no:cacheprovider -m "not ros and not timed and not long" -n "$processes" --dist worksteal \
  >"$failed/without_ros.log" 2>&1 &
beside=$!

# run tests of nodes: a mark expression, then options of pytest. Files without such tests are not read, as that takes seconds;
# those that last are begun first: one of them at the end would leave a core idle
nodes() {
  local lasting=(irec_calibration/test/nodes/test_{loop,check_driver,faults}_ros.py irec_sim/test/test_cell_node.py test/test_two_cells.py)
  mapfile -t files < <(printf '%s\n' "${lasting[@]}"; grep -rlE 'mark\.(ros|timed)\b' --include='test_*.py' irec_*/test test)
  local part=("${run[@]}" -o "cache_dir=$failed/${1// /_}" -m "not long and $1" "${files[@]}")
  "${part[@]}" "${@:2}" && return
  echo "irec: a test of nodes failed, see above; once more, by itself"
  if "${part[@]}" --last-failed --last-failed-no-failures none; then
    echo "irec: UNSTABLE: passed at the second try, see the first above"
  else
    code=1
  fi
}
nodes "(ros or timed) and not paced and not alone" -n "$processes" --dist loadfile --no-loadscope-reorder
nodes "paced" -n "$processes" --dist loadfile
nodes "alone"
tail -n +1 -f --pid="$beside" "$failed/without_ros.log"
wait "$beside" || code=$?
beside=
exit $code
