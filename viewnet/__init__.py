"""ViewNet: unsupervised viewpoint estimation from conditional generation."""
