"""Visually guided reaching: move a hand to the object that the eyes look at."""
