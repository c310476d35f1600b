"""Displacement fields: how far each cell of a grid moved between two images, with a covariance and a reason."""
