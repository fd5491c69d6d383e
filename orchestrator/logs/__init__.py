"""Flights that exist: logs of other programs, read as reference and output of an axis."""
