"""Calibration, stereo and gaze for active heads, and a digital twin to try them on."""
