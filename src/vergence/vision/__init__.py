"""What is found in images: corners of calibration boards and coloured spheres."""
