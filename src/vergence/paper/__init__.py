"""The paper's experiments: its figures replayed on the twin, with its results beside ours."""
