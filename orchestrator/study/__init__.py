"""What to test next, which source is closest, and whether a transfer will help."""
