"""What a robot is specified by: its limits, its driver, its fleet file."""
