"""Gaze control: where an object is, where the eyes should look, and the joint commands."""
