"""Plots by matplotlib: calibrations, foveation, error budgets, designs and plans."""
