"""Robots that need no hardware."""
