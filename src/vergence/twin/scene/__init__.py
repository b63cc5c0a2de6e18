"""What stands before the head: the room and the calibration board."""
