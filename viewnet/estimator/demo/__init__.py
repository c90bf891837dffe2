"""A web page on which to try a model."""
