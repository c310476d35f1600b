"""Files made with a fitted model: the secondary on the reference grid, coherence."""
