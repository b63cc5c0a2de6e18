"""Recordings for the rerun viewer, and figures by matplotlib."""
