"""What crosses the network: keys, frames, messages, and the sessions that carry them."""
