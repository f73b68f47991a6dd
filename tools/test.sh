#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The whole suite: message fields are checked, nothing leaves the machine. Arguments go to pytest.
set -eo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. tools/env.sh
export ROS_PYTHON_CHECK_FIELDS=1
exec python -m pytest -p no:cacheprovider -ra --durations=15 --timeout=300 "$@"
