"""What is drawn on Rerun, one kind of picture per file."""
