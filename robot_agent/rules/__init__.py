"""What a robot may do, decided without effects: goals, ownership, stops, kept results."""
