# Sourced by the other scripts: finds the package, installs what is missing, builds. Needs bash.
set -euo pipefail

package_dir=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
# Not `build`: rosrun of Debian passes over programs below a directory of that name in the package.
build_dir=${SEMANTIC_TOPO_LOOP_BUILD:-$package_dir/build-catkin}
jobs=${SEMANTIC_TOPO_LOOP_JOBS:-$(nproc)}
# SEMANTIC_TOPO_LOOP_WERROR=ON makes warnings errors; compilers to come warn of more, so that only .ci/run sets it.

# ROS's Python is the system's, which another one earlier in PATH would shadow.
export PATH=/usr/bin:$PATH

# Of the message generators only C++ and Python are used.
export ROS_LANG_DISABLE=genlisp

say() { printf '\n== %s\n' "$*"; }

as_root() {
  if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi
}

common_packages="build-essential cmake ninja-build curl pkg-config xauth xvfb libbenchmark-dev libboost-all-dev
  libceres-dev libeigen3-dev libgtest-dev libopencv-dev libsqlite3-dev libyaml-cpp-dev nlohmann-json3-dev python3-numpy
  python3-matplotlib zlib1g-dev"

debian_packages="catkin libcv-bridge-dev libdiagnostic-msgs-dev libdiagnostic-updater-dev libgeometry-msgs-dev
  libimage-transport-dev libmessage-filters-dev libnav-msgs-dev libnodelet-dev libros-rosgraph-msgs-dev librosbag-dev
  librosbag-storage-dev libroscpp-dev libroslib-dev librostest-dev libsensor-msgs-dev libstd-msgs-dev libstd-srvs-dev
  libtf2-dev libtf2-msgs-dev libtf2-ros-dev libtopic-tools-dev libvisualization-msgs-dev libnodeletlib-dev
  libnodeletlib-tools
  python3-diagnostic-msgs python3-geometry-msgs python3-nav-msgs python3-rosbag python3-roslaunch python3-rospy
  python3-rostest python3-sensor-msgs python3-std-srvs python3-tf2-msgs python3-visualization-msgs ros-diagnostic-msgs
  ros-geometry-msgs ros-message-generation ros-nav-msgs ros-sensor-msgs ros-std-msgs ros-visualization-msgs rosbash
  rosout rviz"

# ROS's own packages on Ubuntu 20.04; their repository (packages.ros.org) must be set up, as for every use of Noetic.
noetic_packages="catkin cv-bridge diagnostic-msgs diagnostic-updater geometry-msgs image-transport message-filters
  message-generation message-runtime nav-msgs nodelet rosbag rosbag-storage rosbash roscpp rosgraph-msgs roslaunch
  roslib rospy rostest rviz sensor-msgs std-msgs std-srvs tf2 tf2-msgs tf2-ros topic-tools visualization-msgs"

required_packages() {
  local id version
  id=$(. /etc/os-release && echo "$ID")
  version=$(. /etc/os-release && echo "${VERSION_ID:-}")
  case "$id-$version" in
    # Debian 11 has the versions of Noetic or the next: scripts/noetic_check builds there.
    debian-11* | debian-12*) echo $common_packages $debian_packages ;;
    ubuntu-20.04) echo $common_packages $(printf 'ros-noetic-%s ' $(echo $noetic_packages | tr _ -)) ;;
    *)
      echo "unsupported system: $id $version (supported: Debian 12, Ubuntu 20.04 with ROS Noetic)" >&2
      return 1
      ;;
  esac
}

# What the rviz plugin is built with; without them it is left out.
rviz_packages() {
  if [ "$(. /etc/os-release && echo "$ID")" = ubuntu ]; then echo qtbase5-dev; else echo librviz-dev; fi
}

# What .ci/run needs beside them.
ci_packages() {
  rviz_packages
  echo clang-format clang-tidy
  if [ "$(. /etc/os-release && echo "$ID")" = ubuntu ]; then echo python3-catkin-lint; else echo catkin-lint; fi
}

# install_dependencies [further packages...]
install_dependencies() {
  local missing=() package packages
  packages=$(required_packages)
  for package in $packages "$@"; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing+=("$package")
  done
  if [ ${#missing[@]} -gt 0 ]; then
    say "installing ${#missing[@]} packages"
    as_root apt-get update -q
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "${missing[@]}"
  fi
}

source_ros() {
  # The generated setup files read unset variables.
  set +u
  if [ -f /opt/ros/noetic/setup.bash ]; then . /opt/ros/noetic/setup.bash; fi
  if [ -f "$build_dir/devel/setup.bash" ]; then . "$build_dir/devel/setup.bash"; fi
  set -u
}

# configure TESTING(ON|OFF) [cmake arguments...]
configure() {
  local testing=$1
  shift
  mkdir -p "$build_dir"
  source_ros
  say "building in $build_dir"
  # The libraries are compiled alike with and without tests; -g1 keeps the lines of a backtrace and takes two thirds of
  # the time of -g. rosrun looks for programs in the whole package but for `build`: installed elsewhere they would be
  # there twice.
  cmake -S "$package_dir" -B "$build_dir" -G Ninja -DCMAKE_BUILD_TYPE=RelWithDebInfo \
    -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O2 -g1 -DNDEBUG" \
    -DCMAKE_INSTALL_PREFIX="$package_dir/build/install" -DPYTHON_EXECUTABLE=/usr/bin/python3 \
    -DCATKIN_ENABLE_TESTING="$testing" -DSTL_WERROR="${SEMANTIC_TOPO_LOOP_WERROR:-OFF}" "$@" \
    > "$build_dir/configure.log" 2>&1 \
    || { cat "$build_dir/configure.log" >&2; return 1; }
}

# build TESTING(ON|OFF) [cmake arguments...]
build() {
  configure "$@"
  # catkin leaves tests out of the default target.
  ninja -C "$build_dir" -j "$jobs" all $([ "$1" = OFF ] || echo tests)
  source_ros
}
