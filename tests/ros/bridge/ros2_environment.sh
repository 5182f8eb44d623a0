#!/usr/bin/env bash
# Make an environment with ROS 2 from wheels: ros2_environment.sh kilted|jazzy FOLDER TFBUS_VENV
#
# The packages of TFBUS_VENV, which may come later, are there too, behind those of ROS. Never the
# other way round: ROS's wheels start each Python of their environment a second time. They are for
# CPython 3.11 and 3.12 on x86-64. No wheel has tf2_msgs, so it is compiled. It takes a minute.
set -euo pipefail
distro=$1 venv=$2 tfbus=$(realpath -m "$3")
if [[ $distro != kilted && $distro != jazzy ]]; then
  echo "there are no wheels of ROS 2 $distro" >&2
  exit 2
fi

python3 -m venv "$venv"
venv=$(realpath "$venv")
python=$venv/bin/python
packages=(rclpy rmw-fastrtps-cpp geometry-msgs nav-msgs rosgraph-msgs sensor-msgs std-msgs
  ament-cmake ament-cmake-{export-include-directories,gmock,gtest,include-directories,pytest,ros}
  pybind11-vendor rosidl-core-generators rosidl-default-generators)
[ "$distro" = jazzy ] || packages+=(ament-cmake-ros-core)
"$python" -m pip install --quiet --no-compile --disable-pip-version-check \
  "${packages[@]/#/ros-$distro-}" ros-ament-package ros-python-cmake-module \
  pybind11 catkin_pkg lark 'empy==3.3.4' cmake ninja numpy

# The wheels name Python's folders on the machine where they were built.
headers=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
of_numpy=$("$python" -c 'import numpy; print(numpy.get_include())')
built='/opt/python/cp3[0-9]*-cp3[0-9]*'
grep -rlE --include='*.cmake' "$built" "$venv/share" | xargs -r sed -i -E \
  -e "s#$built/lib/python3\.[0-9]+/site-packages/numpy/(_core|core)/include#$of_numpy#g" \
  -e "s#$built/include/python3\.[0-9]+#$headers#g"

source=$venv/src/tf2_msgs
mkdir -p "$source/msg"
echo 'geometry_msgs/TransformStamped[] transforms' >"$source/msg/TFMessage.msg"
cat >"$source/package.xml" <<'END'
<package format="3">
  <name>tf2_msgs</name>
  <version>0.0.0</version>
  <description>The message of /tf</description>
  <maintainer email="none@example.org">none</maintainer>
  <license>none</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <build_depend>rosidl_default_generators</build_depend>
  <depend>geometry_msgs</depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
END
cat >"$source/CMakeLists.txt" <<'END'
cmake_minimum_required(VERSION 3.20)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(tf2_msgs msg/TFMessage.msg DEPENDENCIES geometry_msgs)
ament_package()
END
PATH=$venv/bin:$PATH AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv CFLAGS=-O0 CXXFLAGS=-O0 \
  cmake -S "$source" -B "$source/build" -GNinja -DCMAKE_INSTALL_PREFIX="$venv" \
  -DBUILD_TESTING=OFF -DPython3_EXECUTABLE="$python"
"$venv/bin/ninja" -C "$source/build" -j1 install

site=$(cd "$venv" && echo lib/python3.*/site-packages)
echo "import site; site.addsitedir('$tfbus/$site')" >"$venv/$site/zz_tfbus.pth"
"$python" -c 'import rclpy, tf2_msgs.msg'
touch "$venv/ready"
