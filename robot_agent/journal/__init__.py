"""What a robot must remember when its agent dies: written first, replayed at the start."""
