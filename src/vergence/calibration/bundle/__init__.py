"""Bundle adjustment: one estimate of a whole head, its covariance and its noise levels."""
