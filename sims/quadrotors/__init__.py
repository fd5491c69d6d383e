"""Quadrotors under their own baseline controllers, simulated with crazyflow."""
