"""Gradients and filters of speckled images."""
