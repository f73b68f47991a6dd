#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Build the workspace with colcon in the local environment, and the ROS-free command .venv/bin/irec.
set -eo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
venv=$PWD/.venv
# a ROS that the shell has sourced must not leak into this workspace
unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONPATH
. "$venv/setup.bash"
# colcon's own choice stops building where the machine is busy; what `make PYTHON=...` hands down is for make
export MAKEFLAGS="-j$(nproc)"
echo "irec: building the workspace with colcon (about a minute the first time)"
colcon --log-base log build --symlink-install --event-handlers console_cohesion- \
  --base-paths irec_msgs irec_calibration irec_correction irec_sim tools/local_ros/tf2_msgs \
  --cmake-args -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF >"$venv/build.log" 2>&1 ||
  { tail -n 40 "$venv/build.log" >&2; echo "irec: the build failed, whole output in .venv/build.log" >&2; exit 1; }
"$venv/bin/uv" pip install -q --python "$venv/bin/python" --no-deps --no-build-isolation -e irec_calibration -e irec_sim
# there is no wheel of ros2cli: what the documents use of it; a real one that somebody has put there stays
if [ ! -e "$venv/bin/ros2" ] || grep -q "stands in for ros2" "$venv/bin/ros2"; then
  printf '#!/bin/sh\n# stands in for ros2, see there\nexec "%s/bin/python" "%s/tools/local_ros/ros2/ros2.py" "$@"\n' "$venv" "$PWD" >"$venv/bin/ros2"
  chmod +x "$venv/bin/ros2"
fi
echo "irec: built; the commands are .venv/bin/irec and, after '. tools/env.sh', ros2"
