"""What stands before the head: the room, the calibration board, a card as object."""
