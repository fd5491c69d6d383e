"""Distances between closed loops: chordal, over a band, and the ν-gap with its margins."""
