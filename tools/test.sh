#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The suite: message fields are checked, nothing leaves the machine. What needs no ROS runs on two processes, nodes one after the
# other. With arguments, which go to pytest, all in one process: tools/test.sh irec_sim/test -k contact
set -o pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. tools/env.sh
export ROS_PYTHON_CHECK_FIELDS=1
run=(python -m pytest -p no:cacheprovider -ra --durations=15 --timeout=300)
[ $# -eq 0 ] || exec "${run[@]}" "$@"
code=0
"${run[@]}" -m "not ros and not long" -n "${TEST_PROCESSES:-2}" || code=$?
"${run[@]}" -m "ros and not long" || code=$?
exit $code
