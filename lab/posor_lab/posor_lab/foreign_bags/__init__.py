"""Bags as other writers, interrupted recorders and older versions of rosbag2 leave them, read and judged."""
