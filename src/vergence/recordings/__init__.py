"""Recordings of robots by other programs, and datasets made of them."""
