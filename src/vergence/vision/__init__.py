"""What is found in images: corners of boards, spheres, markers, features of a scene."""
