"""Drawn paths, and trajectories along them."""
