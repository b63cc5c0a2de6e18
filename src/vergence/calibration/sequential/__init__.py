"""The paper's calibration, step by step: intrinsics, static stereo, hand-eye."""
