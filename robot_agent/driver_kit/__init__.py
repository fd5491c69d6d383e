"""For authors of drivers: the contract of a robot to check, and a package to begin with."""
