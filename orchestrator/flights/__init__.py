"""Flying paths: legs between them, the pilot, and the table of flights."""
