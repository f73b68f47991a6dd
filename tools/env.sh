# SPDX-License-Identifier: Apache-2.0
# Source this: the built workspace, nothing leaves the machine, one thread per process for linear algebra.
_irec_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
# a ROS that the shell has sourced must not leak into this workspace
unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONPATH
. "$_irec_root/.venv/setup.bash"
. "$_irec_root/install/setup.bash"
export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
export FASTRTPS_DEFAULT_PROFILES_FILE=$_irec_root/config/fastdds_localhost.xml
export ROS_LOG_DIR=${ROS_LOG_DIR:-$_irec_root/log/ros}
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 PYTHONUNBUFFERED=1
# who wants no byte code beside the sources gets it elsewhere: without any, each process compiles its libraries, a second and more
if [ -n "${PYTHONDONTWRITEBYTECODE:-}" ]; then
  unset PYTHONDONTWRITEBYTECODE
  export PYTHONPYCACHEPREFIX=${PYTHONPYCACHEPREFIX:-$_irec_root/.venv/bytecode}
fi
unset _irec_root
