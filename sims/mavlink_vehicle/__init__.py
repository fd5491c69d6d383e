"""A simulated multicopter that speaks MAVLink, with a position loop of known response."""
