# The package on Ubuntu 20.04 with ROS Noetic: builds it with warnings as errors and passes its tests.
#   docker build -f scripts/noetic.Dockerfile -t semantic_topo_loop .
# Tests on recorded data are skipped in it: run `scripts/test` in a container that has the data for those.
FROM ros:noetic-ros-base

COPY . /catkin_ws/src/semantic_topo_loop
WORKDIR /catkin_ws/src/semantic_topo_loop
RUN SEMANTIC_TOPO_LOOP_WERROR=ON scripts/test && rm -rf /var/lib/apt/lists/*
