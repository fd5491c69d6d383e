"""What a fleet does when things go wrong: faults that are caused, and figures of what follows."""
