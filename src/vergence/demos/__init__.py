"""Demonstrations on the twin: foveate an object, track it, grasp it, see in depth."""
