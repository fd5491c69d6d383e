"""Models and measured responses in files, and the ν-gap between them."""
