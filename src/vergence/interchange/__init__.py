"""Calibrations in the formats of other software: Kalibr, mrcal, ROS, OpenCV and URDF."""
