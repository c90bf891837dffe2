"""ViewNet: unsupervised viewpoint estimation from conditional generation.

The folders are rooms that import each other in one direction: docs/architecture.md. People's own images begin at
`from viewnet.estimator import ViewpointEstimator`. Every error that users can cause is a `viewnet.errors.ViewnetError`.
"""
