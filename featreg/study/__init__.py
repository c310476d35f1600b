"""Comparisons: pairs, methods, parameters and seeds under one protocol."""
