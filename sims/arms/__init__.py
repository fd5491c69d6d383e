"""Robot arms under joint-space position control, simulated with MuJoCo."""
