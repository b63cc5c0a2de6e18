"""Features of a scene, matched between two images."""
