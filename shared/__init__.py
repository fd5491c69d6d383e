"""What the robot agents and the orchestrator must agree on."""
