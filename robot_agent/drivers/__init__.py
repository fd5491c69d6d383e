"""Drivers of real robots, one package for each kind."""
