"""Commissioning of an arm: a plan of steps, their recording, and the checks of plugs, motions and files. No ROS."""
