"""What a head is, as numbers: transforms, lenses, joints, boards and the calibration file."""
