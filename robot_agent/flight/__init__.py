"""Flights with an experience: references, the online process, and the guard over both."""
