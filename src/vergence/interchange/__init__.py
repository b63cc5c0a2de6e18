"""Calibrations in the formats of other software: Kalibr, ROS, OpenCV and URDF."""
