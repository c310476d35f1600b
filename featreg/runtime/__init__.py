"""Threads, executors, files, versions and compiling: what runs the work."""
