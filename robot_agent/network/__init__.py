"""The agent's side of the network: answers, heartbeats, telemetry, rival agents."""
