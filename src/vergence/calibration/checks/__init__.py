"""Checks of recordings: encoders, excitation, board flips, cross-validation."""
