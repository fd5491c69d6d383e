"""The folder that a run leaves, its documents, and what people read of them."""
