"""What is found in images: corners of boards, spheres, markers, templates, features of a scene."""
