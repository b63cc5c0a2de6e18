"""What the commands of the command line run, and what they print and write."""
