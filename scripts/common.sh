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

# What the scripts need beside what package.xml names.
tool_packages="build-essential cmake ninja-build pkg-config xauth xvfb"

# NAME in package.xml, packages to build and test with, packages to run with; -: what the libraries depend on is enough.
system_packages="
  benchmark           libbenchmark-dev                                   -
  boost               libboost-all-dev                                   -
  curl                curl                                               curl
  eigen               libeigen3-dev                                      -
  gtest               libgtest-dev                                       -
  libceres-dev        libceres-dev                                       -
  libopencv-dev       libopencv-dev                                      -
  libsqlite3-dev      libsqlite3-dev                                     -
  nlohmann-json-dev   nlohmann-json3-dev                                 -
  python3-matplotlib  python3-matplotlib                                 python3-matplotlib
  python3-numpy       python3-numpy                                      python3-numpy
  qtbase5-dev         qtbase5-dev                                        -
  yaml-cpp            libyaml-cpp-dev                                    -
  zlib                zlib1g-dev                                         -"

# ROS in Debian itself; packages of messages are called alike, but for one.
debian_packages="
  catkin              catkin                                             -
  cv_bridge           libcv-bridge-dev                                   -
  diagnostic_updater  libdiagnostic-updater-dev                          -
  dynamic_reconfigure libdynamic-reconfigure-config-init-mutex-dev,python3-dynamic-reconfigure  python3-dynamic-reconfigure
  image_transport     libimage-transport-dev                             -
  message_filters     libmessage-filters-dev                             -
  message_generation  ros-message-generation                             -
  message_runtime     ros-message-runtime                                python3-genpy
  nodelet             libnodelet-dev,libnodeletlib-dev,libnodeletlib-tools  libnodeletlib-tools
  rosbag              librosbag-dev,python3-rosbag                       python3-rosbag
  rosbag_storage      librosbag-storage-dev                              -
  rosbash             rosbash                                            rosbash
  roscpp              libroscpp-dev                                      -
  rosgraph_msgs       libros-rosgraph-msgs-dev                           python3-rosgraph-msgs
  roslaunch           python3-roslaunch                                  python3-roslaunch
  roslib              libroslib-dev                                      -
  rospy               python3-rospy                                      python3-rospy
  rostest             librostest-dev,python3-rostest                     python3-rostest
  rviz                rviz,librviz-dev,libopengl-dev                     rviz
  tf2                 libtf2-dev                                         -
  tf2_ros             libtf2-ros-dev                                     -
  topic_tools         libtopic-tools-dev                                 -"

# names_in ELEMENT...: what package.xml names in these elements.
names_in() {
  local IFS='|'
  sed -nE "s:^ *<($*)>(.*)</.*:\2:p" "$package_dir/package.xml" | sort -u
}

# apt_packages build|run NAME...: the packages of this system that have what package.xml names so.
apt_packages() {
  local column=2 system name found
  if [ "$1" = run ]; then column=3; fi
  system=$(. /etc/os-release && echo "$ID-${VERSION_ID:-}")
  for name in "${@:2}"; do
    found=$(awk -v name="$name" -v column=$column '$1 == name { print $column }' <<< "$system_packages")
    case ${found:-$system:$name} in
      ubuntu-20.04:*) found=ros-noetic-${name//_/-} ;;  # their repository, packages.ros.org, must be set up
      # Debian 11 has the versions of Noetic or the next: scripts/noetic_check builds there.
      debian-1[12]*:*)
        found=$(awk -v name="$name" -v column=$column '$1 == name { print $column }' <<< "$debian_packages")
        case $found:$name in
          :*_msgs | :*_srvs)
            found=python3-${name//_/-},ros-${name//_/-}
            if [ "$1" = build ]; then found=lib${name//_/-}-dev,$found; fi
            ;;
        esac
        ;;
      *:*)
        echo "unsupported system: $system (supported: Debian 12 and 11; untried: Ubuntu 20.04 with ROS Noetic)" >&2
        return 1
        ;;
    esac
    [ -n "$found" ] || { echo "common.sh: no package is known for package.xml's $name" >&2; return 1; }
    if [ "$found" != - ]; then echo "${found//,/ }"; fi
  done
}

required_packages() {
  echo $tool_packages
  apt_packages build $(names_in depend buildtool_depend build_depend build_export_depend exec_depend test_depend)
}

# What .ci/run needs beside them. Chromium (120 MB to fetch) opens the page of a run; Ubuntu has it as a snap only, so that
# its test is skipped there; so are those of scripts/prepare_model without the module onnx.
ci_packages() {
  echo clang-format clang-tidy mkdocs
  if [ "$(. /etc/os-release && echo "$ID")" = ubuntu ]; then
    echo python3-catkin-lint
  else
    echo catkin-lint chromium python3-onnx
  fi
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
  if [ -f /opt/ros/noetic/setup.bash ]; then
    . /opt/ros/noetic/setup.bash
    export ROS_LANG_DISABLE=genlisp:geneus:gennodejs
  fi
  if [ -f "$build_dir/devel/setup.bash" ]; then . "$build_dir/devel/setup.bash"; fi
  set -u
}

# run_tests ARGUMENTS...: ctest in the present directory, where no test at all is a failure; CMake 3.16 has no option for that.
run_tests() {
  ctest --output-on-failure --output-log ctest.log "$@" || return
  if ! grep -q 'No tests were found' ctest.log; then return 0; fi
  echo "no test was run" >&2
  return 1
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
