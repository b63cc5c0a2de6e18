"""Calibration of a head from images of a board and joint readings, with its accuracy."""
