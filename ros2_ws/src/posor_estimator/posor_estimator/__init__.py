"""POSOR estimation: sensor models, estimator, chain, calibration, and the thin ROS 2 nodes around them."""
