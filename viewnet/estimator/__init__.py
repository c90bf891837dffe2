"""Viewpoints of people's own images, by a trained model."""

from viewnet.estimator.viewpoint_estimator import ViewpointEstimator

__all__ = ["ViewpointEstimator"]
