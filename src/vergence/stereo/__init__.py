"""Points in space from pixels of two moving cameras, with their covariance."""
