"""Drawings for people: a page to draw on, a picture, a report."""
