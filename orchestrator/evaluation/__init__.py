"""Whether the prediction holds: every source flown on every path, and the figures."""
