"""Linear models of robots: transfer functions, state space, graphs, and what is believed of one."""
