"""Linear models of robots: transfer functions, state space and their graphs."""
