"""A driver of rotorpy's quadrotors for nufleet."""
