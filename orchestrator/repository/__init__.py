"""What outlives a run: robots, responses, experiences, studies, trials and leases in a database."""
