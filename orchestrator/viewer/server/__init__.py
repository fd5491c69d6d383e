"""Rerun's viewers: served live, as a page, as pictures, or opened on a recording."""
