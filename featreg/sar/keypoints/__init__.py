"""Corners, maxima, and what is counted around them."""
