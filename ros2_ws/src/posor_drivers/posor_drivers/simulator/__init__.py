"""A simulated arm, truth and readings: no ROS in here, so that bags and accuracy runs are made of it as nodes are."""
