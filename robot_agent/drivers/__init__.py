"""Drivers of real robots, one package for each kind, each with the extra of its name."""
