"""Recordings of a head: frames of images and joint readings, and datasets on disk."""
