"""Exact Gaussian processes: many small problems at once, and one in a control loop."""
