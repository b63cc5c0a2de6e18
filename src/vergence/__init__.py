"""Calibration, stereo and gaze for active heads, and a digital twin to try them on."""

__version__ = "0.2.0"
