"""Measurements against named peers; each prints a table and can write JSON."""
