"""What a match returns, and its file."""
