# POSOR on the official image of ROS 2 Jazzy, which is Ubuntu 24.04: docs/how_to/install_on_jazzy.md. Not tried.
FROM ros:jazzy
WORKDIR /posor
COPY . .
RUN . /opt/ros/jazzy/setup.sh && tools/install_on_jazzy.sh && rm -rf /var/lib/apt/lists/*
RUN printf '#!/bin/sh\n. /posor/ros2_ws/install/setup.sh\nexec "$@"\n' > /entry && chmod +x /entry
ENTRYPOINT ["/entry"]
CMD ["ros2", "run", "posor_bringup", "bringup", "five_axis"]
