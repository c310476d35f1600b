"""Orientation correlation: the double-angle field of ratio gradients, its global search and its local windows."""
