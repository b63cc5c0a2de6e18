"""Least squares with residual blocks, latent unknowns, robust loss and estimated noise levels.

A *residual* (`residual.Residual`) is one kind of measurement: it computes its errors, their
derivatives by the unknowns, and names the noise level of each coordinate. The *unknowns*
(`variables.Variables`) are shared blocks with a name and a retraction, and one kind of latent
unknowns with many elements, such as the pose of the board in each view. A row of a residual may
depend on any shared unknowns and on one latent element, so the Schur complement eliminates the
elements one by one and the cost grows linearly with their number.

- `linear`: the normal equations by noise level, and their solution.
- `least_squares`: Levenberg-Marquardt, for given noise levels or a single concentrated one.
- `noise`: noise levels by restricted maximum likelihood.
- `observability`: directions that the data do not determine, and the covariance of the others.
- `adjustment`: unknowns, noise levels and observability in turn.

A prior is a residual of the unit level, whose error is the deviation in standard deviations.

A filter's update uses the same normal equations. Linearise the residuals at the predicted state
with `linear.linearise` (weights from any robust loss, such as Tukey's), eliminate latent unknowns
with `linear.eliminate`, and combine the information matrix and vector that remain with the
predicted covariance by `linear.posterior`, which also accepts a singular covariance.
"""
