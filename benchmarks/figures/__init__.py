"""The figures of three papers, drawn from real and simulated data: one function a figure."""
