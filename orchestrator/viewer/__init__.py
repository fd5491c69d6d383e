"""Draws a running study in Rerun."""
