"""What a robot plays in a frequency test, and the response that comes of it."""
