"""Decides which robots test what, and which experience is transferred."""
