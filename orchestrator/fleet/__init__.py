"""A fleet from the orchestrator's side: reaching it, asking it, starting it."""
