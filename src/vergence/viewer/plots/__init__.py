"""Plots by matplotlib: calibrations, and predicted accuracy."""
