# The base of a mission, or with ROLE=robot what a robot carries beside its Nav2. Not built so far:
# it is held to the commands of the README, and to hadolint.
#
#   docker build --tag kbnitp:base .
#   docker build --tag kbnitp:robot --build-arg ROLE=robot .
#   docker run --network host --volume ./runs:/workspace/runs kbnitp:base
#   docker run --network host kbnitp:robot ros2 launch kbnitp_ros robot.launch.py agent:=scout_1
FROM ros:jazzy-ros-base-noble
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
ARG ROLE=base
# By this package.xml leaves out what a robot does not need.
ENV KBNITP_ROLE=$ROLE PIP_BREAK_SYSTEM_PACKAGES=1 PIP_NO_CACHE_DIR=1
WORKDIR /workspace
COPY . .
RUN apt-get update \
 && rosdep update \
 && rosdep install --from-paths . msg_defs --ignore-src -y \
    --dependency-types=build --dependency-types=buildtool --dependency-types=exec \
 && rm -rf /var/lib/apt/lists/*
RUN . /opt/ros/jazzy/setup.bash && colcon build
ENTRYPOINT ["/bin/bash", "-c", ". install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "launch", "kbnitp_ros", "base.launch.py"]
