"""Find out which robot's experience will help, before you transfer it."""
