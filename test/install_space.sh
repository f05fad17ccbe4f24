#!/usr/bin/env bash
# Installs a finished build, and shows that the install space is enough: test/downstream builds against it and maps ten
# frames, and the demo's rostest runs from it. Argument: the build directory, as scripts/test leaves it.
. "$(dirname "${BASH_SOURCE[0]}")/../scripts/common.sh"

build_dir=$(cd "${1:-$build_dir}" && pwd)
# catkin writes the prefix into what it configures: the build must have been made for it.
prefix=$(sed -n 's/^CMAKE_INSTALL_PREFIX:PATH=//p' "$build_dir/CMakeCache.txt")
case $prefix in
  */build/install) ;;
  *) echo "$build_dir installs into $prefix, which is no directory for a test" >&2; exit 1 ;;
esac
temporary=$(mktemp -d)
trap 'rm -rf "$temporary" "$prefix"' EXIT
rm -rf "$prefix"
cmake --install "$build_dir" > "$temporary/install.log"

# Of the build's own environment nothing is left.
unset CMAKE_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH ROS_PACKAGE_PATH STL_DEVEL_PYTHON
set +u
if [ -f /opt/ros/noetic/setup.bash ]; then . /opt/ros/noetic/setup.bash; fi
. "$prefix/setup.bash"
set -u

say "a package downstream"
cmake -S "$package_dir/test/downstream" -B "$temporary/downstream" -G Ninja -DCMAKE_BUILD_TYPE=RelWithDebInfo \
  -DPYTHON_EXECUTABLE=/usr/bin/python3 > "$temporary/configure.log" 2>&1 || { cat "$temporary/configure.log"; exit 1; }
ninja -C "$temporary/downstream"
"$temporary/downstream/devel/lib/semantic_topo_loop_downstream/ten_frames"

say "the demo from $prefix"
cp -r "$package_dir/test/rostest" "$prefix/share/semantic_topo_loop/rostest"
cd "$prefix/share/semantic_topo_loop"
[ "$(rospack find semantic_topo_loop)" = "$PWD" ] || { echo "rospack finds another package" >&2; exit 1; }
rostest --results-base-dir "$temporary" --results-filename demo.xml rostest/run.test name:=demo
rosrun semantic_topo_loop paper_tables --help > /dev/null
rosrun semantic_topo_loop fetch_data --help > /dev/null
rosrun semantic_topo_loop prepare_model --help > /dev/null
[ -f rviz/semantic_topo_loop.rviz ] || { echo "launch files name a file for rviz that is not there" >&2; exit 1; }
say "the install space is complete"
