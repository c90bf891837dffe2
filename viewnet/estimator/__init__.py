"""Viewpoints of people's own images, predicted by a trained model."""

from viewnet.estimator.viewpoint_estimator import ViewpointEstimator as ViewpointEstimator
