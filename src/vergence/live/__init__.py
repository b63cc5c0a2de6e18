"""Heads that are there: their drivers, guided capture of a calibration recording, and fixation."""
