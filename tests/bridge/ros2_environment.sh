#!/usr/bin/env bash
# Make an environment with ROS 2 from wheels: ros2_environment.sh kilted|jazzy FOLDER [PYTHON]
#
# PYTHON is that of tfbus, a CPython 3.11 or 3.12: its packages are there too, behind those of ROS.
# Never the other way round: ROS's wheels start each Python of their environment a second time. No
# wheel has tf2_msgs and turtlesim's messages, so they are compiled. It takes about a minute.
set -euo pipefail
distro=$1 venv=$2 python=${3:-python3}
[[ $distro == kilted || $distro == jazzy ]] || { echo "no wheels of ROS 2 $distro" >&2; exit 2; }

"$python" -m venv "$venv"
venv=$(cd "$venv" && pwd)
packages=(rclpy rmw-fastrtps-cpp geometry-msgs nav-msgs rosgraph-msgs sensor-msgs std-msgs
  ament-cmake ament-cmake-{export-include-directories,gmock,gtest,include-directories,pytest,ros}
  pybind11-vendor rosidl-core-generators rosidl-default-generators)
[ "$distro" = jazzy ] || packages+=(ament-cmake-ros-core)
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check "${packages[@]/#/ros-$distro-}" \
  ros-ament-package ros-python-cmake-module pybind11 catkin_pkg lark 'empy==3.3.4' cmake ninja numpy

# The wheels name Python's folders on the machine where they were built.
headers=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
of_numpy=$("$venv/bin/python" -c 'import numpy; print(numpy.get_include())')
built='/opt/python/cp3[0-9]*-cp3[0-9]*'
grep -rlE --include='*.cmake' "$built" "$venv/share" | xargs -r sed -i -E \
  -e "s#$built/lib/python3\.[0-9]+/site-packages/numpy/(_core|core)/include#$of_numpy#g" \
  -e "s#$built/include/python3\.[0-9]+#$headers#g"

# compiled PACKAGE MESSAGE TEXT DEPENDENCY...: a package with one message.
compiled() {
  local package=$1 message=$2 text=$3 source=$venv/src/$1
  shift 3
  mkdir -p "$source/msg"
  printf '%s\n' "$text" >"$source/msg/$message.msg"
  {
    echo "<package format='3'><name>$package</name><version>0.0.0</version>"
    echo "<description>A message</description><license>none</license>"
    echo "<maintainer email='none@example.org'>none</maintainer>"
    echo '<buildtool_depend>ament_cmake</buildtool_depend>'
    echo '<build_depend>rosidl_default_generators</build_depend>'
    echo '<exec_depend>rosidl_default_runtime</exec_depend>'
    [ $# = 0 ] || printf '<depend>%s</depend>\n' "$@"
    echo '<member_of_group>rosidl_interface_packages</member_of_group>'
    echo '<export><build_type>ament_cmake</build_type></export></package>'
  } >"$source/package.xml"
  {
    echo 'cmake_minimum_required(VERSION 3.20)'
    echo "project($package)"
    printf 'find_package(%s REQUIRED)\n' ament_cmake rosidl_default_generators "$@"
    echo "rosidl_generate_interfaces($package msg/$message.msg${*:+ DEPENDENCIES $*})"
    echo 'ament_package()'
  } >"$source/CMakeLists.txt"
  env PATH="$venv/bin:$PATH" AMENT_PREFIX_PATH="$venv" CMAKE_PREFIX_PATH="$venv" CXXFLAGS=-O0 CFLAGS=-O0 \
    cmake -S "$source" -B "$source/build" -GNinja "-DCMAKE_INSTALL_PREFIX=$venv" \
    -DBUILD_TESTING=OFF "-DPython3_EXECUTABLE=$venv/bin/python"
  "$venv/bin/ninja" -C "$source/build" -j1 install
}
compiled tf2_msgs TFMessage 'geometry_msgs/TransformStamped[] transforms' geometry_msgs
compiled turtlesim Pose $'float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity'

# tfbus, and what it imports, as far as ROS's environment has none of it.
"$python" - "$venv" <<'END'
import sys
import sysconfig
from pathlib import Path

folder = sysconfig.get_path("purelib")
version = f"python{sys.version_info.major}.{sys.version_info.minor}"
behind = Path(sys.argv[1], "lib", version, "site-packages", "zz_tfbus.pth")
behind.write_text(f"import site; site.addsitedir({folder!r})\n")
END
"$venv/bin/python" -c 'import rclpy, tfbus, tf2_msgs.msg, turtlesim.msg'
touch "$venv/ready"
